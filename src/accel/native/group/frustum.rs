//! Tests of a node's boxes against a group: the four planes around the group's window, and the windows of its parts.

use crate::mesh::simd::{Floats, SimdLevel, WideLevel, lanes};

use super::frame::splat;
use super::projection::GroupProjection;
use super::rays::{GroupRays, PACKETS, Windows};
use crate::accel::native::layout::{Box3, NativeNode, WIDTH};

/// Error of a plane's or a depth's value relative to the sum of the magnitudes of its terms: 16 units of roundoff, for a
/// few roundings here and as many in the vertices of the triangle test.
const ERROR: f32 = 8.0 * f32::EPSILON;
/// Error of a window's border relative to the greatest |u| of rays, by the same count; for parallel rays relative to the
/// coordinates before they are sheared.
const WINDOW_ERROR: f32 = 16.0 * f32::EPSILON;
/// Depth below which a box's window is unbounded: any number whose reciprocal is finite.
const MIN_DEPTH: f32 = 1e-30;

/// Plane of the frustum: `x + slope * z + offset` or `-x + slope * z + offset` in coordinates of the world is not
/// negative inside.
#[derive(Clone, Copy)]
struct FrustumPlane {
    slope: f32,
    offset: f32,
    /// Side of a box that is farthest inside along the frame's z axis.
    z_side: usize,
}

impl FrustumPlane {
    /// Returns the plane's value without the term of x, by the sides of the boxes along z.
    #[inline(always)]
    fn value<W: WideLevel<8>>(&self, eight: W, sides: &[Floats<W, 8>; 2]) -> Floats<W, 8> {
        splat(eight, self.slope) * sides[self.z_side & 1] + splat(eight, self.offset)
    }
}

/// Frustum of a group's rays; for parallel rays a prism.
pub(super) struct Frustum {
    axes: [usize; 3],
    /// Planes of low u, high u, low v, high v.
    planes: [FrustumPlane; 4],
    /// Side of a box that is nearest along the frame's z axis.
    near_side: usize,
    sign: f32,
    /// Least depth of a box whose nearest side is at 0 in the world.
    depth_offset: f32,
    origin: [f32; 3],
    slopes: [f32; 2],
    window_error: [f32; 2],
}

impl Frustum {
    /// Computes the frustum of a group, for boxes within `bounds`.
    #[inline(always)]
    pub(super) fn new<J: GroupProjection>(rays: &GroupRays, bounds: &Box3) -> Frustum {
        // Bound the coordinates of boxes and of the rays' origins relative to the frame's origin
        let frame = &rays.frame;
        let mut reach = [0.0; 3];
        for i in 0..3 {
            let axis = frame.axes[i];
            let bound = bounds.low[axis].abs().max(bounds.high[axis].abs());
            reach[i] = frame.origin[i].abs() + bound + frame.spread[i];
        }
        // Compute the planes, moved outwards by their error
        let window = &rays.window;
        let plane = |i: usize, side: f32, border: f32| {
            // Parallel rays keep their distance from z, others their slope
            let (slope, distance) = match J::IS_PARALLEL {
                true => (frame.slopes[i], side * border),
                false => (border, 0.0),
            };
            let error = ERROR * (reach[i] + slope.abs() * reach[2]);
            let slope = -side * slope * frame.sign;
            FrustumPlane {
                slope,
                offset: -side * frame.origin[i] - slope * frame.origin[2] - distance + error,
                z_side: usize::from(slope > 0.0),
            }
        };
        Frustum {
            axes: frame.axes,
            planes: [
                plane(0, 1.0, window.u_min),
                plane(0, -1.0, window.u_max),
                plane(1, 1.0, window.v_min),
                plane(1, -1.0, window.v_max),
            ],
            near_side: usize::from(frame.sign < 0.0),
            sign: frame.sign,
            depth_offset: -frame.sign * frame.origin[2] - ERROR * reach[2],
            origin: frame.origin,
            slopes: rays.slopes,
            window_error: match J::IS_PARALLEL {
                true => [0, 1].map(|i| WINDOW_ERROR * (reach[i] + frame.slopes[i].abs() * reach[2])),
                false => [WINDOW_ERROR * rays.reach; 2],
            },
        }
    }

    /// Returns a mask of the children whose box may contain a hit of the group, and their least depths.
    #[inline(always)]
    pub(super) fn test<W: WideLevel<8>>(
        &self,
        eight: W,
        node: &NativeNode,
        z_max: f32,
    ) -> (u32, Floats<W, 8>) {
        // Evaluate each plane at the corner of the boxes that is farthest inside
        let [kx, ky, kz] = self.axes;
        let sides = [
            Floats::load(eight, &node.bounds[0][kz]),
            Floats::load(eight, &node.bounds[1][kz]),
        ];
        let [low_u, high_u, low_v, high_v] = &self.planes;
        let u = (low_u.value(eight, &sides) + Floats::load(eight, &node.bounds[1][kx]))
            .min(high_u.value(eight, &sides) - Floats::load(eight, &node.bounds[0][kx]));
        let v = (low_v.value(eight, &sides) + Floats::load(eight, &node.bounds[1][ky]))
            .min(high_v.value(eight, &sides) - Floats::load(eight, &node.bounds[0][ky]));
        // Compute the least depths
        let depth = sides[self.near_side & 1] * splat(eight, self.sign) + splat(eight, self.depth_offset);
        let inside = splat(eight, 0.0).le(u.min(v)) & depth.le(splat(eight, z_max));
        (inside.bits(), depth)
    }

