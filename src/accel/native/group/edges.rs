//! Triangles as three planes through the frame's origin: the test of points in a plane.
//!
//! With the homogeneous vertices V₀, V₁, V₂ `= (x, y, w)` in the frame, edge `e` opposite to vertex `e` spans a plane with
//! the origin whose normal is `(a, b, c) = Vᵢ × Vⱼ`, and the ray (u, v, 1) is on the inner side if `E = a u + b v + c` has
//! the sign of the triangle's determinant. The three E are in proportion to the barycentric weights, so they also give the
//! depth. This is the test of "2D homogeneous rasterization" (M. Olano and T. Greer, 1997). Rays with a common end have w =
//! z, those with a common direction w = 1, which makes the edge functions those of 2-D.
//!
//! # Watertightness
//!
//! A normal is computed by two products and a difference, never fused, so for the neighbour, which has the same vertices
//! in opposite order, it has exactly the opposite sign, and so does E. A bound of the rounding error is added to every E,
//! so that in f32 both neighbours accept rays close to their common edge; such a ray is decided in f64 from the same
//! rounded vertices (`decide`).

use crate::mesh::simd::{Floats, LaneMask, WideLevel};

use super::frame::splat;
use super::projection::GroupProjection;
use super::query::GroupQuery;
use super::rays::{GroupRays, GroupWindow};
use crate::accel::native::layout::LeafBlock;

/// Error of an edge function relative to the sum of the magnitudes of its products: eight units of roundoff, rounded up, for
/// two products and a difference, and two products and two sums with the ray.
const EDGE_ERROR: f32 = 5e-7;
/// Error of a depth relative to the greatest depth of a vertex: eight units of roundoff, rounded up.
const DEPTH_ERROR: f32 = 5e-7;
/// Error of the position of a vertex relative to a ray in the plane, relative to the greatest magnitude of coordinates: 16
/// units of roundoff, rounded up, for four roundings of the vertex and four of the ray. Those of vertices count twice, as
/// each vertex has two edges.
const POSITION_ERROR: f32 = 1e-6;

/// Vertices of eight triangles in the frame of a group, with their depths.
#[derive(Clone, Copy)]
pub(super) struct BlockCorners<W: WideLevel<8>> {
    pub(super) x: [Floats<W, 8>; 3],
    pub(super) y: [Floats<W, 8>; 3],
    pub(super) w: [Floats<W, 8>; 3],
    pub(super) z: [Floats<W, 8>; 3],
}

impl<W: WideLevel<8>> BlockCorners<W> {
    /// Moves the vertices of a block into the frame. Each vertex is moved alike in all triangles that share it.
    #[inline(always)]
    pub(super) fn new<J: GroupProjection>(eight: W, block: &LeafBlock, rays: &GroupRays) -> BlockCorners<W> {
        let frame = &rays.frame;
        let [kx, ky, kz] = frame.axes;
        let zero = splat(eight, 0.0);
        let mut corners = BlockCorners {
            x: [zero; 3],
            y: [zero; 3],
            w: [zero; 3],
            z: [zero; 3],
        };
        for corner in 0..3 {
            // Move the corners of all triangles to the origin of the frame
            let rows = &block.triangles.corners[corner];
            let x = Floats::load(eight, &rows[kx]) - splat(eight, frame.origin[0]);
            let y = Floats::load(eight, &rows[ky]) - splat(eight, frame.origin[1]);
            let z =
                (Floats::load(eight, &rows[kz]) - splat(eight, frame.origin[2])) * splat(eight, frame.sign);
            // Shear them, so that the common direction, or the group's centre, points along z
            corners.x[corner] = x - splat(eight, rays.slopes[0]) * z;
            corners.y[corner] = y - splat(eight, rays.slopes[1]) * z;
            corners.w[corner] = if J::IS_PARALLEL { splat(eight, 1.0) } else { z };
            corners.z[corner] = z;
        }
        corners
    }
}

