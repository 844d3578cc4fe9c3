//! Nodes made by splitting ranges of items in two, again and again.

use super::margin::Margin;
use crate::accel::morton::Box4;
use crate::accel::native::layout::{ChildLink, NativeNode, WIDTH};

/// Depth from which ranges are split in the middle, which bounds the depth of the tree: below, a range of n items has at
/// most log2(n) levels. Over at most 2^23 chunks of at most 2^9 blocks that is 16 + 23 + 16 + 9, within
/// [`MAX_DEPTH`](crate::accel::native::layout::MAX_DEPTH).
pub(super) const MAX_SPLIT_DEPTH: usize = 16;

/// Range of items with their bounds.
#[derive(Clone, Copy, Debug)]
pub(super) struct ItemRange {
    pub(super) first: usize,
    pub(super) end: usize,
    pub(super) bounds: Box4,
    /// Half the surface area of the bounds.
    pub(super) area: f32,
}

impl ItemRange {
    #[inline(always)]
    pub(super) fn new(first: usize, end: usize, bounds: Box4) -> ItemRange {
        ItemRange {
            first,
            end,
            bounds,
            area: bounds.half_area(),
        }
    }

    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.end - self.first
    }
}

/// Items that are split by some criterion.
pub(super) trait Splitter {
    /// Splits a range of at least two items into two that are not empty, for a node at `depth`; may reorder the items.
    fn split(&mut self, range: &ItemRange, depth: usize) -> [ItemRange; 2];

    /// Returns the link to one item.
    fn link(&self, item: usize) -> ChildLink;
}

/// Ranges of a node's children.
pub(super) struct ChildRanges {
    ranges: [ItemRange; WIDTH],
    count: usize,
}

impl ChildRanges {
    /// Splits a range of at least two items, and always the one of the largest area among the results, until there are eight.
    #[inline(always)]
    pub(super) fn of(splitter: &mut impl Splitter, range: &ItemRange, depth: usize) -> ChildRanges {
        let mut ranges = [*range; WIDTH];
        let mut count = 1;
        while count < WIDTH {
            // Choose the largest that can be split
            let mut largest = None;
            let mut area = f32::NEG_INFINITY;
            for (member, range) in ranges[..count].iter().enumerate() {
                if range.len() > 1 && (range.area > area || largest.is_none()) {
                    (largest, area) = (Some(member), range.area);
                }
            }
            let Some(largest) = largest else { break };
            let [one, other] = splitter.split(&ranges[largest], depth);
            ranges[largest] = one;
            ranges[count] = other;
            count += 1;
        }
        ChildRanges { ranges, count }
    }

    /// Returns the ranges, of which each is of other items.
    pub(super) fn get(&self) -> &[ItemRange] {
        &self.ranges[..self.count]
    }
}

/// Nodes reserved for one tree.
pub(super) struct NodeSlots<'a> {
    nodes: &'a mut [NativeNode],
    /// Index of the first of these nodes in the tree's array.
    first: usize,
    used: usize,
    margin: Margin,
}

/// Returns the maximum number of nodes over `item_count` items, at least one.
///
/// A node has eight children, or children that are all items. By induction `(4 n - 1) / 7` nodes are enough for n items:
/// a node of 2 to 8 items is one; eight children need one and at most `Σ (4 nᵢ - 1) / 7 = (4 n - 8) / 7`.
pub(super) fn max_node_count(item_count: usize) -> usize {
    (4 * item_count - 1) / 7
}

impl<'a> NodeSlots<'a> {
    pub(super) fn new(nodes: &'a mut [NativeNode], first: usize, margin: Margin) -> NodeSlots<'a> {
        NodeSlots {
            nodes,
            first,
            used: 0,
            margin,
        }
    }

    /// Returns the number of nodes in use.
    pub(super) fn used(&self) -> usize {
        self.used
    }

    /// Adds the nodes over a range, parents first; returns the link to it.
    pub(super) fn add(&mut self, splitter: &mut impl Splitter, range: &ItemRange, depth: usize) -> ChildLink {
        if range.len() == 1 {
            return splitter.link(range.first);
        }
        // Reserve the node before those below
        let ranges = ChildRanges::of(splitter, range, depth);
        let own = self.used;
        self.used += 1;
        // Add the children, then store the node
        let mut node = NativeNode::EMPTY;
        for (slot, member) in ranges.get().iter().enumerate() {
            self.margin.store(&mut node, slot, &member.bounds);
            node.children[slot] = self.add(splitter, member, depth + 1);
        }
        self.nodes[own] = node;
        ChildLink::to_node(self.first + own)
    }
}
