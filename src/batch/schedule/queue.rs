//! Queue of the frames that this process renders: the shard selects them, and the manifest excludes those that are
//! done.

use std::iter::Peekable;
use std::ops::Range;
use std::vec::IntoIter;

use super::frame_fingerprint::FrameFingerprint;
use crate::batch::dependencies::Sources;
use crate::batch::error::BatchError;
use crate::batch::plan::PlannedFrame;
use crate::batch::shard::Shard;

/// Frame with the pieces of it to render.
#[derive(Clone)]
pub(super) struct Task<'a> {
    pub(super) plan: &'a PlannedFrame,
    pub(super) recipe: FrameFingerprint,
    pub(super) pieces: Range<usize>,
}

/// Frames that are not started yet, in order.
pub(super) struct Queue<'a> {
    waiting: Peekable<IntoIter<(&'a PlannedFrame, Range<usize>)>>,
    sources: Sources,
}

impl<'a> Queue<'a> {
    /// Returns the queue of the frames that have pieces in the shard.
    pub(super) fn new(plans: &'a [PlannedFrame], shard: Shard) -> Queue<'a> {
        let total = plans.iter().map(PlannedFrame::piece_count).sum();
        let mine = shard.of(total);
        let mut first = 0;
        let mut tasks = Vec::new();
        // Intersect the pieces of each frame with the shard's range
        for plan in plans {
            let end = first + plan.piece_count();
            let pieces = mine.start.max(first)..mine.end.min(end);
            if !pieces.is_empty() {
                tasks.push((plan, pieces.start - first..pieces.end - first));
            }
            first = end;
        }
        Queue {
            waiting: tasks.into_iter().peekable(),
            sources: Sources::default(),
        }
    }

    /// Returns the number of frames in the queue.
    pub(super) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Returns the next frames that share one scene and that `wants` accepts; an empty list at the end. If the inputs
    /// of a frame cannot be hashed, `wants` gets the error.
    pub(super) fn next_scene(
        &mut self,
        mut wants: impl FnMut(&'a PlannedFrame, Result<FrameFingerprint, BatchError>) -> Option<FrameFingerprint>,
    ) -> Vec<Task<'a>> {
        let mut tasks: Vec<Task> = Vec::new();
        let belongs = |tasks: &[Task], plan: &PlannedFrame| {
            tasks
                .first()
                .is_none_or(|first| first.plan.shares_scene_with(plan))
        };
        // Stop at the first frame of another scene
        while let Some((plan, pieces)) = self.waiting.next_if(|(plan, _)| belongs(&tasks, plan)) {
            let recipe = wants(plan, FrameFingerprint::of(plan, &mut self.sources));
            tasks.extend(recipe.map(|recipe| Task { plan, recipe, pieces }));
        }
        tasks
    }
}