    /// Returns a side of a node's boxes relative to the origin of the frame, along one of its axes.
    #[inline(always)]
    fn relative<W: WideLevel<8>>(&self, eight: W, node: &NativeNode, side: usize, i: usize) -> Floats<W, 8> {
        Floats::load(eight, &node.bounds[side][self.axes[i]]) - splat(eight, self.origin[i])
    }

    /// Returns the windows of a node's boxes in the plane: exactly, as a box is projected farthest out at corners, up to
    /// an error bound.
    #[inline(always)]
    pub(super) fn windows<W: WideLevel<8>, J: GroupProjection>(
        &self,
        eight: W,
        node: &NativeNode,
    ) -> [[f32; WIDTH]; 4] {
        if J::IS_PARALLEL {
            return self.sheared_windows(eight, node);
        }
        // Compute the reciprocals of the least and the greatest depths
        let sign = splat(eight, self.sign);
        let least = splat(eight, MIN_DEPTH);
        let near = (self.relative(eight, node, self.near_side & 1, 2) * sign).max(least);
        let far = (self.relative(eight, node, 1 - (self.near_side & 1), 2) * sign).max(least);
        let one = splat(eight, 1.0);
        let (per_near, per_far) = (one / near, one / far);
        let zero = splat(eight, 0.0);
        let mut out = [[0.0; WIDTH]; 4];
        for i in 0..2 {
            // Divide each side by the depth at which it is farthest out
            let (low, high) = (self.relative(eight, node, 0, i), self.relative(eight, node, 1, i));
            let low = low * low.lt(zero).select(per_near, per_far);
            let high = high * high.lt(zero).select(per_far, per_near);
            // Widen the windows by their error
            out[2 * i] = (low - splat(eight, self.slopes[i] + self.window_error[i])).to_array();
            out[2 * i + 1] = (high - splat(eight, self.slopes[i] - self.window_error[i])).to_array();
        }
        out
    }

    /// Returns the windows of a node's boxes along the common direction.
    #[inline(always)]
    fn sheared_windows<W: WideLevel<8>>(&self, eight: W, node: &NativeNode) -> [[f32; WIDTH]; 4] {
        let sign = splat(eight, self.sign);
        let depths = [
            self.relative(eight, node, 0, 2) * sign,
            self.relative(eight, node, 1, 2) * sign,
        ];
        let mut out = [[0.0; WIDTH]; 4];
        for i in 0..2 {
            // Shear each side by the depth at which it is farthest out, and widen the window by its error
            let slope = splat(eight, self.slopes[i]);
            let (a, b) = (slope * depths[0], slope * depths[1]);
            let error = splat(eight, self.window_error[i]);
            let (low, high) = (self.relative(eight, node, 0, i), self.relative(eight, node, 1, i));
            out[2 * i] = (low - a.max(b) - error).to_array();
            out[2 * i + 1] = (high - a.min(b) + error).to_array();
        }
        out
    }
}

/// Window with a least depth.
#[derive(Clone, Copy)]
pub(super) struct DepthWindow {
    pub(super) u_min: f32,
    pub(super) u_max: f32,
    pub(super) v_min: f32,
    pub(super) v_max: f32,
    pub(super) z_min: f32,
}

impl DepthWindow {
    /// Returns a mask of the eight windows of a row that overlap this one and reach its depth.
    #[inline(always)]
    pub(super) fn overlap<const R: usize>(
        &self,
        isa: impl SimdLevel,
        windows: &Windows<R>,
        row: usize,
    ) -> u32 {
        // Compare both sides along u and v, then the depths
        let (eight, row) = (isa.eight(), row % R);
        let u = splat(eight, self.u_min).le(Floats::load(eight, &windows.u_max[row]))
            & Floats::load(eight, &windows.u_min[row]).le(splat(eight, self.u_max));
        let v = splat(eight, self.v_min).le(Floats::load(eight, &windows.v_max[row]))
            & Floats::load(eight, &windows.v_min[row]).le(splat(eight, self.v_max));
        let z = splat(eight, self.z_min).le(Floats::load(eight, &windows.z_max[row]));
        (u & v & z).bits()
    }

    /// Returns a mask of the tiles that overlap this window.
    #[inline(always)]
    pub(super) fn tiles(&self, isa: impl SimdLevel, rays: &GroupRays) -> u32 {
        match rays.tile_count() {
            0..=1 => 1,
            _ => self.overlap(isa, &rays.tiles, 0),
        }
    }

    /// Returns a mask of the rays of a packet that are in this window.
    #[inline(always)]
    pub(super) fn rays(&self, isa: impl SimdLevel, rays: &GroupRays, packet: usize) -> u32 {
        // Compare the points with all sides, then the depths
        let (sixteen, packet) = (isa.sixteen(), packet % PACKETS);
        let u = Floats::load(sixteen, &rays.u[packet]);
        let v = Floats::load(sixteen, &rays.v[packet]);
        let in_u = splat(sixteen, self.u_min).le(u) & u.le(splat(sixteen, self.u_max));
        let in_v = splat(sixteen, self.v_min).le(v) & v.le(splat(sixteen, self.v_max));
        let z = splat(sixteen, self.z_min).le(Floats::load(sixteen, &rays.z[packet]));
        (in_u & in_v & z).bits()
    }

    /// Returns whether any ray is in this window.
    #[inline(always)]
    pub(super) fn has_ray(&self, isa: impl SimdLevel, rays: &GroupRays) -> bool {
        for tile in lanes(self.tiles(isa, rays)) {
            for slot in lanes(self.overlap(isa, &rays.packets, tile)) {
                if self.rays(isa, rays, 8 * tile + slot) != 0 {
                    return true;
                }
            }
        }
        false
    }
}
