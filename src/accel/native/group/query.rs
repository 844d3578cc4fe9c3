//! Queries that a group kernel is compiled for.

use crate::accel::RayPacket;
use crate::accel::native::single::SingleStack;
use crate::mesh::simd::{Float8, SimdLevel};
use glam::Vec3;

use super::common_end::CommonEnd;
use super::exact::ExactHits;
use super::frame::{HALVES, half, half_mut, splat};
use super::projection::GroupProjection;
use super::rays::{GroupRays, OFF};

/// Query and form of the rays, known at compile time.
pub(super) trait GroupQuery: Copy {
    /// Flag of queries for any hit on the way to a light: none needs to be the nearest, and rays may start at surfaces.
    const IS_ANY: bool;

    /// Projection of the rays.
    type Projection: GroupProjection;

    /// Returns the projection of the rays.
    fn projection(self) -> Self::Projection;

    /// Writes the hits of a group into its packets.
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut SingleStack,
    );
}

/// Nearest hit of rays from a common origin.
#[derive(Clone, Copy)]
pub(super) struct NearestFromOrigin<'a, 's> {
    /// Origin of the rays.
    pub(super) origin: Vec3,
    /// Structures from which the hits are computed again.
    pub(super) exact: ExactHits<'a, 's>,
}

/// Any hit of rays to a light, which is a common target or a common direction.
#[derive(Clone, Copy)]
pub(super) struct AnyToLight<J>(pub(super) J);

impl GroupQuery for NearestFromOrigin<'_, '_> {
    const IS_ANY: bool = false;

    type Projection = CommonEnd;

    #[inline(always)]
    fn projection(self) -> CommonEnd {
        CommonEnd::Origin(self.origin)
    }

    #[inline(always)]
    fn write_hits<I: SimdLevel>(
        self,
        isa: I,
        rays: &GroupRays,
        packets: &mut [RayPacket],
        stack: &mut SingleStack,
    ) {
        self.exact.write(isa, rays, packets, stack);
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
        rays: &GroupRays,
        packets: &mut [RayPacket],
        _stack: &mut SingleStack,
    ) {
        let wide = isa.wide();
        for (index, packet) in packets.iter_mut().enumerate() {
            for h in 0..HALVES {
                // Empty the intervals of blocked rays, which are off
                let sub = HALVES * index + h;
                let z = Float8::load(wide, &rays.z[sub]);
                let is_off = z.eq(splat(wide, OFF)).bits();
                let blocked = Float8::mask_of(wide, is_off & rays.taken[sub]);
                let t_far = Float8::load(wide, half(&packet.t_far, h));
                let t_far = blocked.select(splat(wide, f32::NEG_INFINITY), t_far);
                *half_mut(&mut packet.t_far, h) = t_far.to_array();
            }
        }
    }
}