/// Edge functions of eight triangles, or of one triangle in all lanes.
#[derive(Clone, Copy)]
pub(super) struct Edges<W: WideLevel<N>, const N: usize> {
    pub(super) a: [Floats<W, N>; 3],
    pub(super) b: [Floats<W, N>; 3],
    /// Constant terms, with [`Edges::error`] added.
    pub(super) c: [Floats<W, N>; 3],
    /// Error bounds of the edge functions for all rays of the group.
    pub(super) error: [Floats<W, N>; 3],
    /// Depths of the vertices.
    pub(super) z: [Floats<W, N>; 3],
    /// Error bound of depths times the magnitude of the sum of the edge functions: a constant, and a multiple of that
    /// magnitude. Only for queries whose rays start at surfaces; else 0.
    depth_error: [Floats<W, N>; 2],
}

/// Edge functions of eight triangles, oriented so that the inside is positive.
pub(super) struct OrientedEdges<W: WideLevel<8>> {
    pub(super) edges: Edges<W, 8>,
    /// Mask of the triangles that may have either orientation, for their determinant is as small as its error.
    pub(super) ambiguous: u32,
}

impl<W: WideLevel<8>> OrientedEdges<W> {
    /// Computes the edge functions.
    #[inline(always)]
    pub(super) fn new<P: GroupQuery>(
        eight: W,
        corners: &BlockCorners<W>,
        group: &GroupRays,
    ) -> OrientedEdges<W> {
        let BlockCorners { x, y, w, z } = corners;
        let window = &group.centred;
        // Bound the rays' coordinates
        let reach_u = splat(eight, window.u_min.abs().max(window.u_max.abs()));
        let reach_v = splat(eight, window.v_min.abs().max(window.v_max.abs()));
        let zero = [splat(eight, 0.0); 3];
        let mut edges = Edges {
            a: zero,
            b: zero,
            c: zero,
            error: zero,
            z: *z,
            depth_error: [splat(eight, 0.0); 2],
        };
        let mut magnitude = splat(eight, 0.0);
        for e in 0..3 {
            // Compute the normal of the plane through the origin and the edge
            let (i, j) = ((e + 1) % 3, (e + 2) % 3);
            let (a0, a1) = (y[i] * w[j], w[i] * y[j]);
            let (b0, b1) = (w[i] * x[j], x[i] * w[j]);
            let (c0, c1) = (x[i] * y[j], y[i] * x[j]);
            edges.a[e] = a0 - a1;
            edges.b[e] = b0 - b1;
            edges.c[e] = c0 - c1;
            // Bound the error of the edge function
            let (a, b, c) = (a0.abs() + a1.abs(), b0.abs() + b1.abs(), c0.abs() + c1.abs());
            edges.error[e] = splat(eight, EDGE_ERROR) * (a * reach_u + (b * reach_v + c));
            if e == 0 {
                magnitude = x[0].abs() * a + (y[0].abs() * b + w[0].abs() * c);
            }
        }
        // Orient the triangles by their determinants
        let determinant = x[0] * edges.a[0] + (y[0] * edges.b[0] + w[0] * edges.c[0]);
        let sign = determinant.sign();
        for e in 0..3 {
            edges.a[e] = edges.a[e] ^ sign;
            edges.b[e] = edges.b[e] ^ sign;
            edges.c[e] = (edges.c[e] ^ sign) + edges.error[e];
        }
        if P::IS_ANY {
            edges.depth_error = edges.depth_error_bound::<P::Projection>(eight, group);
        }
        // Find determinants that are as small as their error
        let ambiguous = determinant.abs().le(magnitude * splat(eight, EDGE_ERROR));
        OrientedEdges {
            edges,
            ambiguous: ambiguous.bits(),
        }
    }

    /// Returns a mask of the triangles that no edge separates from the group's window.
    #[inline(always)]
    pub(super) fn reaching(&self, eight: W, window: &GroupWindow) -> u32 {
        let edges = &self.edges;
        let mut least = splat(eight, f32::INFINITY);
        for e in 0..3 {
            // Find the greatest value in the window, at one of its corners
            let (a, b, c) = (edges.a[e], edges.b[e], edges.c[e]);
            let u = (a * splat(eight, window.u_min)).max(a * splat(eight, window.u_max));
            let v = (b * splat(eight, window.v_min)).max(b * splat(eight, window.v_max));
            least = least.min(c + (u + v) + splat(eight, EDGE_ERROR) * c.abs());
        }
        splat(eight, 0.0).le(least).bits() | self.ambiguous
    }

