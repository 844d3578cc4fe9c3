//! Coordinates in which the rays of a group are points of the plane z = 1.
//!
//! The frame has the axes of the world in another order: z is the one along which the rays point, so a vertex is moved
//! into it by differences alone, each rounded once. A ray through the common end with direction d is the point
//! `(u, v) = (d_x, d_y) / d_z`, and its points at depth z are `z (u, v, 1)`.

use crate::accel::{LANES, RayPacket};
use crate::mesh::simd::{Float8, WideLevel};

use super::common_end::CommonEnd;

/// Number of halves of a packet, of eight lanes each.
pub(super) const HALVES: usize = LANES / 8;

/// Frame of a group: the world's axes in cyclic order, about the common end of the rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroupFrame {
    /// Axes of the world that are x, y and z.
    pub(super) axes: [usize; 3],
    /// Common end in the order of the axes.
    pub(super) origin: [f32; 3],
    /// Direction of z along its axis of the world: 1 or -1.
    pub(super) sign: f32,
}

impl GroupFrame {
    /// Returns the frame about `end` whose z axis is closest to `direction`.
    #[inline(always)]
    pub(super) fn along(direction: [f32; 3], end: CommonEnd) -> GroupFrame {
        // Choose the axis of the largest component, and the others in cyclic order
        let [x, y, z] = direction.map(f32::abs);
        let axes = if x > y && x > z {
            [1, 2, 0]
        } else if y > z {
            [2, 0, 1]
        } else {
            [0, 1, 2]
        };
        let origin = end.point().to_array();
        GroupFrame {
            axes,
            origin: [origin[axes[0]], origin[axes[1]], origin[axes[2]]],
            sign: if direction[axes[2]] < 0.0 { -1.0 } else { 1.0 },
        }
    }
}

/// Returns eight times the same value. Kernels have no closures: one that is not inlined would be compiled for the lowest
/// instruction set.
#[inline(always)]
pub(super) fn splat<W: WideLevel>(wide: W, value: f32) -> Float8<W> {
    Float8::splat(wide, value)
}

/// Returns eight lanes of a packet's array.
#[inline(always)]
pub(super) fn half<T>(row: &[T; LANES], half: usize) -> &[T; 8] {
    &row.as_chunks::<8>().0[half % HALVES]
}

/// Returns eight lanes of a packet's array for writing.
#[inline(always)]
pub(super) fn half_mut<T>(row: &mut [T; LANES], half: usize) -> &mut [T; 8] {
    &mut row.as_chunks_mut::<8>().0[half % HALVES]
}

/// Returns the directions of eight rays away from the common end, not normalised, along an axis of the world.
#[inline(always)]
pub(super) fn away<W: WideLevel>(
    wide: W,
    packet: &RayPacket,
    half_index: usize,
    end: CommonEnd,
    axis: usize,
) -> Float8<W> {
    match end {
        CommonEnd::Origin(_) => Float8::load(wide, half(&packet.direction[axis], half_index)),
        CommonEnd::Target(target) => {
            Float8::load(wide, half(&packet.origin[axis], half_index)) - splat(wide, target[axis])
        }
    }
}

/// Returns the sum of the directions of all pending rays, away from the common end.
#[inline(always)]
pub(super) fn sum_of_directions<W: WideLevel>(
    wide: W,
    packets: &[RayPacket],
    pending: &[u32],
    end: CommonEnd,
) -> [f32; 3] {
    // Add the directions in eight lanes
    let mut sums = [splat(wide, 0.0); 3];
    for (packet, &pending) in packets.iter().zip(pending) {
        for h in 0..HALVES {
            let mask = Float8::mask_of(wide, pending >> (8 * h));
            for axis in 0..3 {
                sums[axis] = sums[axis] + (away(wide, packet, h, end, axis) & mask);
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
