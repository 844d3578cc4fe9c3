//! Tree over the chunks by the binned surface area heuristic.

use std::sync::{Mutex, PoisonError};

use glam::Vec3A;

use super::blocks::ChunkTree;
use super::margin::Margin;
use super::nodes::{ChildRanges, ItemRange, MAX_SPLIT_DEPTH, NodeSlots, Splitter, max_node_count};
use crate::accel::morton::Box4;
use crate::accel::native::layout::{ChildLink, NativeNode};
use crate::parallel;

/// Number of bins an axis.
const BINS: usize = 16;

/// Number of chunks from which the children of a node are built in parallel.
const PARALLEL: usize = 1 << 9;

/// Adds the nodes over all chunks behind those of the chunks, and returns the link to the root.
pub(super) fn build(mut trees: Vec<ChunkTree>, nodes: &mut [NativeNode], margin: Margin) -> ChildLink {
    // Bound all chunks
    let mut bounds = Box4::EMPTY;
    for tree in &trees {
        bounds.add(&tree.bounds);
    }
    // Build behind the nodes of the chunks
    let first = nodes.len() - max_node_count(trees.len());
    let mut task = TopTask {
        trees: &mut trees,
        bounds,
        nodes: &mut nodes[first..],
        first,
    };
    task.run(margin, 0)
}

/// Some chunks, with the room for the nodes over them.
struct TopTask<'a> {
    trees: &'a mut [ChunkTree],
    bounds: Box4,
    nodes: &'a mut [NativeNode],
    /// Index of the first of these nodes in the tree's array.
    first: usize,
}

impl TopTask<'_> {
    /// Adds the nodes over the chunks, and returns the link to the highest one.
    fn run(&mut self, margin: Margin, depth: usize) -> ChildLink {
        let range = ItemRange::new(0, self.trees.len(), self.bounds);
        let mut bins = BinnedChunks {
            trees: &mut *self.trees,
            scratch: Vec::with_capacity(range.len()),
        };
        // Build a short range at once
        if range.len() < PARALLEL {
            return NodeSlots::new(self.nodes, self.first, margin).add(&mut bins, &range, depth);
        }
        // Divide the chunks among the children, each with room for its nodes
        let ranges = ChildRanges::of(&mut bins, &range, depth);
        let (nodes, mut nodes_left) = self.nodes.split_at_mut(1);
        let mut first = self.first + 1;
        // Their order in the array is that of the chunks
        let mut order: Vec<usize> = (0..ranges.get().len()).collect();
        order.sort_unstable_by_key(|&slot| ranges.get()[slot].first);
        let mut trees_left = &mut *self.trees;
        let mut children: Vec<Mutex<TopTask>> = Vec::with_capacity(order.len());
        for &slot in &order {
            let range = &ranges.get()[slot];
            let (trees, behind) = trees_left.split_at_mut(range.len());
            let (nodes, nodes_behind) = nodes_left.split_at_mut(max_node_count(range.len()));
            (trees_left, nodes_left) = (behind, nodes_behind);
            let node_count = nodes.len();
            children.push(Mutex::new(TopTask {
                trees,
                bounds: range.bounds,
                nodes,
                first,
            }));
            first += node_count;
        }
        // Build them in parallel, then store the node
        let links = parallel::map(children.len(), &|child| {
            let mut child = children[child].lock().unwrap_or_else(PoisonError::into_inner);
            child.run(margin, depth + 1)
        });
        let mut node = NativeNode::EMPTY;
        for (slot, link) in order.into_iter().zip(links) {
            margin.store(&mut node, slot, &ranges.get()[slot].bounds);
            node.children[slot] = link;
        }
        nodes[0] = node;
        ChildLink::to_node(self.first)
    }
}

/// Trees of chunks, split where the sum of area times number of blocks is least among the borders of bins.
struct BinnedChunks<'a> {
    trees: &'a mut [ChunkTree],
    /// Room for the trees that move behind others.
    scratch: Vec<ChunkTree>,
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

/// Bins along each axis.
#[derive(Clone, Copy)]
struct BinAxes {
    /// Twice the lower bounds.
    origin: Vec3A,
    /// Half the number of bins a unit.
    scale: Vec3A,
}

impl BinAxes {
    fn new(bounds: &Box4) -> BinAxes {
        let scale = 0.4999 * BINS as f32 / (bounds.high - bounds.low);
        BinAxes {
            origin: 2.0 * bounds.low,
            scale: Vec3A::from(
                scale
                    .to_array()
                    .map(|scale| if scale.is_finite() { scale } else { 0.0 }),
            ),
        }
    }

    /// Returns the bins of a box by its centre, one for each axis.
    #[inline(always)]
    fn bins_of(&self, bounds: &Box4) -> [usize; 3] {
        let bins = ((bounds.twice_centre() - self.origin) * self.scale).to_array();
        bins.map(|bin| (bin as u32 as usize).min(BINS - 1))
    }
}

/// Border between two bins, with its cost.
struct Border {
    axis: usize,
    bin: usize,
    cost: f32,
    bounds: [Box4; 2],
}

impl BinnedChunks<'_> {
    /// Returns the border of least cost between bins that are not empty.
    fn best_border(&self, range: &ItemRange, axes: &BinAxes) -> Option<Border> {
        // Fill the bins of all axes
        let mut bins = [[Bin::EMPTY; BINS]; 3];
        for tree in &self.trees[range.first..range.end] {
            let of_tree = Bin {
                bounds: tree.bounds,
                block_count: tree.block_count as f32,
            };
            for (bins, bin) in bins.iter_mut().zip(axes.bins_of(&tree.bounds)) {
                bins[bin].add(&of_tree);
            }
        }
        let mut best: Option<Border> = None;
        for (axis, bins) in bins.iter().enumerate() {
            // Sum up the bins from behind
            let mut behind = *bins;
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
        let axes = BinAxes::new(&range.bounds);
        let border = if depth < MAX_SPLIT_DEPTH {
            self.best_border(range, &axes)
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
            if axes.bins_of(&tree.bounds)[border.axis] >= border.bin {
                self.scratch.push(tree);
            } else {
                self.trees[middle] = tree;
                middle += 1;
            }
        }
        self.trees[middle..range.end].copy_from_slice(&self.scratch);
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