    /// Turns all triangles around.
    #[inline(always)]
    pub(super) fn flip(&mut self, eight: W) {
        let minus = splat(eight, -0.0);
        let edges = &mut self.edges;
        for e in 0..3 {
            edges.a[e] = edges.a[e] ^ minus;
            edges.b[e] = edges.b[e] ^ minus;
            edges.c[e] = (edges.error[e] + edges.error[e]) - edges.c[e];
        }
    }
}

/// Rows of [`Edges`] in memory, from which one triangle is broadcast to all lanes.
pub(super) struct EdgeRows {
    rows: [[[f32; 8]; 3]; 5],
    depth_error: [[f32; 8]; 2],
}

impl EdgeRows {
    /// Stores the edge functions of eight triangles.
    #[inline(always)]
    pub(super) fn new<P: GroupQuery, W: WideLevel<8>>(edges: &Edges<W, 8>) -> EdgeRows {
        let mut rows = [[[0.0; 8]; 3]; 5];
        for e in 0..3 {
            rows[0][e] = edges.a[e].to_array();
            rows[1][e] = edges.b[e].to_array();
            rows[2][e] = edges.c[e].to_array();
            rows[3][e] = edges.error[e].to_array();
            rows[4][e] = edges.z[e].to_array();
        }
        let mut depth_error = [[0.0; 8]; 2];
        if P::IS_ANY {
            let [constant, per_sum] = edges.depth_error;
            depth_error = [constant.to_array(), per_sum.to_array()];
        }
        EdgeRows { rows, depth_error }
    }

    /// Returns one triangle in all lanes.
    #[inline(always)]
    pub(super) fn broadcast<P: GroupQuery, W: WideLevel<N>, const N: usize>(
        &self,
        level: W,
        triangle: usize,
    ) -> Edges<W, N> {
        let zero = [splat(level, 0.0); 3];
        let mut edges = Edges {
            a: zero,
            b: zero,
            c: zero,
            error: zero,
            z: zero,
            depth_error: [splat(level, 0.0); 2],
        };
        let triangle = triangle % 8;
        for e in 0..3 {
            edges.a[e] = splat(level, self.rows[0][e][triangle]);
            edges.b[e] = splat(level, self.rows[1][e][triangle]);
            edges.c[e] = splat(level, self.rows[2][e][triangle]);
            edges.error[e] = splat(level, self.rows[3][e][triangle]);
            edges.z[e] = splat(level, self.rows[4][e][triangle]);
        }
        if P::IS_ANY {
            let [constant, per_sum] = &self.depth_error;
            edges.depth_error = [splat(level, constant[triangle]), splat(level, per_sum[triangle])];
        }
        edges
    }
}

/// Rays that may hit a triangle: those of a packet with one triangle, or one ray with eight triangles.
#[derive(Clone, Copy)]
pub(super) struct ProjectedRays<W: WideLevel<N>, const N: usize> {
    pub(super) u: Floats<W, N>,
    pub(super) v: Floats<W, N>,
    /// Depth from which the rays search.
    pub(super) z_near: Floats<W, N>,
    /// Depth up to which the rays search.
    pub(super) z: Floats<W, N>,
}

/// Lanes in which a triangle may be hit.
#[derive(Clone, Copy)]
pub(super) struct CandidateLanes<W: WideLevel<N>, const N: usize> {
    /// Mask of the lanes whose hit counts, if [`CandidateLanes::near_edge`] does not say otherwise.
    pub(super) inside: LaneMask<W, N>,
    /// Mask of the lanes that are to be decided in f64.
    pub(super) near_edge: LaneMask<W, N>,
    /// Depths of the hits.
    pub(super) z: Floats<W, N>,
    /// Magnitude of the sum of the edge functions.
    sum: Floats<W, N>,
    /// Error bound of the depths times [`CandidateLanes::sum`], for queries whose rays start at surfaces; else 0.
    depth_error: Floats<W, N>,
}

