//! Reasons why a batch, or one of its frames, ends without a result.

use std::io;
use std::path::PathBuf;

use super::memory::in_words;
use super::pieces::MergeError;
use super::request::RequestError;
use crate::image::ImageError;
use crate::render::Cancelled;

/// Reason why a batch, or one of its frames, ends without a result: one sentence with the item and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// Cancellation by the observer's flag.
    #[error("interrupted")]
    Cancelled(#[from] Cancelled),
    /// Request that the scene or the machine cannot satisfy.
    #[error(transparent)]
    Request(RequestError),
    /// Image file, or file of pieces, that cannot be written or read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Pieces that cannot be merged.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Pieces that are missing, in a folder that only `whit merge` looks at.
    #[error(
        "{error}: render them with `whit batch --resume`, or remove {} if they are not needed any more",
        .folder.display()
    )]
    Unfinished {
        /// Number of missing rows, in words.
        error: MergeError,
        /// Folder of the pieces.
        folder: PathBuf,
    },
    /// Frame in pieces that must be rendered at once.
    #[error(
        "{image}: adaptive sampling and channels of rays and time require rendering the whole frame at once: leave \
         out `split` and `--time`"
    )]
    DividedAtOnce {
        /// Name of the frame.
        image: String,
    },
    /// Frame in shares of samples with channels of first hits.
    #[error("{image}: shares and `--time` support only `aov = \"samples\"`: leave out the other channels")]
    DividedChannels {
        /// Name of the frame.
        image: String,
    },
    /// Frame in more shares than its samples have packets.
    #[error("{image}: {spp} samples per pixel can be split into at most {most} shares: give fewer")]
    TooManyShares {
        /// Name of the frame.
        image: String,
        /// Number of samples per pixel.
        spp: u32,
        /// Largest number of shares.
        most: u32,
    },
    /// Time limit with a sampling pattern whose beginning does not cover the pixel.
    #[error(
        "{image}: the first samples of that pattern do not cover the whole pixel: choose `pattern = \"sobol\"` for \
         `--time`"
    )]
    UnorderedPattern {
        /// Name of the frame.
        image: String,
    },
    /// Folder of images that cannot be created.
    #[error("cannot create the folder {} ({error}): choose another `--out`", .folder.display())]
    CreateFolder {
        /// Path of the folder.
        folder: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Output folder that does not exist.
    #[error("there is no folder {}: give the output folder of a batch", .out.display())]
    NoFolder {
        /// Path of the folder.
        out: PathBuf,
    },
    /// Input file or output folder that cannot be read.
    #[error("cannot read {}: {error}", .path.display())]
    Read {
        /// Path of the file or folder.
        path: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Output folder with results that the options do not keep.
    #[error(
        "{} has results of an earlier run: give `--resume` to keep them, or another `--out`",
        .out.display()
    )]
    EarlierRun {
        /// Path of the folder.
        out: PathBuf,
    },
    /// Manifest that cannot be opened.
    #[error("cannot open the manifest in {}: {error}", .out.display())]
    OpenManifest {
        /// Path of the output folder.
        out: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Complete image that the manifest does not record.
    #[error("{} cannot be added to the manifest: {error}", .image.display())]
    AddToManifest {
        /// Path of the image.
        image: PathBuf,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Output folder that another process of this machine renders into.
    #[error("another whit ({holder}) is rendering into {}: wait for it, or stop it", .out.display())]
    Locked {
        /// Description of the other process.
        holder: String,
        /// Path of the output folder.
        out: PathBuf,
    },
    /// Frame that takes more memory than the options allow.
    #[error(
        "{image} is forecast to take {} of memory and may take {}: give a larger `--max-memory` or a smaller `size`",
        in_words(*.needed),
        in_words(*.most)
    )]
    MaxMemory {
        /// Name of the frame.
        image: String,
        /// Bytes that the frame and its scene take.
        needed: u64,
        /// Bytes that they may take.
        most: u64,
    },
    /// Frame that takes more memory than is free.
    #[error(
        "{image} is forecast to take {} of memory in addition to its scene, and {} are free: give a smaller `size`",
        in_words(*.needed),
        in_words(*.free)
    )]
    FreeMemory {
        /// Name of the frame.
        image: String,
        /// Bytes that the frame takes.
        needed: u64,
        /// Bytes that are free.
        free: u64,
    },
    /// Pieces that cannot be listed.
    #[error("cannot read the pieces of {image}: {error}")]
    ReadPieces {
        /// Name of the frame.
        image: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// Folder of pieces that cannot be created.
    #[error("cannot create the folder for the pieces: {0}")]
    CreatePieces(io::Error),
    /// Frame of a scene that has failed before.
    #[error("{image}: its scene {} failed, see above", .scene.display())]
    FailedScene {
        /// Name of the frame.
        image: String,
        /// Path of the scene.
        scene: PathBuf,
    },
    /// Panic of a thread, which is a defect of the program.
    #[error("a render thread panicked")]
    Panicked,
    /// Frames that failed, each of which has been reported.
    #[error("{failed} of {total} frames failed")]
    FailedFrames {
        /// Number of frames that failed.
        failed: usize,
        /// Number of frames of the shard.
        total: usize,
    },
}

impl From<RequestError> for BatchError {
    fn from(error: RequestError) -> BatchError {
        match error {
            RequestError::Cancelled(error) => BatchError::Cancelled(error),
            error => BatchError::Request(error),
        }
    }
}
