//! Traversal of the tree by a group.

use crate::accel::RayPacket;
use crate::mesh::simd::{SimdLevel, lanes};

use super::frustum::{DepthWindow, Frustum};
use super::leaf::test_block;
use super::projection::GroupProjection;
use super::query::GroupQuery;
use super::rays::{GroupRays, OFF};
use crate::accel::native::child_stack::{ChildStack, PoppedChild};
use crate::accel::native::layout::{ChildLink, NativeNode, TreeView, WIDTH};

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
                    count = stack.push(isa, (tree, node), mask, &depths.to_array(), count);
                }
            }
        }
        // Continue with the only child, or the nearest one that waits and that a ray reaches
        if let Some(only) = only {
            child = only;
            continue;
        }
        let Some(next) = stack.pop(count, rays.z_max) else {
            return;
        };
        PoppedChild { child, count } = next;
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