impl<W: WideLevel<N>, const N: usize> CandidateLanes<W, N> {
    /// Returns the lanes whose hits, at the depths `z`, are within the rays' depths. Those of rays that start at surfaces
    /// may lie behind the start by their error.
    #[inline(always)]
    pub(super) fn within<P: GroupQuery>(
        &self,
        z: Floats<W, N>,
        rays: &ProjectedRays<W, N>,
    ) -> LaneMask<W, N> {
        let before_far = match P::IS_ANY {
            true => ((z - rays.z) * self.sum).le(self.depth_error),
            false => z.le(rays.z),
        };
        rays.z_near.le(z) & before_far
    }

    /// Returns a mask of the lanes whose hits, at the depths `z`, are so near the start that they may lie behind it.
    #[inline(always)]
    pub(super) fn near_start(&self, z: Floats<W, N>, rays: &ProjectedRays<W, N>) -> u32 {
        ((rays.z - z) * self.sum).le(self.depth_error).bits()
    }
}

impl<W: WideLevel<N>, const N: usize> Edges<W, N> {
    /// Returns the lanes that may be hits within the rays' depths; `None` if there are none.
    #[inline(always)]
    pub(super) fn candidates<P: GroupQuery>(
        &self,
        level: W,
        rays: &ProjectedRays<W, N>,
    ) -> Option<CandidateLanes<W, N>> {
        // Evaluate the edge functions
        let e0 = self.a[0] * rays.u + (self.b[0] * rays.v + self.c[0]);
        let e1 = self.a[1] * rays.u + (self.b[1] * rays.v + self.c[1]);
        let e2 = self.a[2] * rays.u + (self.b[2] * rays.v + self.c[2]);
        let inside = splat(level, 0.0).le(e0.min(e1.min(e2)));
        if inside.bits() == 0 {
            return None;
        }
        // Find lanes close to an edge
        let [error0, error1, error2] = self.error;
        let near_edge = e0.lt(error0 + error0) | e1.lt(error1 + error1) | e2.lt(error2 + error2);
        // Interpolate the depth, without the error bounds
        let e = [e0 - error0, e1 - error1, e2 - error2];
        let sum = e[0] + (e[1] + e[2]);
        let z = (e[0] * self.z[0] + (e[1] * self.z[1] + e[2] * self.z[2])) / sum;
        let sum = sum.abs();
        let [constant, per_sum] = self.depth_error;
        let mut candidates = CandidateLanes {
            inside,
            near_edge: near_edge & inside,
            z,
            sum,
            depth_error: match P::IS_ANY {
                true => constant + per_sum * sum,
                false => splat(level, 0.0),
            },
        };
        // Keep those within the depths; those close to an edge stay until they are decided
        candidates.inside = inside & (candidates.within::<P>(z, rays) | near_edge);
        (candidates.inside.bits() != 0).then_some(candidates)
    }

    /// Returns [`Edges::depth_error`] for the errors of the depths of hits, and of the starts with which they are compared.
    #[inline(always)]
    fn depth_error_bound<J: GroupProjection>(&self, level: W, group: &GroupRays) -> [Floats<W, N>; 2] {
        // Compute the range of the vertices' depths
        let [z0, z1, z2] = self.z;
        let farthest = z0.max(z1.max(z2));
        let span = farthest - z0.min(z1.min(z2));
        // Bound the errors of the edge functions from their own roundings, and from those of vertices and rays in the plane
        let mut slopes = splat(level, 0.0);
        let mut error = splat(level, 0.0);
        for e in 0..3 {
            slopes = slopes + (self.a[e].abs() + self.b[e].abs());
            error = error + self.error[e];
        }
        let mut reach = splat(level, group.reach);
        let mut depth = farthest;
        if J::IS_PARALLEL {
            // Depths have either sign, and both ends of the difference are rounded. A vertex is no farther from a ray
            // inside the triangle than the sum of all sides. With m the greatest coordinate and R the sum of the greatest
            // depths, the errors of two ends of an edge and of the ray are 2 (2 m + 4 R) + 2 m + 3 R units of roundoff
            depth = z0.abs().max(z1.abs().max(z2.abs())) + splat(level, group.frame.spread[2]);
            reach = reach + slopes + depth;
        }
        error = error + slopes * (splat(level, POSITION_ERROR) * reach);
        [error * span, splat(level, DEPTH_ERROR) * depth]
    }
}
