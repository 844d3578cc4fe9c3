//! Queries that a group kernel is compiled for.

use crate::accel::RayPacket;
use crate::accel::native::layout::GroupTree;
use crate::accel::native::single::SingleStack;
use crate::accel::native::triangle_run::TriangleRun;
use crate::mesh::simd::{Float8, SimdLevel};

use super::exact::ExactHits;
use super::frame::{HALVES, half, half_mut, splat};
use super::rays::GroupRays;

/// Query and form of the rays, known at compile time.
pub(super) trait GroupQuery: Copy {
    /// Flag of queries for any hit on the way to a common target: none needs to be the nearest, and rays may start at
    /// surfaces.
    const IS_ANY: bool;

    /// Writes the hits of a group into its packets.
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        tree: &GroupTree,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut SingleStack,
    );
}

/// Nearest hit of rays from a common origin.
#[derive(Clone, Copy)]
pub(super) struct NearestFromOrigin<'a, 's> {
    /// Meshes of the tree's triangles.
    pub(super) runs: &'a [TriangleRun<'s>],
}

/// Any hit of rays to a common target.
#[derive(Clone, Copy)]
pub(super) struct AnyToTarget;

impl GroupQuery for NearestFromOrigin<'_, '_> {
    const IS_ANY: bool = false;

    #[inline(always)]
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        tree: &GroupTree,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut SingleStack,
    ) {
        let exact = ExactHits {
            tree,
            runs: self.runs,
        };
        exact.write(isa, rays, packets, stack);
    }
}

impl GroupQuery for AnyToTarget {
    const IS_ANY: bool = true;

    #[inline(always)]
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        _tree: &GroupTree,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        _stack: &mut SingleStack,
    ) {
        let wide = isa.wide();
        for (index, packet) in packets.iter_mut().enumerate() {
            for h in 0..HALVES {
                // Empty the intervals of blocked rays, whose depth is negative
                let sub = HALVES * index + h;
                let z = Float8::load(wide, &rays.z[sub]);
                let blocked = Float8::mask_of(wide, z.bits() & rays.taken[sub]);
                let t_far = Float8::load(wide, half(&packet.t_far, h));
                let t_far = blocked.select(splat(wide, f32::NEG_INFINITY), t_far);
                *half_mut(&mut packet.t_far, h) = t_far.to_array();
            }
        }
    }
}
