//! Input of a study: scene, base configuration, limits and checkpoints.

use std::time::Instant;

use super::{Configuration, StudyCheckpoint, Target};
use crate::accel::AccelError;
use crate::image::{DenoiseError, Denoiser, ToneMap};
use crate::render::Cancelled;
use crate::scene::{Camera, ValidScene};

/// Input of a study: scene, base configuration and limits.
pub struct Experiment<'a> {
    /// Scene that the images show.
    pub scene: ValidScene<'a>,
    /// Camera that the images are rendered with.
    pub camera: &'a Camera,
    /// Base configuration, with the size of the final image.
    pub base: Configuration,
    /// Tone mapping of the displayed values.
    pub tone: ToneMap,
    /// Width and height of the measured images; `None` for the largest that the budget allows. `None` with a target,
    /// where patches of the complete image are measured.
    pub size: Option<[u32; 2]>,
    /// Target that settings are chosen for, if any.
    pub target: Option<Target>,
    /// Seconds for the whole study, counted from `start`.
    pub budget: f64,
    /// Time at which the study began.
    pub start: Instant,
    /// Number of threads of the current pool.
    pub threads: usize,
    /// Instruction set that Embree is restricted to.
    pub isa: Option<String>,
    /// Denoiser whose images are measured, too, where no target is given.
    pub denoiser: Option<&'a Denoiser>,
    /// Checkpoint of an interrupted study that is resumed; `start` is then earlier by the time that it had taken.
    pub unfinished: Option<StudyCheckpoint>,
    /// Checkpoint callback, called at intervals so that an interruption loses little.
    pub keep: Option<Keep<'a>>,
}

/// Function that stores a checkpoint, in the bytes that [`StudyCheckpoint::parse`] reads.
pub type Keep<'a> = &'a (dyn Fn(&[u8]) + Sync);

/// Reasons for which a study ends without a result.
#[derive(Debug, thiserror::Error)]
pub enum CostError {
    /// Cancellation by the observer's flag.
    #[error("interrupted")]
    Cancelled(#[from] Cancelled),
    /// Checkpoint that belongs to another scene, other settings or another version.
    #[error(
        "belongs to another scene, to other settings or to another version of whit: repeat the command of the \
         interrupted study, or leave out `--resume`"
    )]
    Other,
    /// Failure of the denoiser.
    #[error(transparent)]
    Denoise(#[from] DenoiseError),
    /// Failure to build an acceleration structure.
    #[error(transparent)]
    Accel(#[from] AccelError),
}
