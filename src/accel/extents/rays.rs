//! Test of sixteen rays against one bounding volume.
//!
//! A test may report a miss only if it is certain. The ray's origin is moved by the guard's factor times its size,
//! against the direction for exits and along it for entries, so the volumes themselves do not depend on the ray;
//! rounding of parameters is covered by factors next to 1. Directions so short that their squares would underflow are
//! not tested at all.

use crate::accel::bsp::error_bounds::Line;
use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::SimdLevel;

use super::guard::MIN_SQUARE;
use super::shape::{BoxVolume, SphereVolume};

/// One value per ray of the packet.
pub(super) type LaneValues = [f32; LANES];

/// Mask of all sixteen lanes.
const FULL: u32 = (1 << LANES) - 1;
/// Sixteen rays with precomputed data for volume tests.
pub(crate) struct RayLanes {
    origin: [LaneValues; 3],
    direction: [LaneValues; 3],
    /// Origins moved along the direction, for the entries of boxes.
    enter_origin: [LaneValues; 3],
    /// Origins moved against the direction, for the exits of boxes.
    leave_origin: [LaneValues; 3],
    enter: [LaneValues; 3],
    leave: [LaneValues; 3],
    /// Reciprocal of the squared length of the direction.
    inverse_square: LaneValues,
    /// Reciprocal of the length of the direction.
    inverse_length: LaneValues,
    t_near: LaneValues,
    /// Mask of rays that are not tested and may hit everything.
    always: u32,
}

impl RayLanes {
    /// Prepares the rays of a packet. `origin_factor` is the largest such factor of all guards.
    #[inline(always)]
    pub(crate) fn new(isa: impl SimdLevel, packet: &RayPacket, origin_factor: f32) -> RayLanes {
        let (origin, direction) = (packet.origin, packet.direction);
        let [enter, leave] = Line::reciprocals(&direction);
        // Move the origins by the error bound, along and against the direction
        let mut pad = [0.0; LANES];
        for row in &origin {
            for l in 0..LANES {
                let part = row[l].abs() * origin_factor;
                pad[l] = if part > pad[l] { part } else { pad[l] };
            }
        }
        let [mut enter_origin, mut leave_origin] = [origin; 2];
        for axis in 0..3 {
            for l in 0..LANES {
                // Entries become earlier and exits later
                let towards = pad[l].copysign(direction[axis][l]);
                enter_origin[axis][l] += towards;
                leave_origin[axis][l] -= towards;
            }
        }
        // Compute reciprocal lengths for the sphere test
        let [mut inverse_square, mut inverse_length] = [[0.0f32; LANES]; 2];
        let mut square = [0.0f32; LANES];
        for l in 0..LANES {
            let [x, y, z] = [direction[0][l], direction[1][l], direction[2][l]];
            square[l] = (x * x + y * y) + z * z;
            inverse_square[l] = 1.0 / square[l];
            inverse_length[l] = 1.0 / square[l].sqrt();
        }
        RayLanes {
            origin,
            direction,
            enter_origin,
            leave_origin,
            enter,
            leave,
            inverse_square,
            inverse_length,
            t_near: packet.t_near,
            always: FULL & !isa.le(&[MIN_SQUARE; LANES], &square),
        }
    }

    /// Returns the mask of lanes that may hit the box before `t_far`.
    #[inline(always)]
    pub(super) fn hit_box_mask(&self, isa: impl SimdLevel, extent: &BoxVolume, t_far: &LaneValues) -> u32 {
        let (mut near, mut far) = (self.t_near, *t_far);
        for l in 0..LANES {
            // Extend the interval by the depth error of edge-on triangles
            let depth = extent.depth * self.inverse_length[l];
            near[l] -= depth;
            far[l] += depth;
        }
        for axis in 0..3 {
            let (low, high) = (extent.low[axis], extent.high[axis]);
            for l in 0..LANES {
                let falls = self.direction[axis][l].is_sign_negative();
                let (first, last) = if falls { (high, low) } else { (low, high) };
                let t0 = (first - self.enter_origin[axis][l]) * self.enter[axis][l];
                let t1 = (last - self.leave_origin[axis][l]) * self.leave[axis][l];
                // NaN, from a ray within a face, leaves the interval unchanged.
                near[l] = if t0 > near[l] { t0 } else { near[l] };
                far[l] = if t1 < far[l] { t1 } else { far[l] };
            }
        }
        isa.le(&near, &far) | self.always
    }

    /// Returns the mask of lanes that may hit the sphere before `t_far`.
    ///
    /// The squared distance of the line from the centre is `|f|² - (f.d)² / |d|²`, and no hit is farther along the ray
    /// than the radius from the point nearest to the centre.
    #[inline(always)]
    pub(super) fn hit_sphere_mask(
        &self,
        isa: impl SimdLevel,
        extent: &SphereVolume,
        t_far: &LaneValues,
    ) -> u32 {
        let [mut beside, mut from, mut to] = [[0.0f32; LANES]; 3];
        for l in 0..LANES {
            let x = self.origin[0][l] - extent.center[0];
            let y = self.origin[1][l] - extent.center[1];
            let z = self.origin[2][l] - extent.center[2];
            let [dx, dy, dz] = [self.direction[0][l], self.direction[1][l], self.direction[2][l]];
            let square = (x * x + y * y) + z * z;
            let along = (x * dx + y * dy) + z * dz;
            let t = -along * self.inverse_square[l];
            // The product `along * t` is negative.
            beside[l] = extent.shrink * square + along * t;
            let taxicab = (x.abs() + y.abs()) + z.abs();
            let reach = (extent.reach + extent.slack * taxicab) * self.inverse_length[l];
            from[l] = t - reach;
            to[l] = t + reach;
        }
        let misses =
            isa.lt(&[extent.square; LANES], &beside) | isa.lt(t_far, &from) | isa.lt(&to, &self.t_near);
        (FULL & !misses) | self.always
    }
}
