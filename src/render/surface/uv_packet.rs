//! Texture coordinates of sixteen hits, and the footprints of their rays in these coordinates.
//!
//! The ellipse in which a ray's cone cuts the surface is computed in world space ([`FootprintPacket`]); barycentric
//! coordinates, which are linear on a triangle, then take its axes to any set of texture coordinates.

use glam::DVec3;

use super::cone_source::ConeSource;
use super::interaction::SurfaceScene;
use super::packet::SurfacePacket;
use super::vertex_fetch::FetchedVertices;
use crate::accel::RayPacket;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::shading::UvPacket;

/// Footprints of sixteen rays on the surfaces that they hit. Lanes without a hit may hold any values.
pub(super) struct FootprintPacket {
    /// Axes of the ellipses in world space as full lengths, the longer first.
    world: [Lanes3<f64>; 2],
    /// Axes in the barycentric coordinates of the hit triangles: steps of the second and of the third corner's weight.
    barycentric: [[Lanes<f64>; 2]; 2],
    /// True if all rays are without width, and the axes zero.
    are_points: bool,
}

impl FootprintPacket {
    pub(super) const ZERO: FootprintPacket = FootprintPacket {
        world: [[[0.0; LANES]; 3]; 2],
        barycentric: [[[0.0; LANES]; 2]; 2],
        are_points: true,
    };

    /// Returns the axes in world space as full lengths, the longer first.
    pub(super) fn axes(&self) -> &[Lanes3<f64>; 2] {
        &self.world
    }

    /// Returns the axes of lane `l` in world space.
    pub(super) fn world_axes(&self, l: usize) -> [DVec3; 2] {
        self.world
            .each_ref()
            .map(|axis| DVec3::new(axis[0][l], axis[1][l], axis[2][l]))
    }

    /// Computes the footprints of the rays of `packet`.
    #[inline(always)]
    pub(super) fn fill(
        &mut self,
        scene: &SurfaceScene,
        packet: &RayPacket,
        widths: ConeSource,
        points: &SurfacePacket,
        gathered: &FetchedVertices,
    ) {
        if matches!(widths, ConeSource::None) {
            if !self.are_points {
                *self = FootprintPacket::ZERO;
            }
            return;
        }
        self.are_points = false;
        self.cut_surfaces(&cone_widths(packet, widths), points);
        self.cross_triangles(&world_edges(scene, packet, gathered));
    }

    /// Computes the ellipses in which cones of these widths cut the surfaces: see
    /// [`axes_on_surface`](crate::shading::ray_cone::axes_on_surface), whose method this is.
    #[inline(always)]
    fn cut_surfaces(&mut self, widths: &Lanes<f64>, points: &SurfacePacket) {
        let longest = f64::MAX.sqrt();
        for l in 0..LANES {
            let wide = |v: &Lanes3<f32>| DVec3::new(v[0][l].into(), v[1][l].into(), v[2][l].into());
            let (n, d) = (wide(&points.ng), -wide(&points.wo));
            let cos = d.dot(n);
            // Take the plane of incidence, or any plane for a ray along the normal
            let in_plane = d - n * cos;
            let squared = in_plane.length_squared();
            let along = if squared > 0.0 {
                in_plane / squared.sqrt()
            } else {
                n.any_orthonormal_vector()
            };
            let across = n.cross(along) * widths[l];
            let length = (widths[l] / cos.abs()).min(longest);
            // A zero width seen edge-on gives 0 / 0
            let along = along * if widths[l] == 0.0 { 0.0 } else { length };
            for axis in 0..3 {
                self.world[0][axis][l] = along[axis];
                self.world[1][axis][l] = across[axis];
            }
        }
    }

