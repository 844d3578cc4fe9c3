//! Splits along the order of the items by the surface area heuristic: nothing is moved.

use super::nodes::{ItemRange, MAX_SPLIT_DEPTH, Splitter};
use crate::accel::morton::Box4;
use crate::accel::native::layout::ChildLink;

/// Blocks in the order of Morton codes, split where the sum of area times number of blocks is least.
pub(super) struct OrderSweep<'a> {
    /// Bounds of the blocks.
    pub(super) boxes: &'a [Box4],
    /// Index of the first block in the tree's array.
    pub(super) first_block: usize,
    /// Bounds of the blocks from each position to the end of the range, for reuse.
    pub(super) behind: &'a mut Vec<Box4>,
}

impl Splitter for OrderSweep<'_> {
    fn split(&mut self, range: &ItemRange, depth: usize) -> [ItemRange; 2] {
        let boxes = &self.boxes[range.first..range.end];
        // Bound the blocks from each position on
        self.behind.clear();
        self.behind.resize(boxes.len(), Box4::EMPTY);
        let mut bounds = Box4::EMPTY;
        for (behind, item) in self.behind.iter_mut().zip(boxes).rev() {
            bounds.add(item);
            *behind = bounds;
        }
        // Find the position of least cost
        let mut min_cost = f32::INFINITY;
        let mut ahead = boxes[0];
        let (mut middle, mut bounds_ahead) = (1, ahead);
        for position in 1..boxes.len() {
            let behind_count = (boxes.len() - position) as f32;
            let cost = ahead.half_area() * position as f32 + self.behind[position].half_area() * behind_count;
            if cost < min_cost {
                (min_cost, middle, bounds_ahead) = (cost, position, ahead);
            }
            ahead.add(&boxes[position]);
        }
        // Split deep ranges in the middle instead
        if depth >= MAX_SPLIT_DEPTH {
            middle = boxes.len() / 2;
            bounds_ahead = boxes[0];
            for item in &boxes[1..middle] {
                bounds_ahead.add(item);
            }
        }
        // Return both sides with their bounds
        let border = range.first + middle;
        [
            ItemRange::new(range.first, border, bounds_ahead),
            ItemRange::new(border, range.end, self.behind[middle]),
        ]
    }

    fn link(&self, item: usize) -> ChildLink {
        ChildLink::to_block(self.first_block + item)
    }
}
