//! Projection of rays to points of a plane.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Float16, LaneMask, SimdLevel};
use crate::numeric::Ray;
use glam::Vec3;

use super::frame::GroupFrame;

/// Greatest magnitude of coordinates: products of three stay finite.
pub(super) const MAX_COORDINATE: f32 = (1u64 << 40) as f32;

/// Common end or direction of a query's rays, by which they are projected to points `(u, v)` of a plane.
///
/// Points are projected alike: `(x, y, z)` in the frame to `(x, y) / w`, where `w` is z for rays with a common end and 1
/// for rays with a common direction.
pub(super) trait GroupProjection: Copy {
    /// Flag of rays with a common direction.
    const IS_PARALLEL: bool;

    /// Returns a point whose coordinates must be in range beside those of triangles.
    fn fixed_point(self) -> Vec3;

    /// Returns the sum of the directions of all pending rays, or a multiple of it, towards greater depths.
    fn sum_of_directions<I: SimdLevel>(self, isa: I, packets: &[RayPacket], pending: &[u32]) -> [f32; 3];

    /// Returns the direction of a ray, not normalised, towards greater depths.
    fn direction(self, ray: &Ray) -> [f32; 3];

    /// Returns a frame for the pending rays, whose z axis is closest to `direction`.
    fn frame<I: SimdLevel>(
        self,
        isa: I,
        packets: &[RayPacket],
        pending: &[u32],
        direction: [f32; 3],
    ) -> GroupFrame;

    /// Projects the rays of a packet, of which those of the mask `pending` are to be traced.
    fn project<I: SimdLevel>(
        self,
        isa: I,
        packet: &RayPacket,
        pending: u32,
        frame: &GroupFrame,
    ) -> ProjectedPacket<I>;
}

/// Rays of a packet as points of the plane.
#[derive(Clone, Copy)]
pub(super) struct ProjectedPacket<I: SimdLevel> {
    /// Mask of the pending rays that the frame is fit for; the depths are valid in these lanes.
    pub(super) fits: LaneMask<I::Sixteen, LANES>,
    /// Coordinate in the plane, zero for lanes that do not fit; so is the other.
    pub(super) u: Float16<I>,
    pub(super) v: Float16<I>,
    /// Depth from which the rays search.
    pub(super) z_near: Float16<I>,
    /// Depth up to which the rays search: greater than -∞.
    pub(super) z_far: Float16<I>,
}