    /// Computes the axes in barycentric coordinates of triangles with these edges from their first corner.
    #[inline(always)]
    fn cross_triangles(&mut self, edges: &[Lanes3<f64>; 2]) {
        for l in 0..LANES {
            let lane = |v: &Lanes3<f64>| DVec3::new(v[0][l], v[1][l], v[2][l]);
            let (e1, e2) = (lane(&edges[0]), lane(&edges[1]));
            // Use the dual basis of the edges: a step s changes the weights by s . (e2 x n) and s . (n x e1), over n . n
            let n = e1.cross(e2);
            let scale = n.length_squared().recip();
            let (second, third) = (e2.cross(n), n.cross(e1));
            for axis in 0..2 {
                let step = lane(&self.world[axis]) * scale;
                self.barycentric[axis][0][l] = step.dot(second);
                self.barycentric[axis][1][l] = step.dot(third);
            }
        }
    }
}

impl FootprintPacket {
    /// Sets the axes in the texture coordinates of the hit triangles, whose corners have the coordinates `corners`;
    /// zero where these do not span the triangle.
    #[inline(always)]
    fn steps_on_triangles(&self, [a, b, c]: &[[Lanes<f32>; 2]; 3], out: &mut UvPacket) {
        let mut edges = [[[0.0; LANES]; 2]; 2];
        for axis in 0..2 {
            for l in 0..LANES {
                edges[0][axis][l] = f64::from(b[axis][l]) - f64::from(a[axis][l]);
                edges[1][axis][l] = f64::from(c[axis][l]) - f64::from(a[axis][l]);
            }
        }
        let [[u1, v1], [u2, v2]] = &edges;
        for (out, steps) in out.axes.iter_mut().zip(&self.barycentric) {
            for l in 0..LANES {
                let is_degenerate = u1[l] * v2[l] - u2[l] * v1[l] == 0.0;
                for axis in 0..2 {
                    let step = steps[0][l] * edges[0][axis][l] + steps[1][l] * edges[1][axis][l];
                    out[axis][l] = if is_degenerate { 0.0 } else { step as f32 };
                }
            }
        }
    }

    /// Sets the axes in the texture coordinates of the lanes `is_shape`, by which the points have these derivatives:
    /// see [`uv_of`](crate::shading::ray_cone::uv_of), whose method this is.
    #[inline(always)]
    fn steps_on_shapes(&self, derivatives: &[Lanes3<f64>; 2], is_shape: &Lanes<bool>, out: &mut UvPacket) {
        for l in 0..LANES {
            let lane = |v: &Lanes3<f64>| DVec3::new(v[0][l], v[1][l], v[2][l]);
            let [dpdu, dpdv] = [lane(&derivatives[0]), lane(&derivatives[1])];
            let lengths = [dpdu, dpdv].map(|derivative| derivative.length_squared().sqrt());
            let (u, v) = (dpdu / lengths[0], dpdv / lengths[1]);
            let n = u.cross(v);
            let area = n.length_squared();
            // The comparison is false for a derivative of zero
            let spans = area > 0.0;
            let by_step = [v.cross(n) / (area * lengths[0]), n.cross(u) / (area * lengths[1])];
            for axis in 0..2 {
                let step = lane(&self.world[axis]);
                for side in 0..2 {
                    let step = by_step[side].dot(step) as f32;
                    let step = if spans {
                        step.clamp(-f32::MAX, f32::MAX)
                    } else {
                        0.0
                    };
                    let before = out.axes[axis][side][l];
                    out.axes[axis][side][l] = if is_shape[l] { step } else { before };
                }
            }
        }
    }
}

/// Returns the widths of the rays' cones at their hits, which are not negative.
#[inline(always)]
fn cone_widths(packet: &RayPacket, widths: ConeSource) -> Lanes<f64> {
    let d = &packet.direction;
    let mut distances = [0.0; LANES];
    for l in 0..LANES {
        let length = (d[0][l] * d[0][l] + d[1][l] * d[1][l] + d[2][l] * d[2][l]).sqrt();
        distances[l] = f64::from(packet.t_far[l]) * f64::from(length);
    }
    let mut out = [0.0; LANES];
    match widths {
        ConeSource::None => {}
        ConeSource::Camera(cone) => {
            for l in 0..LANES {
                out[l] = cone.after(distances[l]).width.abs();
            }
        }
        ConeSource::Paths(path_states) => {
            for l in 0..LANES {
                out[l] = path_states.cone(l).after(distances[l]).width.abs();
            }
        }
    }
    out
}

