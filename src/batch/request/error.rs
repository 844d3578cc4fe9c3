//! Reasons why a requested image cannot be rendered.

use std::path::PathBuf;

use crate::accel::AccelError;
use crate::batch::memory::in_words;
use crate::gltf::GltfError;
use crate::image::ImageError;
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
    /// glTF file with an edit of a key, which it does not have.
    #[error("{} cannot have {}: sweeps change scene files only, so include it in a scene file", .0.display(), .1)]
    EditedGltf(PathBuf, String),
    /// Scene without the `requested` camera; `known` lists those that it has.
    #[error("{} has no camera `{requested}`: it has {known}", .path.display())]
    NoCamera {
        path: PathBuf,
        requested: String,
        known: String,
    },
    /// Environment map that cannot be read.
    #[error("`--environment`: {0}")]
    Environment(ImageError),
    /// Image that takes more bytes than are free.
    #[error(
        "an image of {width}x{height} pixels takes {} of memory and {} are free: give a smaller `--size`",
        in_words(*.needed),
        in_words(*.free)
    )]
    TooLarge {
        width: u32,
        height: u32,
        needed: u64,
        free: u64,
    },
    /// Radius of a box filter, which has none.
    #[error("a box filter always covers one pixel: leave out `--filter-radius` or choose another `--filter`")]
    BoxRadius,
    /// Filter that the flag does not support.
    #[error(
        "`{0}` gives pixels different numbers of samples, which only the box filter supports: leave out \
         `--filter`, or give `--filter box` if the scene file has another"
    )]
    UnequalCountsFilter(&'static str),
    /// Transparent background, which the flag does not support.
    #[error(
        "`{0}` does not measure the coverage that a transparent background needs: leave out `{0}`, or give another \
         `--background`"
    )]
    UnequalCountsAlpha(&'static str),
    /// Channels that the flag does not support.
    #[error(
        "`{0}` supports only the channels `samples`, `rays` and `time`: give `--aov` only these, or leave out `{0}`"
    )]
    UnequalCountsChannels(&'static str),
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
    /// Number of threads that cannot be started.
    #[error("cannot start {0} threads: {1}; give fewer `--threads`")]
    Threads(usize, rayon::ThreadPoolBuildError),
}
