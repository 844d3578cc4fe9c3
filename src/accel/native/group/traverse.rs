//! Traversal of the tree by a group.

use crate::accel::RayPacket;
use crate::mesh::simd::{SimdLevel, lanes};

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
pub(super) fn traverse<I: SimdLevel, P: GroupQuery>(
    isa: I,
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
            test_block::<I, P>(isa, tree, child.index(), rays, packets);
            if P::IS_ANY && rays.z_max == OFF {
                return;
            }
        } else {
            // Test the eight boxes against the frustum, then against the windows of rays
            let node = &tree.nodes[child.index()];
            let (mask, depths) = frustum.test(isa.eight(), node, rays.z_max);
            if mask != 0 {
                let mask = with_rays::<I, P::Projection>(isa, &frustum, rays, node, mask, &depths.to_array());
                if mask != 0 && mask & (mask - 1) == 0 {
                    only = Some(node.children[mask.trailing_zeros() as usize % WIDTH]);
                } else {
                    count = push(isa, tree, node, mask, &depths.to_array(), stack, count);
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
fn with_rays<I: SimdLevel, J: GroupProjection>(
    isa: I,
    frustum: &Frustum,
    rays: &GroupRays,
    node: &NativeNode,
    mask: u32,
    depths: &[f32; WIDTH],
) -> u32 {
    // Project the boxes
    let [u_min, u_max, v_min, v_max] = frustum.windows::<I::Eight, J>(isa.eight(), node);
    let mut kept = 0;
    // Look for a ray in the window of each
    for slot in lanes(mask) {
        let slot = slot % WIDTH;
        let target = DepthWindow {
            u_min: u_min[slot],
            u_max: u_max[slot],
            v_min: v_min[slot],
            v_max: v_max[slot],
            z_min: depths[slot],
        };
        if target.has_ray(isa, rays) {
            kept |= 1 << slot;
        }
    }
    kept
}

/// Pushes the children of `mask`, the nearest on top, and starts loading them; returns the new stack size.
#[inline(always)]
fn push(
    isa: impl SimdLevel,
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
        prefetch(isa, tree, child);
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
