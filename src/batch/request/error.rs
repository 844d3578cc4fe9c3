//! Reasons why a requested image cannot be rendered.

use std::path::PathBuf;

use crate::accel::AccelError;
use crate::batch::memory::in_words;
use crate::gltf::GltfError;
use crate::render::Cancelled;
use crate::scene::SceneError;
use crate::scene_file::SceneFileError;

/// Reason why a requested image cannot be rendered: one sentence with the item and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RequestError {
    /// Cancellation by the caller.
    #[error("interrupted")]
    Cancelled(#[from] Cancelled),
    /// Failure to build the acceleration structure.
    #[error(transparent)]
    Accel(#[from] AccelError),
    /// Scene file that cannot be read.
    #[error(transparent)]
    SceneFile(#[from] SceneFileError),
    /// glTF file that cannot be read.
    #[error(transparent)]
    Gltf(#[from] GltfError),
    /// Scene that cannot be rendered.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Edit of a glTF file, which has no keys.
    #[error("{} cannot have {edit}: sweeps change scene files only, so include it in a scene file", .path.display())]
    EditedGltf {
        /// Path of the glTF file.
        path: PathBuf,
        /// Edit as the job file has it.
        edit: String,
    },
    /// Camera that the scene does not have.
    #[error("{} has no camera `{requested}`: it has {known}", .path.display())]
    NoCamera {
        /// Path of the scene.
        path: PathBuf,
        /// Requested name or index.
        requested: String,
        /// Indices and names of the scene's cameras.
        known: String,
    },
    /// Image that does not fit into memory.
    #[error(
        "an image of {width}x{height} pixels takes {} of memory and {} are free: give a smaller `--size`",
        in_words(*.needed),
        in_words(*.free)
    )]
    TooLarge {
        /// Width of the image in pixels.
        width: u32,
        /// Height of the image in pixels.
        height: u32,
        /// Bytes that the image takes.
        needed: u64,
        /// Bytes that are available.
        free: u64,
    },
    /// Radius of a box filter, which has none.
    #[error("a box filter always covers one pixel: leave out `--filter-radius` or choose another `--filter`")]
    BoxRadius,
    /// Filter that adaptive sampling does not support.
    #[error(
        "`--adaptive` gives pixels different numbers of samples, which only the box filter supports: leave out \
         `--filter`, or give `--filter box` if the scene file has another"
    )]
    AdaptiveFilter,
    /// Channels that adaptive sampling does not support.
    #[error(
        "`--adaptive` supports only the channels `samples`, `rays` and `time`: give `--aov` only these, or leave out \
         `--adaptive`"
    )]
    AdaptiveChannels,
    /// Sampling pattern that adaptive sampling does not support.
    #[error(
        "a regular pattern repeats the same samples in every round of `--adaptive`: choose another `--pattern`"
    )]
    AdaptivePattern,
    /// Layers of light with a filter that spreads samples over several pixels.
    #[error(
        "`--aov lights` and `--aov effects` are not filtered and would not add up to the image: leave out `--filter`, \
         or give `--filter box` if the scene file has another"
    )]
    FilteredLights,
    /// Thread pool that cannot be started.
    #[error("cannot start {threads} threads: {error}; give fewer `--threads`")]
    Threads {
        /// Number of requested threads.
        threads: usize,
        /// Error of the operating system.
        error: rayon::ThreadPoolBuildError,
    },
}
