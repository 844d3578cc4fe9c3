//! Rendering of a batch: which frames are rendered concurrently, within which memory, and how each is saved.

mod batch_run;
mod built_scene;
mod forecast;
mod frame;
mod frame_fingerprint;
mod limits;
mod merge_frames;
mod observer;
mod queue;
mod row_schedule;
mod scene_slots;

pub use batch_run::{Batch, BatchOutcome};
pub use forecast::{FrameCost, forecast};
pub(crate) use frame::FrameResult;
pub use merge_frames::merge_frames;
pub use observer::{BatchObserver, FrameEvent, TileCallback};
