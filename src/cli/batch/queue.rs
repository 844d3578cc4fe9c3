//! The frames that are a process's to make, in their order: which they are its shard tells, and which are done already
//! the manifest.

use std::iter::Peekable;
use std::ops::Range;
use std::vec::IntoIter;

use crate::batch::{Shard, Sources};

use super::super::failure::Failure;
use super::plan::Plan;
use super::recipe::Recipe;

/// A frame and the pieces of it that are to be made.
#[derive(Clone)]
pub(super) struct Task<'a> {
    pub(super) plan: &'a Plan,
    pub(super) recipe: Recipe,
    pub(super) pieces: Range<usize>,
}

/// Frames that wait.
pub(super) struct Queue<'a> {
    waiting: Peekable<IntoIter<(&'a Plan, Range<usize>)>>,
    sources: Sources,
}

impl<'a> Queue<'a> {
    /// The frames that a shard has pieces of, with these.
    pub(super) fn new(plans: &'a [Plan], shard: Shard) -> Queue<'a> {
        let total = plans.iter().map(Plan::piece_count).sum();
        let mine = shard.of(total);
        let mut first = 0;
        let mut tasks = Vec::new();
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

    /// How many wait.
    pub(super) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// The next ones that are of one scene and that `wants` says are to be made; none when all have been given. What a
    /// frame is made of may not be known: `wants` hears why.
    pub(super) fn next_scene(
        &mut self,
        mut wants: impl FnMut(&'a Plan, Result<Recipe, Failure>) -> Option<Recipe>,
    ) -> Vec<Task<'a>> {
        let mut tasks: Vec<Task> = Vec::new();
        let belongs = |tasks: &[Task], plan: &Plan| {
            tasks
                .first()
                .is_none_or(|first| first.plan.shares_scene_with(plan))
        };
        while let Some((plan, pieces)) = self.waiting.next_if(|(plan, _)| belongs(&tasks, plan)) {
            let recipe = wants(plan, Recipe::of(plan, &mut self.sources));
            tasks.extend(recipe.map(|recipe| Task { plan, recipe, pieces }));
        }
        tasks
    }
}