/// Returns the edges of the hit triangles from their first corners, in world space.
#[inline(always)]
fn world_edges(scene: &SurfaceScene, packet: &RayPacket, gathered: &FetchedVertices) -> [Lanes3<f64>; 2] {
    let [a, b, c] = &gathered.corners;
    let mut edges = [[[0.0; LANES]; 3]; 2];
    for axis in 0..3 {
        for l in 0..LANES {
            edges[0][axis][l] = f64::from(b[axis][l]) - f64::from(a[axis][l]);
            edges[1][axis][l] = f64::from(c[axis][l]) - f64::from(a[axis][l]);
        }
    }
    if gathered.needs_object_space {
        scene.transform_directions(packet, &mut edges);
    }
    edges
}

impl SurfaceScene<'_> {
    /// Transforms object-space directions at the hits to world space.
    #[inline(never)]
    pub(super) fn transform_directions(&self, packet: &RayPacket, directions: &mut [Lanes3<f64>]) {
        for l in 0..LANES {
            if !self.is_placed(packet.instance[l]) {
                continue;
            }
            let matrix = self.pose(packet, l).world_from_object().matrix3;
            for lanes in &mut *directions {
                let turned = matrix * DVec3::new(lanes[0][l], lanes[1][l], lanes[2][l]);
                for axis in 0..3 {
                    lanes[axis][l] = turned[axis];
                }
            }
        }
    }

    /// Sets the texture coordinates of the lanes in `mask` by the set `set`, and the footprints there.
    #[inline(always)]
    pub(super) fn uv_packet(
        &self,
        set: u32,
        (packet, mask): (&RayPacket, &Lanes<bool>),
        points: &SurfacePacket,
        footprints: &FootprintPacket,
        out: &mut UvPacket,
    ) {
        // Fetch the coordinates of the corners; zero where there are none
        let mut corners = [[[0.0f32; LANES]; 2]; 3];
        let mut has_shapes = false;
        for l in 0..LANES {
            if !mask[l] {
                continue;
            }
            let view = self.view(packet.instance[l]);
            match view.corner_coordinates(set, packet.primitive[l]) {
                Some(uv) => {
                    for corner in 0..3 {
                        corners[corner][0][l] = uv[corner][0];
                        corners[corner][1][l] = uv[corner][1];
                    }
                }
                None => has_shapes |= view.is_shape(),
            }
        }
        // Interpolate them
        let [a, b, c] = &corners;
        for axis in 0..2 {
            for l in 0..LANES {
                let (u, v) = (packet.u[l], packet.v[l]);
                out.uv[axis][l] = (1.0 - u - v) * a[axis][l] + u * b[axis][l] + v * c[axis][l];
            }
        }
        // Take the footprints along
        if footprints.are_points {
            out.axes = UvPacket::ZERO.axes;
        } else {
            footprints.steps_on_triangles(&corners, out);
        }
        if has_shapes {
            self.parametrize_shapes((packet, mask), points, footprints, out);
        }
    }
    /// Sets the coordinates of the lanes in `mask` that hit analytic shapes.
    #[inline(always)]
    fn parametrize_shapes(
        &self,
        (packet, mask): (&RayPacket, &Lanes<bool>),
        points: &SurfacePacket,
        footprints: &FootprintPacket,
        out: &mut UvPacket,
    ) {
        // Gather the derivatives
        let mut derivatives = [[[0.0; LANES]; 3]; 2];
        let mut is_shape = [false; LANES];
        for l in 0..LANES {
            is_shape[l] = mask[l] && self.view(packet.instance[l]).is_shape();
            if is_shape[l] {
                let frame = &points.shape_frames[l];
                for side in 0..2 {
                    out.uv[side][l] = frame.uv[side];
                    for axis in 0..3 {
                        derivatives[side][axis][l] = frame.derivatives[side][axis];
                    }
                }
            }
        }
        if !footprints.are_points {
            footprints.steps_on_shapes(&derivatives, &is_shape, out);
        }
    }
}
