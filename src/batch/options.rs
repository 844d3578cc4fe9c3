//! Options of a batch: its output folder, the part that one process renders, and limits.

use std::path::PathBuf;

use super::shard::Shard;

/// Options of a batch: its output folder, the part that one process renders, and limits.
#[derive(Clone, Debug, Default)]
pub struct BatchOptions {
    /// Output folder, which the paths of images are relative to.
    pub out: PathBuf,
    /// True if finished frames of an earlier run are kept.
    pub resume: bool,
    /// Part of the frames that this process renders.
    pub shard: Shard,
    /// Seconds after which finished parts of a frame are saved to disk.
    pub checkpoint: f64,
    /// Seconds after which no more samples of a frame are taken; unlimited if absent.
    pub time: Option<f64>,
    /// Bytes that all frames and scenes may take together; the free memory if absent.
    pub max_memory: Option<u64>,
    /// True if the outcome has a record of each frame.
    pub keeps_records: bool,
}
