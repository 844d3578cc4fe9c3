//! Memory layout of the tree: nodes with the boxes of eight children, and blocks of eight triangles as leaves.

use crate::buffer::BufferMut;
use crate::mesh::simd::{Floats, WideLevel};
use crate::mesh::triangle::{PACK, TrianglePack};

/// Number of children of a node.
pub(super) const WIDTH: usize = 8;
/// Index in an unused slot of a block.
pub(super) const NO_NUMBER: u32 = u32::MAX;
/// Maximum number of nodes on a path from the root to a leaf, which the builder keeps to.
pub(super) const MAX_DEPTH: usize = 64;
/// Maximum number of stack entries of a traversal: every level leaves all but one of its children behind, and the last
/// adds a full set. Rounded up to a power of two, by which an index is limited without a division.
pub(super) const STACK: usize = (MAX_DEPTH * (WIDTH - 1) + WIDTH).next_power_of_two();

/// Link to a node or to a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub(super) struct ChildLink(u32);

impl ChildLink {
    /// Flag of a link to a block.
    const LEAF: u32 = 1 << 31;
    /// Maximum number of nodes, and of blocks: slots of the triangles in blocks are numbered by u32, too.
    pub(super) const LIMIT: usize = u32::MAX as usize / PACK;
    /// Link of an unused slot.
    pub(super) const EMPTY: ChildLink = ChildLink(u32::MAX);

    /// Returns the link to a node; the index must be below [`ChildLink::LIMIT`].
    #[inline(always)]
    pub(super) fn to_node(index: usize) -> ChildLink {
        debug_assert!(index < ChildLink::LIMIT);
        ChildLink(index as u32)
    }

    /// Returns the link to a block; the index must be below [`ChildLink::LIMIT`].
    #[inline(always)]
    pub(super) fn to_block(index: usize) -> ChildLink {
        debug_assert!(index < ChildLink::LIMIT);
        ChildLink(index as u32 | ChildLink::LEAF)
    }

    /// Returns whether the link is that of a block, or of an unused slot.
    #[inline(always)]
    pub(super) fn is_leaf(self) -> bool {
        self.0 & ChildLink::LEAF != 0
    }

    /// Returns the index of the node or the block.
    #[inline(always)]
    pub(super) fn index(self) -> usize {
        (self.0 & !ChildLink::LEAF) as usize
    }
}

/// Node with the boxes of its children.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct NativeNode {
    /// Bounds by side (low, high), axis and child. Those of unused children are low +∞ and high -∞.
    pub(super) bounds: [[[f32; WIDTH]; 3]; 2],
    /// Links to nodes or blocks.
    pub(super) children: [ChildLink; WIDTH],
}

impl NativeNode {
    /// Node without any children.
    pub(super) const EMPTY: NativeNode = NativeNode {
        bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
        children: [ChildLink::EMPTY; WIDTH],
    };

    /// Returns a node with one child.
    pub(super) fn of_one(bounds: &Box3, child: ChildLink) -> NativeNode {
        let mut node = NativeNode::EMPTY;
        for axis in 0..3 {
            node.bounds[0][axis][0] = bounds.low[axis];
            node.bounds[1][axis][0] = bounds.high[axis];
        }
        node.children[0] = child;
        node
    }

    /// Returns a mask of the children that are blocks or unused.
    #[inline(always)]
    pub(super) fn blocks<W: WideLevel<WIDTH>>(&self, eight: W) -> u32 {
        // The flag is the sign
        Floats::load(eight, bytemuck::cast_ref(&self.children)).signs()
    }
}

/// Leaf of up to eight triangles.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct LeafBlock {
    /// Vertices of the triangles; NaN in unused slots, so that no ray hits them.
    pub(super) triangles: TrianglePack,
    /// Running indices of the triangles over all meshes; [`NO_NUMBER`] in unused slots.
    pub(super) numbers: [u32; PACK],
}

/// Axis-aligned box in f32.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Box3 {
    /// Lower corner of the box.
    pub(super) low: [f32; 3],
    /// Upper corner of the box.
    pub(super) high: [f32; 3],
}

/// Tree of eight-wide nodes over blocks of eight triangles.
///
/// Its memory is 320 bytes a block and 224 bytes a node, less than 60 bytes a triangle. A few nodes are unused: those
/// that a task of the builder reserved and did not need.
#[derive(Debug)]
pub(super) struct GroupTree {
    /// Link to the root: [`ChildLink::EMPTY`] for a tree without triangles.
    pub(super) root: ChildLink,
    /// Bounds of all triangles.
    pub(super) bounds: Box3,
    pub(super) nodes: BufferMut<NativeNode>,
    /// Leaves of the tree.
    pub(super) blocks: BufferMut<LeafBlock>,
}

impl GroupTree {
    /// Returns the tree as its traversals read it.
    pub(super) fn view(&self) -> TreeView<'_> {
        TreeView {
            root: self.root,
            bounds: &self.bounds,
            nodes: &self.nodes,
            blocks: &self.blocks,
        }
    }

    /// Returns the size of nodes and blocks in bytes.
    pub(super) fn byte_count(&self) -> usize {
        size_of_val(&*self.nodes) + size_of_val(&*self.blocks)
    }
}

/// Tree whose arrays are resolved once, because a `BufferMut` tests at every access where its values are.
#[derive(Clone, Copy, Debug)]
pub(super) struct TreeView<'t> {
    /// Link to the root: [`ChildLink::EMPTY`] for a tree without triangles.
    pub(super) root: ChildLink,
    /// Bounds of all triangles.
    pub(super) bounds: &'t Box3,
    pub(super) nodes: &'t [NativeNode],
    /// Leaves of the tree.
    pub(super) blocks: &'t [LeafBlock],
}

/// Triangle of a leaf.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlotTriangle {
    /// Running index over all meshes.
    pub(super) number: u32,
    /// Vertices by corner and axis.
    pub(super) corners: [[f32; 3]; 3],
}

impl TreeView<'_> {
    /// Returns the number of the slot of triangle `i` of a block.
    #[inline(always)]
    pub(super) fn slot(block: usize, i: usize) -> u32 {
        (PACK * block + i) as u32
    }

    /// Returns the triangle in the slot of a number.
    #[inline(always)]
    pub(super) fn triangle_at(&self, slot: u32) -> SlotTriangle {
        let (block, i) = (&self.blocks[slot as usize / PACK], slot as usize % PACK);
        SlotTriangle {
            number: block.numbers[i],
            corners: block.triangles.triangle(i),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn link_distinguishes_node_from_block() {
        assert!(!ChildLink::to_node(5).is_leaf() && ChildLink::to_node(5).index() == 5);
        assert!(ChildLink::to_block(5).is_leaf() && ChildLink::to_block(5).index() == 5);
        assert!(ChildLink::EMPTY.is_leaf());
    }

    #[test]
    fn nodes_and_blocks_have_no_padding() {
        assert_eq!((size_of::<NativeNode>(), size_of::<LeafBlock>()), (224, 320));
    }
}
