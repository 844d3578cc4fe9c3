//! Rays with a common direction, and their projection along it.
//!
//! In the frame the direction of greater depths is `(s_x, s_y, 1)`, away from the light, and a point `(x, y, z)` is
//! projected to `(x - s_x z, y - s_y z)`: vertices and the origins of rays by the same expression. The frame lies amid
//! the origins of the group's rays, so that coordinates of what is near them are small and keep their digits.
//!
//! # Errors
//!
//! With u = 2^-24, a projected coordinate has an error of at most `u (2 m + 3 |z|)`, where m is its magnitude: of the
//! difference with the frame's origin, of the depth, their product and their difference. The slope, at most 1, has an error
//! of u, which moves a vertex relative to a ray by u times the difference of their depths.

use crate::accel::RayPacket;
use crate::mesh::simd::{Float8, WideLevel};
use crate::numeric::Ray;
use glam::Vec3;

use super::frame::{GroupFrame, HALVES, half, splat};
use super::projection::{GroupProjection, MAX_COORDINATE, ProjectedHalf};

/// Direction that all rays have, exactly: that towards a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CommonDirection(pub(super) Vec3);

impl CommonDirection {
    /// Returns those of eight rays that have the direction, of those in the mask `pending`, with origins in range.
    #[inline(always)]
    fn fitting<W: WideLevel>(
        self,
        wide: W,
        packet: &RayPacket,
        half_index: usize,
        pending: Float8<W>,
    ) -> Float8<W> {
        let mut fits = pending;
        for axis in 0..3 {
            let direction = Float8::load(wide, half(&packet.direction[axis], half_index));
            let origin = Float8::load(wide, half(&packet.origin[axis], half_index));
            fits =
                fits & direction.eq(splat(wide, self.0[axis])) & origin.abs().le(splat(wide, MAX_COORDINATE));
        }
        fits
    }

    /// Returns the direction away from the light.
    #[inline(always)]
    fn away(self) -> [f32; 3] {
        [-self.0.x, -self.0.y, -self.0.z]
    }
}

impl GroupProjection for CommonDirection {
    const IS_PARALLEL: bool = true;

    #[inline(always)]
    fn fixed_point(self) -> Vec3 {
        Vec3::ZERO
    }

    #[inline(always)]
    fn sum_of_directions<W: WideLevel>(self, _: W, _: &[RayPacket], _: &[u32]) -> [f32; 3] {
        self.away()
    }

    fn direction(self, _: &Ray) -> [f32; 3] {
        self.away()
    }

    #[inline(always)]
    fn frame<W: WideLevel>(
        self,
        wide: W,
        packets: &[RayPacket],
        pending: &[u32],
        direction: [f32; 3],
    ) -> GroupFrame {
        // Bound the origins of the rays
        let mut low = [splat(wide, f32::INFINITY); 3];
        let mut high = [splat(wide, f32::NEG_INFINITY); 3];
        for (packet, &pending) in packets.iter().zip(pending) {
            for h in 0..HALVES {
                let fits = self.fitting(wide, packet, h, Float8::mask_of(wide, pending >> (8 * h)));
                for axis in 0..3 {
                    let origin = Float8::load(wide, half(&packet.origin[axis], h));
                    low[axis] = fits.select(origin, low[axis]).min(low[axis]);
                    high[axis] = fits.select(origin, high[axis]).max(high[axis]);
                }
            }
        }
        // Place the frame amid them; its size, twice what is needed, covers the rounding of the middle
        let (mut middle, mut size) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let (low, high) = (low[axis].min_lane(), high[axis].max_lane());
            middle[axis] = 0.5 * (low + high);
            size[axis] = high - low;
        }
        let frame = GroupFrame::along(direction, middle);
        let [kx, ky, kz] = frame.axes;
        let depth = direction[kz].abs();
        GroupFrame {
            slopes: [direction[kx] / depth, direction[ky] / depth],
            spread: [size[kx], size[ky], size[kz]],
            ..frame
        }
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
        // Project the origins as `BlockCorners::new` projects vertices
        let [kx, ky, kz] = frame.axes;
        let x = Float8::load(wide, half(&packet.origin[kx], half_index)) - splat(wide, frame.origin[0]);
        let y = Float8::load(wide, half(&packet.origin[ky], half_index)) - splat(wide, frame.origin[1]);
        let z = Float8::load(wide, half(&packet.origin[kz], half_index)) - splat(wide, frame.origin[2]);
        let z = z * splat(wide, frame.sign);
        let u = x - splat(wide, frame.slopes[0]) * z;
        let v = y - splat(wide, frame.slopes[1]) * z;
        // Compute the depths of the interval, which decrease towards the light
        let speed = splat(wide, self.0[kz].abs());
        let z_near = z - Float8::load(wide, half(&packet.t_far, half_index)) * speed;
        let z_far = z - Float8::load(wide, half(&packet.t_near, half_index)) * speed;
        // Choose the lanes that fit; a depth of -∞ is that of a lane that is off
        let fits = self.fitting(wide, packet, half_index, pending) & splat(wide, f32::MIN).le(z_far);
        ProjectedHalf {
            fits,
            u: fits & u,
            v: fits & v,
            z_near,
            z_far,
        }
    }
}
