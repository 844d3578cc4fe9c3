//! Progress, warnings and interruption of a batch, for its caller.

use std::sync::atomic::AtomicBool;

use crate::batch::error::BatchError;
use crate::batch::ongoing_writes::OngoingWrites;
use crate::batch::plan::PlannedFrame;
use crate::render::FinishedTile;

/// Callback that receives the finished tiles of frames.
pub type TileCallback<'a> = &'a (dyn Fn(&PlannedFrame, FinishedTile) + Sync);

/// Callbacks, cancellation flag and count of writes that connect a batch with its caller, from any thread.
#[derive(Clone, Copy)]
pub struct BatchObserver<'a> {
    /// Callback that receives warnings, one sentence each.
    pub warn: &'a (dyn Fn(&str) + Sync),
    /// Callback that receives the events of each frame.
    pub event: &'a (dyn Fn(&PlannedFrame, FrameEvent) + Sync),
    /// Callback that receives the finished tiles of each frame, for a live preview.
    pub tiles: Option<TileCallback<'a>>,
    /// Flag that stops the batch when it is set.
    pub cancel: &'a AtomicBool,
    /// Count of the files being written, for which an interruption waits.
    pub writes: &'a OngoingWrites,
}

/// Event of a frame. Each frame is skipped, or begins and then is done, fails or is interrupted.
#[derive(Debug)]
pub enum FrameEvent {
    /// The frame is complete already.
    Skipped,
    /// Work on the frame begins.
    Begun,
    /// An image of this width and height is about to be rendered.
    Sized([u32; 2]),
    /// This fraction of the frame is rendered, or in a forecast this fraction of all frames probed.
    Progress(f64),
    /// Rendering has ended, with success or without.
    Rendered,
    /// The image, or this process's part of it, is written.
    Done,
    /// The frame has no image, for this reason.
    Failed(BatchError),
    /// The batch was cancelled before the frame was done.
    Interrupted,
}
