//! Coordinates in which the rays of a group are points of a plane.
//!
//! The frame has the axes of the world in another order: z, the depth, is the one along which the rays point, so a vertex
//! is moved into it by differences alone, each rounded once.

use crate::mesh::simd::{Floats, WideLevel};

/// Frame of a group: the world's axes in cyclic order, about the common end of the rays, or amid their origins.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroupFrame {
    /// Axes of the world that are x, y and z.
    pub(super) axes: [usize; 3],
    /// Origin of the frame in the order of the axes.
    pub(super) origin: [f32; 3],
    /// Direction of z along its axis of the world: 1 or -1.
    pub(super) sign: f32,
    /// Slopes x / z and y / z of the common direction; zero for rays with a common end.
    pub(super) slopes: [f32; 2],
    /// Greatest distances of the rays' origins from that of the frame, along its axes; zero for rays with a common end.
    pub(super) spread: [f32; 3],
}

impl GroupFrame {
    /// Returns the frame about `origin` whose z axis is closest to `direction`.
    #[inline(always)]
    pub(super) fn along(direction: [f32; 3], origin: [f32; 3]) -> GroupFrame {
        // Choose the axis of the largest component, and the others in cyclic order
        let [x, y, z] = direction.map(f32::abs);
        let axes = if x > y && x > z {
            [1, 2, 0]
        } else if y > z {
            [2, 0, 1]
        } else {
            [0, 1, 2]
        };
        GroupFrame {
            axes,
            origin: [origin[axes[0]], origin[axes[1]], origin[axes[2]]],
            sign: if direction[axes[2]] < 0.0 { -1.0 } else { 1.0 },
            slopes: [0.0; 2],
            spread: [0.0; 3],
        }
    }

    /// Returns the direction of lesser depths common to all rays, in the order of the axes; each component has an error
    /// of one unit of roundoff.
    #[inline(always)]
    pub(super) fn light_direction(&self) -> [f32; 3] {
        [-self.slopes[0], -self.slopes[1], -self.sign]
    }
}

/// Returns the same value in all lanes. Kernels have no closures: one that is not inlined would be compiled for the lowest
/// instruction set.
#[inline(always)]
pub(super) fn splat<W: WideLevel<N>, const N: usize>(level: W, value: f32) -> Floats<W, N> {
    Floats::splat(level, value)
}
