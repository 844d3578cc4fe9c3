//! Batches of frames that survive interruptions, and the images that they and single renders request.
//!
//! An image is requested before its scene is opened ([`request`]). A batch renders many of them ([`Batch`]): frames of
//! one scene concurrently, at least two at a time, so that while one is written or runs out of tiles, another uses the
//! processors; small scenes with a single frame overlap in the same way.
//!
//! A batch resumes by the hashes of its frames' inputs and a manifest of the frames that are done; a [`Shard`] assigns
//! frames to processes; finished pieces of a frame are stored until it is complete. Output files appear whole, and have
//! the same bits regardless of the process that makes them; so any process may be killed at any time, and two processes
//! that make the same output do no harm to each other.

mod dependencies;
mod error;
mod fingerprint;
mod lock;
mod manifest;
pub mod memory;
mod ongoing_writes;
mod options;
mod pieces;
mod plan;
pub mod request;
mod schedule;
mod shard;
pub mod slurm;

pub use error::BatchError;
pub use ongoing_writes::OngoingWrites;
pub use options::BatchOptions;
pub use pieces::MergeError;
pub use plan::{PlannedFrame, check_division, make_folders};
pub(crate) use schedule::FrameResult;
pub use schedule::{
    Batch, BatchObserver, BatchOutcome, FrameCost, FrameEvent, TileCallback, forecast, merge_frames,
};
pub use shard::Shard;
