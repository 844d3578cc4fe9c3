//! Traversal with one ray at a time: eight boxes at a time, then eight triangles at a time.
//!
//! The triangle test is the watertight one of `mesh::triangle`, so results are those of the other backends.

use crate::accel::bsp::error_bounds::Line;
use crate::accel::{Hit, LANES, Query, RayPacket};
use crate::mesh::simd::{Floats, SimdKernel, SimdLevel, SimdLimit, lanes};
use crate::mesh::triangle::{PACK, Shear};
use crate::numeric::Ray;

use super::child_stack::{ChildStack, PoppedChild};
use super::layout::{ChildLink, NativeNode, TreeView, WIDTH};

/// Finds the hits of every active lane for a query, one ray at a time.
pub(super) fn trace(simd: SimdLimit, tree: TreeView, packets: &mut [RayPacket], query: Query) {
    trace_sparse(simd, tree, packets, query, u32::MAX);
}

/// Finds the hits of the active lanes of those packets that have fewer than `limit`, one ray at a time.
pub(super) fn trace_sparse(
    simd: SimdLimit,
    tree: TreeView,
    packets: &mut [RayPacket],
    query: Query,
    limit: u32,
) {
    simd.dispatch(SingleRays {
        tree,
        packets,
        query,
        limit,
    });
}

/// Packets whose rays are traced one after the other.
struct SingleRays<'a> {
    tree: TreeView<'a>,
    packets: &'a mut [RayPacket],
    query: Query,
    /// Number of active lanes from which on packets are left out.
    limit: u32,
}

impl SimdKernel for SingleRays<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        let mut stack = ChildStack::new();
        for packet in self.packets {
            // Leave out what was traced in packets, where rays that are blocked would not be traceable
            if packet.active_mask().count_ones() < self.limit {
                packet.drop_untraceable();
                let active = packet.active_mask();
                for lane in lanes(active) {
                    trace_lane(isa, self.tree, packet, lane % LANES, self.query, &mut stack);
                }
            }
        }
    }
}

/// Traces the ray of one lane and writes the result into the packet.
#[inline(always)]
pub(super) fn trace_lane(
    isa: impl SimdLevel,
    tree: TreeView,
    packet: &mut RayPacket,
    lane: usize,
    query: Query,
    stack: &mut ChildStack,
) {
    let ray = packet.ray(lane);
    // Compile a kernel for each kind of query
    match query {
        Query::Nearest => {
            if let Some(hit) = traverse(isa, tree, &ray, Query::Nearest, stack) {
                packet.set_hit(lane, &hit);
            }
        }
        Query::Any => {
            if traverse(isa, tree, &ray, Query::Any, stack).is_some() {
                packet.set_blocked(lane);
            }
        }
    }
}

/// Ray with precomputed data for slab and triangle tests.
struct SingleRay {
    line: Line,
    shear: Shear,
    t_near: f32,
    /// Side of the box that the ray enters first, by axis: 0 for the low bound, 1 for the high one.
    first: [usize; 3],
}

impl SingleRay {
    #[inline(always)]
    fn new(ray: &Ray) -> SingleRay {
        let line = Line::new(ray.origin.to_array(), ray.direction.to_array());
        let first = [0, 1, 2].map(|axis| usize::from(!line.rises(axis)));
        SingleRay {
            line,
            shear: Shear::new(ray),
            t_near: ray.t_near,
            first,
        }
    }
}

