//! Rays that start or end at a common point, and their projection to the plane z = 1.
//!
//! In the frame about the common end a ray with direction d is the point `(u, v) = (d_x, d_y) / d_z`, and its points at
//! depth z are `z (u, v, 1)`.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float16, Floats, LaneMask, SimdLevel};
use crate::numeric::Ray;
use glam::Vec3;

use super::frame::{GroupFrame, splat};
use super::projection::{GroupProjection, ProjectedPacket};

/// Largest ratio of a direction's other components to that along the frame's z axis: rays of up to 63 degrees from it
/// along an axis.
const MAX_SLOPE: f32 = 2.0;
/// Range of direction components along the frame's z axis: products with depths stay finite and normal.
const DIRECTION_RANGE: [f32; 2] = [1.0 / (1u64 << 60) as f32, (1u64 << 60) as f32];

/// Point that all rays have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CommonEnd {
    /// Start of all rays, exactly.
    Origin(Vec3),
    /// Point that all rays pass through, up to rounding, at the end of their intervals or behind it: the position of a
    /// light.
    Target(Vec3),
}

impl CommonEnd {
    /// Returns the directions of rays away from the common end, not normalised, along an axis of the world.
    #[inline(always)]
    fn away<I: SimdLevel>(self, isa: I, packet: &RayPacket, axis: usize) -> Float16<I> {
        let sixteen = isa.sixteen();
        match self {
            CommonEnd::Origin(_) => Floats::load(sixteen, &packet.direction[axis]),
            CommonEnd::Target(target) => {
                Floats::load(sixteen, &packet.origin[axis]) - splat(sixteen, target[axis])
            }
        }
    }

    /// Returns the depths between which rays search, whose directions away from the end have the components `z`.
    #[inline(always)]
    fn depth_interval<I: SimdLevel>(
        self,
        isa: I,
        packet: &RayPacket,
        z_axis: usize,
        z: Float16<I>,
    ) -> [Float16<I>; 2] {
        let sixteen = isa.sixteen();
        let t_near = Floats::load(sixteen, &packet.t_near);
        let t_far = Floats::load(sixteen, &packet.t_far);
        // No ray searches behind the common end.
        let zero = splat(sixteen, 0.0);
        match self {
            CommonEnd::Origin(_) => [t_near * z, (t_far * z).max(zero)],
            CommonEnd::Target(_) => {
                // The ray starts at depth z and comes closer
                let speed = Floats::load(sixteen, &packet.direction[z_axis]).abs();
                [(z - t_far * speed).max(zero), (z - t_near * speed).max(zero)]
            }
        }
    }
}

impl GroupProjection for CommonEnd {
    const IS_PARALLEL: bool = false;

    #[inline(always)]
    fn fixed_point(self) -> Vec3 {
        match self {
            CommonEnd::Origin(p) | CommonEnd::Target(p) => p,
        }
    }

    #[inline(always)]
    fn sum_of_directions<I: SimdLevel>(self, isa: I, packets: &[RayPacket], pending: &[u32]) -> [f32; 3] {
        // Add the directions lane by lane
        let zero = splat(isa.sixteen(), 0.0);
        let mut sums = [zero; 3];
        for (packet, &pending) in packets.iter().zip(pending) {
            let pending = LaneMask::of_bits(isa.sixteen(), pending);
            for axis in 0..3 {
                sums[axis] = sums[axis] + pending.select(self.away(isa, packet, axis), zero);
            }
        }
        // Add the lanes in their order, for the same bits on all instruction sets
        let mut out = [0.0; 3];
        for axis in 0..3 {
            for lane in sums[axis].to_array() {
                out[axis] += lane;
            }
        }
        out
    }

    fn direction(self, ray: &Ray) -> [f32; 3] {
        match self {
            CommonEnd::Origin(_) => ray.direction.to_array(),
            CommonEnd::Target(target) => (ray.origin - target).to_array(),
        }
    }

    #[inline(always)]
    fn frame<I: SimdLevel>(self, _: I, _: &[RayPacket], _: &[u32], direction: [f32; 3]) -> GroupFrame {
        GroupFrame::along(direction, self.fixed_point().to_array())
    }

    #[inline(always)]
    fn project<I: SimdLevel>(
        self,
        isa: I,
        packet: &RayPacket,
        pending: u32,
        frame: &GroupFrame,
    ) -> ProjectedPacket<I> {
        // Choose the lanes that fit
        let sixteen = isa.sixteen();
        let x = self.away(isa, packet, frame.axes[0]);
        let y = self.away(isa, packet, frame.axes[1]);
        let z = self.away(isa, packet, frame.axes[2]) * splat(sixteen, frame.sign);
        let steepest = x.abs().max(y.abs()) * splat(sixteen, 1.0 / MAX_SLOPE);
        let fits = steepest.le(z)
            & splat(sixteen, DIRECTION_RANGE[0]).le(z)
            & z.le(splat(sixteen, DIRECTION_RANGE[1]))
            & LaneMask::of_bits(sixteen, pending);
        // Project them to the plane z = 1
        let divisor = fits.select(z, splat(sixteen, 1.0));
        let zero = splat(sixteen, 0.0);
        let [z_near, z_far] = self.depth_interval(isa, packet, frame.axes[2], z);
        ProjectedPacket {
            fits,
            u: fits.select(x / divisor, zero),
            v: fits.select(y / divisor, zero),
            z_near,
            z_far,
        }
    }
}
