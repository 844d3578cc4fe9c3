//! Stack of the nodes and blocks that wait for their visit by a traversal.

use crate::mesh::simd::{SimdLevel, lanes};

use super::layout::{ChildLink, NativeNode, STACK, TreeView, WIDTH};

/// Node or block that waits for its visit.
#[derive(Clone, Copy)]
struct StackedChild {
    /// Parameter or depth from which on its box is entered.
    depth: f32,
    child: ChildLink,
}

/// Stack of waiting children, whose number the traversal keeps in a register. Allocated once for many traversals.
pub(super) struct ChildStack(Box<[StackedChild; STACK]>);

/// Child taken from a stack.
pub(super) struct PoppedChild {
    pub(super) child: ChildLink,
    /// Number of those left.
    pub(super) count: usize,
}

impl ChildStack {
    /// Allocates an empty stack.
    pub(super) fn new() -> ChildStack {
        let nothing = StackedChild {
            depth: 0.0,
            child: ChildLink::EMPTY,
        };
        ChildStack(Box::new([nothing; STACK]))
    }

    /// Pushes those children of a node that are in `mask` on the `count` others, the nearest on top, and starts to load
    /// them; returns the new number.
    #[inline(always)]
    pub(super) fn push(
        &mut self,
        isa: impl SimdLevel,
        (tree, node): (TreeView, &NativeNode),
        mask: u32,
        depths: &[f32; WIDTH],
        count: usize,
    ) -> usize {
        let Some(slots) = self.0[count % STACK..].first_chunk_mut::<WIDTH>() else {
            return count;
        };
        let mut pushed = 0;
        for slot in lanes(mask) {
            let slot = slot % WIDTH;
            let child = node.children[slot];
            prefetch(isa, tree, child);
            // Insert the child behind those that are nearer
            let depth = depths[slot];
            let mut position = pushed % WIDTH;
            while position > 0 && slots[position - 1].depth < depth {
                slots[position] = slots[position - 1];
                position -= 1;
            }
            slots[position] = StackedChild { depth, child };
            pushed += 1;
        }
        count + pushed
    }

    /// Takes the topmost of `count` children that is entered at `limit` or before, and drops those above it.
    #[inline(always)]
    pub(super) fn pop(&self, mut count: usize, limit: f32) -> Option<PoppedChild> {
        while count > 0 {
            count -= 1;
            let StackedChild { depth, child } = self.0[count % STACK];
            if depth <= limit {
                return Some(PoppedChild { child, count });
            }
        }
        None
    }
}

/// Starts to load a node or a block.
#[inline(always)]
pub(super) fn prefetch(isa: impl SimdLevel, tree: TreeView, child: ChildLink) {
    if child.is_leaf() {
        if let Some(block) = tree.blocks.get(child.index()) {
            isa.prefetch(block);
        }
    } else if let Some(node) = tree.nodes.get(child.index()) {
        isa.prefetch(node);
    }
}
