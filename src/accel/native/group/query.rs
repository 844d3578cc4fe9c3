//! Queries that a group kernel is compiled for.

use crate::accel::RayPacket;
use crate::accel::native::child_stack::ChildStack;
use crate::accel::native::layout::TreeView;
use crate::mesh::simd::{Floats, LaneMask, SimdLevel};
use glam::Vec3;

use super::common_end::CommonEnd;
use super::exact::write_exact_hits;
use super::frame::splat;
use super::projection::GroupProjection;
use super::rays::{GroupRays, OFF, PACKETS};

/// Query and form of the rays, known at compile time.
pub(super) trait GroupQuery: Copy {
    /// Flag of queries for any hit on the way to a light: none needs to be the nearest, and rays may start at surfaces.
    const IS_ANY: bool;

    /// Projection of the rays.
    type Projection: GroupProjection;

    /// Returns the projection of the rays.
    fn projection(self) -> Self::Projection;

    /// Writes the hits of a group, found in `tree`, into its packets.
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        tree: TreeView,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut ChildStack,
    );
}

/// Nearest hit of rays from a common origin.
#[derive(Clone, Copy)]
pub(super) struct NearestFromOrigin(pub(super) Vec3);

/// Any hit of rays to a light, which is a common target or a common direction.
#[derive(Clone, Copy)]
pub(super) struct AnyToLight<J>(pub(super) J);

impl GroupQuery for NearestFromOrigin {
    const IS_ANY: bool = false;

    type Projection = CommonEnd;

    #[inline(always)]
    fn projection(self) -> CommonEnd {
        CommonEnd::Origin(self.0)
    }

    #[inline(always)]
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        tree: TreeView,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut ChildStack,
    ) {
        write_exact_hits(isa, tree, rays, packets, stack);
    }
}

impl<J: GroupProjection> GroupQuery for AnyToLight<J> {
    const IS_ANY: bool = true;

    type Projection = J;

    #[inline(always)]
    fn projection(self) -> J {
        self.0
    }

    #[inline(always)]
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        _tree: TreeView,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        _stack: &mut ChildStack,
    ) {
        let sixteen = isa.sixteen();
        for (index, packet) in packets.iter_mut().enumerate() {
            // Find the blocked rays, which are off
            let index = index % PACKETS;
            let is_off = Floats::load(sixteen, &rays.z[index]).eq(splat(sixteen, OFF));
            let blocked = is_off & LaneMask::of_bits(sixteen, rays.taken[index]);
            // Empty their intervals
            let t_far = Floats::load(sixteen, &packet.t_far);
            packet.t_far = blocked
                .select(splat(sixteen, f32::NEG_INFINITY), t_far)
                .to_array();
        }
    }
}
