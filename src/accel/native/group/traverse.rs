//! Traversal of the tree by a group.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{SimdLevel, lanes};

use super::frustum::{DepthWindow, Frustum};
use super::leaf::{few_rays, test_block};
use super::query::GroupQuery;
use super::rays::{GroupRays, OFF};
use crate::accel::native::child_stack::{ChildStack, prefetch};
use crate::accel::native::layout::{ChildLink, NativeNode, TreeView, WIDTH};

/// Maximum number of rays in a block's box that are listed before its triangles are projected. A full packet has more,
/// so that with many samples a pixel the search ends at the first packet. With 15, tracing takes 0.9 of the time without
/// such lists (10 million triangles, one sample a pixel) or the same (2 million, 16 samples); with 32 it takes 1.08 times
/// as long for the latter.
const MAX_SPARSE_RAYS: usize = LANES - 1;

/// Finds the hits of all rays of a group, which are those of `packets`.
#[inline(always)]
pub(super) fn traverse<I: SimdLevel, P: GroupQuery>(
    isa: I,
    tree: TreeView,
    rays: &mut GroupRays,
    packets: &[RayPacket],
    stack: &mut ChildStack,
) {
    if tree.root == ChildLink::EMPTY {
        return;
    }
    let frustum = Frustum::new::<P::Projection>(rays, tree.bounds);
    // Start at the root; a tree of one block gets a node around it
    let above_root;
    let mut node = if tree.root.is_leaf() {
        above_root = NativeNode::of_one(tree.bounds, tree.root);
        &above_root
    } else {
        &tree.nodes[tree.root.index()]
    };
    let mut count = 0;
    loop {
        let mut only = None;
        // Test the eight boxes against the frustum
        let (mask, depths) = frustum.test(isa.eight(), node, rays.z_max);
        if mask != 0 {
            let children = ChildWindows {
                borders: frustum.windows::<I::Eight, P::Projection>(isa.eight(), node),
                depths: depths.to_array(),
            };
            // Test the blocks among them
            let blocks = mask & node.blocks(isa.eight());
            children.test_blocks::<I, P>(isa, (tree, node), blocks, rays, packets);
            if P::IS_ANY && rays.z_max == OFF {
                return;
            }
            // Keep the nodes among them that rays reach
            let nodes = children.with_rays(isa, rays, mask & !blocks);
            if nodes != 0 && nodes & (nodes - 1) == 0 {
                only = Some(node.children[nodes.trailing_zeros() as usize % WIDTH]);
            } else {
                count = stack.push(isa, (tree, node), nodes, &children.depths, count);
            }
        }
        // Continue with the only node, or the nearest one that waits and that a ray reaches
        let child = match only {
            Some(only) => only,
            None => {
                let Some(next) = stack.pop(count, rays.z_max) else {
                    return;
                };
                count = next.count;
                next.child
            }
        };
        node = &tree.nodes[child.index()];
    }
}

/// Windows and least depths of a node's boxes.
struct ChildWindows {
    /// Low u, high u, low v and high v of each box.
    borders: [[f32; WIDTH]; 4],
    depths: [f32; WIDTH],
}

impl ChildWindows {
    /// Returns the window of a box.
    #[inline(always)]
    fn window(&self, slot: usize) -> DepthWindow {
        let [u_min, u_max, v_min, v_max] = &self.borders;
        DepthWindow {
            u_min: u_min[slot],
            u_max: u_max[slot],
            v_min: v_min[slot],
            v_max: v_max[slot],
            z_min: self.depths[slot],
        }
    }

    /// Tests the children of `mask`, which are blocks, where rays reach them: for the nearest hits the nearest first.
    #[inline(always)]
    fn test_blocks<I: SimdLevel, P: GroupQuery>(
        &self,
        isa: I,
        (tree, node): (TreeView, &NativeNode),
        mask: u32,
        rays: &mut GroupRays,
        packets: &[RayPacket],
    ) {
        // Start to load them, and sort them by depth
        let mut order = [0; WIDTH];
        let mut count = 0;
        for slot in lanes(mask) {
            let slot = slot % WIDTH;
            prefetch(isa, tree, node.children[slot]);
            let mut position = count % WIDTH;
            if !P::IS_ANY {
                while position > 0 && self.depths[order[position - 1] % WIDTH] > self.depths[slot] {
                    order[position] = order[position - 1];
                    position -= 1;
                }
            }
            order[position] = slot;
            count += 1;
        }
        // Test each with the rays in its window, which are listed if they are few
        for &slot in order.iter().take(count) {
            let slot = slot % WIDTH;
            let list = few_rays(isa, &self.window(slot), rays, MAX_SPARSE_RAYS);
            match &list {
                Some(list) if list.count == 0 => {}
                _ => test_block::<I, P>(isa, tree, node.children[slot].index(), list, rays, packets),
            }
        }
    }

    /// Returns the children of `mask` whose window contains a ray that reaches their depth.
    #[inline(always)]
    fn with_rays(&self, isa: impl SimdLevel, rays: &GroupRays, mask: u32) -> u32 {
        let mut kept = 0;
        for slot in lanes(mask) {
            let slot = slot % WIDTH;
            if self.window(slot).has_ray(isa, rays) {
                kept |= 1 << slot;
            }
        }
        kept
    }
}
