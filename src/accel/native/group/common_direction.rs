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

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Floats, LaneMask, SimdLevel};
use crate::numeric::Ray;
use glam::Vec3;

use super::frame::{GroupFrame, splat};
use super::projection::{GroupProjection, MAX_COORDINATE, ProjectedPacket};

/// Direction that all rays have, exactly: that towards a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CommonDirection(pub(super) Vec3);

impl CommonDirection {
    /// Returns the rays of the mask `pending` that have the direction, with origins in range.
    #[inline(always)]
    fn fitting<I: SimdLevel>(self, isa: I, packet: &RayPacket, pending: u32) -> LaneMask<I::Sixteen, LANES> {
        let sixteen = isa.sixteen();
        let mut fits = LaneMask::of_bits(sixteen, pending);
        for axis in 0..3 {
            let direction = Floats::load(sixteen, &packet.direction[axis]);
            let origin = Floats::load(sixteen, &packet.origin[axis]);
            let is_own = direction.eq(splat(sixteen, self.0[axis]));
            fits = fits & is_own & origin.abs().le(splat(sixteen, MAX_COORDINATE));
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
    fn sum_of_directions<I: SimdLevel>(self, _: I, _: &[RayPacket], _: &[u32]) -> [f32; 3] {
        self.away()
    }

    fn direction(self, _: &Ray) -> [f32; 3] {
        self.away()
    }

    #[inline(always)]
    fn frame<I: SimdLevel>(
        self,
        isa: I,
        packets: &[RayPacket],
        pending: &[u32],
        direction: [f32; 3],
    ) -> GroupFrame {
        // Bound the origins of the rays
        let sixteen = isa.sixteen();
        let mut low = [splat(sixteen, f32::INFINITY); 3];
        let mut high = [splat(sixteen, f32::NEG_INFINITY); 3];
        for (packet, &pending) in packets.iter().zip(pending) {
            let fits = self.fitting(isa, packet, pending);
            for axis in 0..3 {
                let origin = Floats::load(sixteen, &packet.origin[axis]);
                low[axis] = fits.select(origin, low[axis]).min(low[axis]);
                high[axis] = fits.select(origin, high[axis]).max(high[axis]);
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
    fn project<I: SimdLevel>(
        self,
        isa: I,
        packet: &RayPacket,
        pending: u32,
        frame: &GroupFrame,
    ) -> ProjectedPacket<I> {
        let sixteen = isa.sixteen();
        // Project the origins as `BlockCorners::new` projects vertices
        let [kx, ky, kz] = frame.axes;
        let x = Floats::load(sixteen, &packet.origin[kx]) - splat(sixteen, frame.origin[0]);
        let y = Floats::load(sixteen, &packet.origin[ky]) - splat(sixteen, frame.origin[1]);
        let z = Floats::load(sixteen, &packet.origin[kz]) - splat(sixteen, frame.origin[2]);
        let z = z * splat(sixteen, frame.sign);
        let u = x - splat(sixteen, frame.slopes[0]) * z;
        let v = y - splat(sixteen, frame.slopes[1]) * z;
        // Compute the depths of the interval, which decrease towards the light
        let speed = splat(sixteen, self.0[kz].abs());
        let z_near = z - Floats::load(sixteen, &packet.t_far) * speed;
        let z_far = z - Floats::load(sixteen, &packet.t_near) * speed;
        // Choose the lanes that fit; a depth of -∞ is that of a lane that is off
        let fits = self.fitting(isa, packet, pending) & splat(sixteen, f32::MIN).le(z_far);
        let zero = splat(sixteen, 0.0);
        ProjectedPacket {
            fits,
            u: fits.select(u, zero),
            v: fits.select(v, zero),
            z_near,
            z_far,
        }
    }
}
