//! Rays that start or end at a common point, and their projection to the plane z = 1.
//!
//! In the frame about the common end a ray with direction d is the point `(u, v) = (d_x, d_y) / d_z`, and its points at
//! depth z are `z (u, v, 1)`.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float8, WideLevel};
use crate::numeric::Ray;
use glam::Vec3;

use super::frame::{GroupFrame, HALVES, half, splat};
use super::projection::{GroupProjection, ProjectedHalf};

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
    /// Returns the directions of eight rays away from the common end, not normalised, along an axis of the world.
    #[inline(always)]
    fn away<W: WideLevel>(self, wide: W, packet: &RayPacket, half_index: usize, axis: usize) -> Float8<W> {
        match self {
            CommonEnd::Origin(_) => Float8::load(wide, half(&packet.direction[axis], half_index)),
            CommonEnd::Target(target) => {
                Float8::load(wide, half(&packet.origin[axis], half_index)) - splat(wide, target[axis])
            }
        }
    }

    /// Returns the depths between which eight rays search, whose directions away from the end have the components `z`.
    #[inline(always)]
    fn depth_interval<W: WideLevel>(
        self,
        wide: W,
        packet: &RayPacket,
        half_index: usize,
        z_axis: usize,
        z: Float8<W>,
    ) -> [Float8<W>; 2] {
        let t_near = Float8::load(wide, half(&packet.t_near, half_index));
        let t_far = Float8::load(wide, half(&packet.t_far, half_index));
        // No ray searches behind the common end.
        let zero = splat(wide, 0.0);
        match self {
            CommonEnd::Origin(_) => [t_near * z, (t_far * z).max(zero)],
            CommonEnd::Target(_) => {
                // The ray starts at depth z and comes closer
                let speed = Float8::load(wide, half(&packet.direction[z_axis], half_index)).abs();
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
    fn sum_of_directions<W: WideLevel>(self, wide: W, packets: &[RayPacket], pending: &[u32]) -> [f32; 3] {
        // Add the directions in eight lanes
        let mut sums = [splat(wide, 0.0); 3];
        for (packet, &pending) in packets.iter().zip(pending) {
            for h in 0..HALVES {
                let mask = Float8::mask_of(wide, pending >> (8 * h));
                for axis in 0..3 {
                    sums[axis] = sums[axis] + (self.away(wide, packet, h, axis) & mask);
                }
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
    fn frame<W: WideLevel>(self, _: W, _: &[RayPacket], _: &[u32], direction: [f32; 3]) -> GroupFrame {
        GroupFrame::along(direction, self.fixed_point().to_array())
    }

    #[inline(always)]
    fn project<W: WideLevel>(
        self,
        wide: W,
        packet: &RayPacket,
        half_index: usize,
        pending: Float8<W>,
        frame: &GroupFrame,
    ) -> ProjectedHalf<W> {
        // Choose the lanes that fit
        let x = self.away(wide, packet, half_index, frame.axes[0]);
        let y = self.away(wide, packet, half_index, frame.axes[1]);
        let z = self.away(wide, packet, half_index, frame.axes[2]) * splat(wide, frame.sign);
        let steepest = x.abs().max(y.abs()) * splat(wide, 1.0 / MAX_SLOPE);
        let fits = steepest.le(z)
            & splat(wide, DIRECTION_RANGE[0]).le(z)
            & z.le(splat(wide, DIRECTION_RANGE[1]))
            & pending;
        // Project them to the plane z = 1
        let divisor = fits.select(z, splat(wide, 1.0));
        let [z_near, z_far] = self.depth_interval(wide, packet, half_index, frame.axes[2], z);
        ProjectedHalf {
            fits,
            u: fits & (x / divisor),
            v: fits & (y / divisor),
            z_near,
            z_far,
        }
    }
}