/// Returns the nearest hit, or any for [`Query::Any`].
#[inline(always)]
fn traverse(
    isa: impl SimdLevel,
    tree: TreeView,
    ray: &Ray,
    query: Query,
    stack: &mut ChildStack,
) -> Option<Hit> {
    let state = SingleRay::new(ray);
    // Start with a hit at the end of the ray that every other one replaces
    let mut best = Hit {
        instance: 0,
        primitive: u32::MAX,
        t: ray.t_far.min(f32::MAX),
        u: 0.0,
        v: 0.0,
    };
    if tree.root == ChildLink::EMPTY {
        return None;
    }
    let mut child = tree.root;
    let mut count = 0;
    loop {
        if child.is_leaf() {
            // Intersect eight triangles and keep the nearest hit, of equals that of the lowest number
            let block = &tree.blocks[child.index()];
            let hits = state
                .shear
                .intersect_pack(isa, &block.triangles, state.t_near, best.t);
            for lane in lanes(hits.mask) {
                let lane = lane % PACK;
                let number = block.numbers[lane];
                if hits.t[lane] < best.t || (hits.t[lane] == best.t && number < best.primitive) {
                    best = Hit {
                        instance: 0,
                        primitive: number,
                        t: hits.t[lane],
                        u: hits.u[lane],
                        v: hits.v[lane],
                    };
                }
                if query == Query::Any {
                    return Some(best);
                }
            }
        } else {
            // Intersect eight boxes, and push those that the ray enters before the hit
            let node = &tree.nodes[child.index()];
            let entered = enter(isa, node, &state, best.t);
            count = stack.push(isa, (tree, node), entered.mask, &entered.t, count);
        }
        // Continue with the nearest child that the ray enters before the hit
        let Some(next) = stack.pop(count, best.t) else {
            return (best.primitive != u32::MAX).then_some(best);
        };
        PoppedChild { child, count } = next;
    }
}

/// Boxes of a node that a ray enters.
struct EnteredBoxes {
    /// Mask of the children.
    mask: u32,
    /// Parameters at which the ray enters them.
    t: [f32; WIDTH],
}

/// Intersects a ray up to `t_far` with the eight boxes of a node by the slab method.
#[inline(always)]
fn enter(isa: impl SimdLevel, node: &NativeNode, state: &SingleRay, t_far: f32) -> EnteredBoxes {
    let eight = isa.eight();
    let mut near = Floats::splat(eight, state.t_near);
    let mut far = Floats::splat(eight, t_far);
    for axis in 0..3 {
        let first = state.first[axis] & 1;
        let origin = Floats::splat(eight, state.line.origin[axis]);
        let enter = Floats::splat(eight, state.line.enter[axis]);
        let leave = Floats::splat(eight, state.line.leave[axis]);
        // NaN, from a ray within a face, leaves the interval unchanged.
        near = ((Floats::load(eight, &node.bounds[first][axis]) - origin) * enter).max(near);
        far = ((Floats::load(eight, &node.bounds[1 - first][axis]) - origin) * leave).min(far);
    }
    EnteredBoxes {
        mask: near.le(far).bits(),
        t: near.to_array(),
    }
}

#[cfg(test)]
mod tests {
    use crate::accel::{Accel, Coherence};
    use crate::mesh::bumpy_sphere;

    use super::*;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::testing::{BEST, baked, brute_force, random_packets};

    #[test]
    fn single_rays_hit_what_brute_force_hits() {
        let scene = baked(bumpy_sphere(2000));
        let brute = brute_force(&scene);
        let crate::scene::Geometry::Mesh(mesh) = &scene.geometries[0] else {
            unreachable!()
        };
        let tree = build_tree(&[mesh]).unwrap();
        // Trace the same rays by both
        let mut expected = random_packets(200, 3);
        let mut blocked = expected.clone();
        let mut actual = expected.clone();
        let mut actual_blocked = expected.clone();
        brute.intersect(&mut expected, Coherence::Coherent);
        brute.occluded(&mut blocked, Coherence::Coherent);
        trace(BEST, tree.view(), &mut actual, Query::Nearest);
        trace(BEST, tree.view(), &mut actual_blocked, Query::Any);
        // Compare the hits, then which rays are blocked
        let mut hit_count = 0;
        for (a, b) in expected.iter().zip(&actual) {
            for lane in 0..LANES {
                assert_eq!(a.hit(lane), b.hit(lane));
                hit_count += usize::from(a.hit(lane).is_some());
            }
        }
        assert!(hit_count > 300, "{hit_count}");
        for (a, b) in blocked.iter().zip(&actual_blocked) {
            for lane in 0..LANES {
                assert_eq!(a.is_blocked(lane), b.is_blocked(lane));
            }
        }
    }
}
