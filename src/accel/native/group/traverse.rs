//! Traversal of the tree by a group.

use crate::accel::RayPacket;
use crate::mesh::simd::{WideLevel, lanes};

use super::frame::splat;
use super::frustum::{DepthWindow, Frustum};
use super::leaf::test_block;
use super::projection::GroupProjection;
use super::query::GroupQuery;
use super::rays::{GroupRays, OFF};
use crate::accel::native::layout::{ChildLink, NativeNode, STACK, TreeView, WIDTH};
use crate::accel::native::single::prefetch;

/// Node or block that waits for its visit, with its least depth.
#[derive(Clone, Copy)]
pub(super) struct Waiting {
    depth: f32,
    child: ChildLink,
}

/// Traversal stack. Allocated once for many groups.
pub(super) struct GroupStack([Waiting; STACK]);

impl GroupStack {
    /// Allocates an empty stack.
    pub(super) fn new() -> Box<GroupStack> {
        let nothing = Waiting {
            depth: 0.0,
            child: ChildLink::EMPTY,
        };
        Box::new(GroupStack([nothing; STACK]))
    }
}

/// Finds the hits of all rays of a group, which are those of `packets`.
#[inline(always)]
pub(super) fn traverse<W: WideLevel, P: GroupQuery>(
    wide: W,
    tree: TreeView,
    rays: &mut GroupRays,
    packets: &[RayPacket],
    stack: &mut GroupStack,
) {
    if tree.root == ChildLink::EMPTY {
        return;
    }
    let frustum = Frustum::new::<P::Projection>(rays, tree.bounds);
    let mut child = tree.root;
    let mut count = 0;
    loop {
        let mut only = None;
        if child.is_leaf() {
            // Test the triangles; stop if all rays are blocked
            test_block::<W, P>(wide, &tree.blocks[child.index()], rays, packets);
            if P::IS_ANY && rays.z_max == OFF {
                return;
            }
        } else {
            // Test the eight boxes against the frustum, then against the windows of rays
            let node = &tree.nodes[child.index()];
            let (mask, depths) = frustum.test(wide, node, rays.z_max);
            if mask != 0 {
                let mask =
                    with_rays::<W, P::Projection>(wide, &frustum, rays, node, mask, &depths.to_array());
                if mask != 0 && mask & (mask - 1) == 0 {
                    only = Some(node.children[mask.trailing_zeros() as usize % WIDTH]);
                } else {
                    count = push(wide, tree, node, mask, &depths.to_array(), stack, count);
                }
            }
        }
        // Continue with the only child, or the nearest one that waits and that a ray reaches
        if let Some(only) = only {
            child = only;
            continue;
        }
        loop {
            if count == 0 {
                return;
            }
            count -= 1;
            let next = stack.0[count % STACK];
            if next.depth <= rays.z_max {
                child = next.child;
                break;
            }
        }
    }
}

/// Returns the children of `mask` whose window contains a ray that reaches their depth.
#[inline(always)]
fn with_rays<W: WideLevel, J: GroupProjection>(
    wide: W,
    frustum: &Frustum,
    rays: &GroupRays,
    node: &NativeNode,
    mask: u32,
    depths: &[f32; WIDTH],
) -> u32 {
    // Project the boxes
    let [u_min, u_max, v_min, v_max] = frustum.windows::<W, J>(wide, node);
    let mut kept = 0;
    // Look for a ray in the window of each
    for slot in lanes(mask) {
        let slot = slot % WIDTH;
        let target = DepthWindow {
            u_min: splat(wide, u_min[slot]),
            u_max: splat(wide, u_max[slot]),
            v_min: splat(wide, v_min[slot]),
            v_max: splat(wide, v_max[slot]),
            z_min: splat(wide, depths[slot]),
        };
        if target.has_ray(wide, rays) {
            kept |= 1 << slot;
        }
    }
    kept
}

/// Pushes the children of `mask`, the nearest on top, and starts loading them; returns the new stack size.
#[inline(always)]
fn push<W: WideLevel>(
    wide: W,
    tree: TreeView,
    node: &NativeNode,
    mask: u32,
    depths: &[f32; WIDTH],
    stack: &mut GroupStack,
    first: usize,
) -> usize {
    let Some(slots) = stack.0[first % STACK..].first_chunk_mut::<WIDTH>() else {
        return first;
    };
    let mut count = 0;
    for slot in lanes(mask) {
        let slot = slot % WIDTH;
        let child = node.children[slot];
        prefetch(wide, tree, child);
        // Insert the child behind those that are nearer
        let depth = depths[slot];
        let mut position = count % WIDTH;
        while position > 0 && slots[position - 1].depth < depth {
            slots[position] = slots[position - 1];
            position -= 1;
        }
        slots[position] = Waiting { depth, child };
        count += 1;
    }
    first + count
}
