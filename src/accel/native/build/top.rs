//! Tree over the chunks by the binned surface area heuristic.

use super::blocks::ChunkTree;
use super::margin::Margin;
use super::nodes::{ItemRange, MAX_SPLIT_DEPTH, NodeSlots, Splitter, max_node_count};
use crate::accel::morton::Box4;
use crate::accel::native::layout::{ChildLink, NativeNode};

/// Number of bins an axis.
const BINS: usize = 16;

/// Adds the nodes over all chunks behind those of the chunks, and returns the link to the root.
pub(super) fn build(mut trees: Vec<ChunkTree>, nodes: &mut [NativeNode], margin: Margin) -> ChildLink {
    // Bound all chunks
    let mut bounds = Box4::EMPTY;
    for tree in &trees {
        bounds.add(&tree.bounds);
    }
    let range = ItemRange::new(0, trees.len(), bounds);
    // Build behind the nodes of the chunks
    let first = nodes.len() - max_node_count(trees.len());
    let mut slots = NodeSlots::new(&mut nodes[first..], first, margin);
    let mut scratch = Vec::with_capacity(trees.len());
    let mut bins = BinnedChunks {
        trees: &mut trees,
        scratch: &mut scratch,
    };
    slots.add(&mut bins, &range, 0)
}

/// Trees of chunks, split where the sum of area times number of blocks is least among the borders of bins.
struct BinnedChunks<'a> {
    trees: &'a mut [ChunkTree],
    /// Room for the trees that move behind others.
    scratch: &'a mut Vec<ChunkTree>,
}

/// Contents of one bin, or of several.
#[derive(Clone, Copy)]
struct Bin {
    bounds: Box4,
    block_count: f32,
}

impl Bin {
    const EMPTY: Bin = Bin {
        bounds: Box4::EMPTY,
        block_count: 0.0,
    };

    fn add(&mut self, other: &Bin) {
        self.bounds.add(&other.bounds);
        self.block_count += other.block_count;
    }

    fn cost(&self) -> f32 {
        self.bounds.half_area() * self.block_count
    }
}

/// Bins along one axis.
#[derive(Clone, Copy)]
struct Axis {
    axis: usize,
    /// Twice the lower bound.
    origin: f32,
    /// Half the number of bins a unit.
    scale: f32,
}

impl Axis {
    fn new(axis: usize, bounds: &Box4) -> Axis {
        let extent = bounds.high[axis] - bounds.low[axis];
        let scale = 0.4999 * BINS as f32 / extent;
        Axis {
            axis,
            origin: 2.0 * bounds.low[axis],
            scale: if scale.is_finite() { scale } else { 0.0 },
        }
    }

    /// Returns the bin of a box by its centre.
    fn bin_of(&self, bounds: &Box4) -> usize {
        let twice_centre = bounds.twice_centre()[self.axis];
        (((twice_centre - self.origin) * self.scale) as usize).min(BINS - 1)
    }
}

/// Border between two bins, with its cost.
struct Border {
    axis: Axis,
    bin: usize,
    cost: f32,
    bounds: [Box4; 2],
}

impl BinnedChunks<'_> {
    /// Returns the border of least cost between bins that are not empty.
    fn best_border(&self, range: &ItemRange) -> Option<Border> {
        let mut best: Option<Border> = None;
        for axis in 0..3 {
            // Fill the bins
            let axis = Axis::new(axis, &range.bounds);
            let mut bins = [Bin::EMPTY; BINS];
            for tree in &self.trees[range.first..range.end] {
                bins[axis.bin_of(&tree.bounds)].add(&Bin {
                    bounds: tree.bounds,
                    block_count: tree.block_count as f32,
                });
            }
            // Sum up the bins from behind
            let mut behind = bins;
            for bin in (0..BINS - 1).rev() {
                let next = behind[bin + 1];
                behind[bin].add(&next);
            }
            // Sum them up from the front, and compare the costs of the borders
            let mut ahead = Bin::EMPTY;
            for bin in 1..BINS {
                ahead.add(&bins[bin - 1]);
                if ahead.block_count == 0.0 || behind[bin].block_count == 0.0 {
                    continue;
                }
                let cost = ahead.cost() + behind[bin].cost();
                if best.as_ref().is_none_or(|best| cost < best.cost) {
                    let bounds = [ahead.bounds, behind[bin].bounds];
                    best = Some(Border {
                        axis,
                        bin,
                        cost,
                        bounds,
                    });
                }
            }
        }
        best
    }

    fn split_in_the_middle(&self, range: &ItemRange) -> [ItemRange; 2] {
        let middle = range.first + range.len() / 2;
        [(range.first, middle), (middle, range.end)].map(|(first, end)| {
            let mut bounds = Box4::EMPTY;
            for tree in &self.trees[first..end] {
                bounds.add(&tree.bounds);
            }
            ItemRange::new(first, end, bounds)
        })
    }
}

impl Splitter for BinnedChunks<'_> {
    fn split(&mut self, range: &ItemRange, depth: usize) -> [ItemRange; 2] {
        // Find the border of least cost; split deep ranges in the middle
        let border = if depth < MAX_SPLIT_DEPTH {
            self.best_border(range)
        } else {
            None
        };
        let Some(border) = border else {
            return self.split_in_the_middle(range);
        };
        // Move the trees behind the border to the end, in their order
        self.scratch.clear();
        let mut middle = range.first;
        for position in range.first..range.end {
            let tree = self.trees[position];
            if border.axis.bin_of(&tree.bounds) >= border.bin {
                self.scratch.push(tree);
            } else {
                self.trees[middle] = tree;
                middle += 1;
            }
        }
        self.trees[middle..range.end].copy_from_slice(self.scratch);
        // Return both sides with their bounds
        let [ahead, behind] = border.bounds;
        [
            ItemRange::new(range.first, middle, ahead),
            ItemRange::new(middle, range.end, behind),
        ]
    }

    fn link(&self, item: usize) -> ChildLink {
        self.trees[item].root
    }
}
