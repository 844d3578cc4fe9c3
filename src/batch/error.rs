//! Reasons why a batch, or one of its frames, ends without a result.

use std::io;
use std::path::PathBuf;

use super::memory::in_words;
use super::pieces::MergeError;
use super::request::RequestError;
use crate::image::ImageError;
use crate::render::Cancelled;

/// Reason why a batch, or one of its frames, ends without a result: one sentence with the item and the remedy. Frames
/// are named by their images.
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
    Merge(MergeError),
    /// Pieces that are missing, with the folder of the others.
    #[error("{}: render them with `whit batch --resume`, or remove {} if they are not needed any more", .0, .1.display())]
    Unfinished(MergeError, PathBuf),
    /// Frame in pieces that must be rendered at once.
    #[error(
        "{0}: adaptive sampling and channels of rays and time require rendering the whole frame at once: leave out \
         `split` and `--time`"
    )]
    DividedAtOnce(String),
    /// Frame in shares of samples with an alpha channel.
    #[error(
        "{0}: shares and `--time` do not support a transparent background: split the frame into bands alone, or give \
         another `background` in the `[output]` of the scene file"
    )]
    DividedAlpha(String),
    /// Frame in shares of samples with channels of first hits.
    #[error("{0}: shares and `--time` support only `aov = \"samples\"`: leave out the other channels")]
    DividedChannels(String),
    /// Frame in more shares than `most`, the number of packets of its `spp` samples per pixel.
    #[error("{image}: {spp} samples per pixel can be split into at most {most} shares: give fewer")]
    TooManyShares { image: String, spp: u32, most: u32 },
    /// Time limit with a sampling pattern whose beginning does not cover the pixel.
    #[error(
        "{0}: the first samples of that pattern do not cover the whole pixel: choose `pattern = \"sobol\"` for `--time`"
    )]
    UnorderedPattern(String),
    /// Folder of images that cannot be created.
    #[error("cannot create the folder {} ({}): choose another `--out`", .0.display(), .1)]
    CreateFolder(PathBuf, io::Error),
    /// Output folder that does not exist.
    #[error("there is no folder {}: give the output folder of a batch", .0.display())]
    NoFolder(PathBuf),
    /// Input file or output folder that cannot be read.
    #[error("cannot read {}: {}", .0.display(), .1)]
    Read(PathBuf, io::Error),
    /// Output folder with results that the options do not keep.
    #[error("{} has results of an earlier run: give `--resume` to keep them, or another `--out`", .0.display())]
    EarlierRun(PathBuf),
    /// Output folder whose manifest cannot be opened.
    #[error("cannot open the manifest in {}: {}", .0.display(), .1)]
    OpenManifest(PathBuf, io::Error),
    /// Complete image that the manifest does not record.
    #[error("{} cannot be added to the manifest: {}", .0.display(), .1)]
    AddToManifest(PathBuf, io::Error),
    /// Output folder that another process of this machine renders into, with the description of that process.
    #[error("another whit ({}) is rendering into {}: wait for it, or stop it", .1, .0.display())]
    Locked(PathBuf, String),
    /// Frame that needs more bytes of memory with its scene than the options allow.
    #[error(
        "{image} is forecast to take {} of memory and may take {}: give a larger `--max-memory` or a smaller `size`",
        in_words(*.needed),
        in_words(*.most)
    )]
    MaxMemory { image: String, needed: u64, most: u64 },
    /// Frame that needs more bytes of memory than are free.
    #[error(
        "{image} is forecast to take {} of memory in addition to its scene, and {} are free: give a smaller `size`",
        in_words(*.needed),
        in_words(*.free)
    )]
    FreeMemory { image: String, needed: u64, free: u64 },
    /// Frame whose pieces cannot be listed.
    #[error("cannot read the pieces of {0}: {1}")]
    ReadPieces(String, io::Error),
    /// Folder of pieces that cannot be created.
    #[error("cannot create the folder for the pieces: {0}")]
    CreatePieces(io::Error),
    /// Frame of a scene that has failed before.
    #[error("{}: its scene {} failed, see above", .0, .1.display())]
    FailedScene(String, PathBuf),
    /// Panic of a thread, which is a defect of the program.
    #[error("a render thread panicked")]
    Panicked,
    /// Number of frames that could not be merged, each of which has been reported, of all frames with pieces.
    #[error("{0} of {1} frames could not be merged")]
    UnmergedFrames(usize, usize),
    /// Number of frames that failed, each of which has been reported, of all frames.
    #[error("{0} of {1} frames failed")]
    FailedFrames(usize, usize),
}

impl From<MergeError> for BatchError {
    fn from(error: MergeError) -> BatchError {
        match error {
            MergeError::Chunk(error) => BatchError::Image(error),
            error => BatchError::Merge(error),
        }
    }
}

impl From<RequestError> for BatchError {
    fn from(error: RequestError) -> BatchError {
        match error {
            RequestError::Cancelled(error) => BatchError::Cancelled(error),
            error => BatchError::Request(error),
        }
    }
}
