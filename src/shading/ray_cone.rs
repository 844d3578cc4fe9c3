//! Ray cones: the width of a ray at its hit, which gives the texture footprint of one pixel.
//!
//! A cone is a width and a spread angle (Amanatides, "Ray tracing with cones", SIGGRAPH 1984; Akenine-Möller et al.,
//! "Texture level of detail strategies for real-time ray tracing", Ray Tracing Gems, 2019, ch. 20, and "Improved shader
//! and texture level of detail using ray cones", JCGT 10(1), 2021). Its cross section is taken as round.
//!
//! At surfaces, width and spread change by Coddington's equations for a thin bundle, by the geometric mean of the plane
//! of incidence and the plane across it. So refraction preserves the étendue: n² width² spread² is equal on both sides
//! of a flat surface.

use glam::DVec3;

use crate::scene::CameraView;

/// Ray cone: width at the ray's origin and growth along the ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayCone {
    /// Diameter in world units; negative for a bundle that has passed its focus.
    pub width: f64,
    /// Growth of the width per unit of distance: the full angle in radians, small; negative where the bundle converges.
    pub spread: f64,
}

impl RayCone {
    /// Returns the cone of the pixel whose centre is the film point (`x`, `y`), each in [0, 1], of `width` by `height`
    /// pixels.
    ///
    /// Its cross section has the area of the pixel's: the spread is the square root of the pixel's solid angle.
    pub fn of_pixel(view: &CameraView, [x, y]: [f64; 2], [width, height]: [u32; 2]) -> RayCone {
        let ray = view.ray(x, y);
        let right = view.ray(x + 1.0 / f64::from(width), y);
        let below = view.ray(x, y + 1.0 / f64::from(height));
        let length = ray.direction.length();
        let forward = ray.direction / length;
        let side = |right: DVec3, below: DVec3| right.cross(below).dot(forward).abs().sqrt();
        RayCone {
            width: side(right.origin - ray.origin, below.origin - ray.origin),
            spread: side(right.direction - ray.direction, below.direction - ray.direction) / length,
        }
    }

    /// Returns the cone advanced by `distance` in world units: the ray's parameter times the length of its direction.
    #[inline(always)]
    pub fn after(self, distance: f64) -> RayCone {
        RayCone {
            width: self.width + self.spread * distance,
            spread: self.spread,
        }
    }

    /// Returns the cone after a reflection at this mean `curvature` ([`triangle_curvature`]; 1/r of a sphere, positive
    /// where the surface is convex toward the ray).
    ///
    /// Coddington: the spread grows by 2 k w / cos θ in the plane of incidence and by 2 k w cos θ across it.
    #[inline(always)]
    pub fn reflected(self, curvature: f64) -> RayCone {
        RayCone {
            width: self.width,
            spread: self.spread + 2.0 * curvature * self.width,
        }
    }

    /// Returns the cone with its spread increased by `spread`: the share of a rough lobe that one of several rays
    /// covers.
    #[inline(always)]
    pub fn spread_by(self, spread: f64) -> RayCone {
        RayCone {
            spread: self.spread + spread,
            ..self
        }
    }

    /// Returns the cone after refraction by the relative index `eta`, transmitted over incident, at a surface of this
    /// mean `curvature`, positive where it is convex toward the incident side; `cos_i` and `cos_t` are the cosines of
    /// both angles, positive.
    ///
    /// Coddington, in the plane of incidence: w' = w cos t / cos i and s' = s cos i / (η cos t) - k w q / (cos i cos
    /// t); across it: w' = w and s' = s / η - k w q; where q = (η cos t - cos i) / η.
    pub fn refracted(self, eta: f64, [cos_i, cos_t]: [f64; 2], curvature: f64) -> RayCone {
        if !(cos_i > 0.0 && cos_t > 0.0) {
            return self;
        }
        let squeeze = (cos_t / cos_i).sqrt();
        let power = (eta * cos_t - cos_i) / (eta * (cos_t * cos_i).sqrt());
        RayCone {
            width: self.width * squeeze,
            spread: self.spread / (eta * squeeze) - curvature * self.width * power,
        }
    }
}

/// Returns the axes of a cone's footprint on a surface: the ellipse in which a cone of `width` and of unit direction
/// `d` cuts the plane with unit normal `n`. They are full lengths, the longer first: along the plane of incidence it is
/// `width` over the cosine.
///
/// A plane seen edge-on has an unbounded footprint; its axis is clamped to the square root of the largest f64.
pub fn axes_on_surface(width: f64, d: DVec3, n: DVec3) -> [DVec3; 2] {
    let width = width.abs();
    let along = (d - n * d.dot(n))
        .try_normalize()
        .unwrap_or_else(|| n.any_orthonormal_vector());
    let across = n.cross(along);
    let length = (width / d.dot(n).abs()).min(f64::MAX.sqrt());
    // A zero width seen edge-on gives 0 / 0.
    let length = if width == 0.0 { 0.0 } else { length };
    [along * length, across * width]
}

/// Converts a vector in the surface to a step in uv, by least squares; zero where the derivatives do not span the
/// surface.
pub fn uv_of(step: DVec3, [dpdu, dpdv]: [DVec3; 2]) -> [f32; 2] {
    // Use the dual basis: du = (dpdv x n) . step / |n|², with n = dpdu x dpdv. Normalise the derivatives first, so that
    // no square underflows.
    let [Some(u), Some(v)] = [dpdu, dpdv].map(DVec3::try_normalize) else {
        return [0.0; 2];
    };
    let n = u.cross(v);
    let area = n.length_squared();
    if area == 0.0 {
        return [0.0; 2];
    }
    let du = v.cross(n).dot(step) / (area * dpdu.length());
    let dv = n.cross(u).dot(step) / (area * dpdv.length());
    [du, dv].map(|x| (x as f32).clamp(-f32::MAX, f32::MAX))
}

/// Returns the width in uv of an isotropic footprint: of a cone of `width` that hits the surface at the cosine `cos`,
/// where one unit of length spans `uv_density` units of uv.
///
/// The longer axis is used, as in Ray Tracing Gems, ch. 20: grazing views are blurred rather than aliased.
#[inline(always)]
pub fn uv_width(width: f64, cos: f64, uv_density: f64) -> f32 {
    let width = (width * uv_density).abs();
    if width > 0.0 {
        (width / cos.abs()).min(f32::MAX.into()) as f32
    } else {
        0.0
    }
}

/// Returns the units of uv per unit of length on a triangle with corners `p`: the square root of the ratio of its
/// areas.
pub fn triangle_uv_density(p: [DVec3; 3], uv: [[f32; 2]; 3]) -> f64 {
    let [a, b, c] = uv.map(|uv| DVec3::new(uv[0].into(), uv[1].into(), 0.0));
    let area = (p[1] - p[0]).cross(p[2] - p[0]).length();
    let uv_area = (b - a).cross(c - a).length();
    finite_or_zero((uv_area / area).sqrt())
}

/// Returns the units of uv per unit of length at a point with these derivatives by u and v.
pub fn shape_uv_density([dpdu, dpdv]: [DVec3; 2]) -> f64 {
    finite_or_zero(dpdu.cross(dpdv).length().sqrt().recip())
}

/// Returns the mean curvature of a triangle that its corner normals imply, positive where it is convex on their side; 0
/// where flat.
///
/// Along an edge from p0 to p1 the normal turns by (n1 - n0) . (p1 - p0) / |p1 - p0|² per unit of length (Reed, 2014);
/// the result is the mean of the three edges. `n` are of unit length.
#[inline(always)]
pub fn triangle_curvature(p: [DVec3; 3], n: [DVec3; 3]) -> f64 {
    let along = |a: usize, b: usize| edge_curvature([p[a], p[b]], [n[a], n[b]]);
    (along(0, 1) + along(1, 2) + along(2, 0)) / 3.0
}

/// Returns the curvature between two points of a surface with unit normals `n`; 0 if the points coincide.
#[inline(always)]
pub fn edge_curvature([p0, p1]: [DVec3; 2], [n0, n1]: [DVec3; 2]) -> f64 {
    let edge = p1 - p0;
    finite_or_zero((n1 - n0).dot(edge) / edge.length_squared())
}

#[inline(always)]
fn finite_or_zero(x: f64) -> f64 {
    if x.is_finite() { x } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;
    use crate::scene::{Camera, Projection};

    fn view(projection: Projection, width: u32, height: u32) -> CameraView {
        Camera {
            world_from_camera: DAffine3::IDENTITY,
            projection,
            z_near: 0.1,
            ..Camera::default()
        }
        .view(width, height)
    }

    #[test]
    fn the_pixels_of_a_perspective_fill_the_solid_angle_of_its_window() {
        let (width, height) = (60, 40);
        let y_fov = 1.2;
        let view = view(Projection::Perspective { y_fov, aspect: None }, width, height);
        let mut sum = 0.0;
        for j in 0..height {
            for i in 0..width {
                let middle = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n);
                let cone = RayCone::of_pixel(&view, [middle(i, width), middle(j, height)], [width, height]);
                assert_eq!(cone.width, 0.0);
                sum += cone.spread * cone.spread;
            }
        }
        // Rectangle of half sides a, b at distance 1: 4 asin(a b / sqrt((1 + a²)(1 + b²))).
        let b = (0.5 * y_fov).tan();
        let a = 1.5 * b;
        let exact = 4.0 * (a * b / ((1.0 + a * a) * (1.0 + b * b)).sqrt()).asin();
        // Midpoint rule over 40 rows: 1/24 of (1.4/40)² times a second derivative of at most 12.
        assert!((sum / exact - 1.0).abs() < 1e-3, "{sum}, not {exact}");
    }

    #[test]
    fn the_pixels_of_an_orthographic_camera_are_tubes() {
        let projection = Projection::Orthographic {
            y_mag: 2.0,
            x_mag: None,
        };
        let cone = RayCone::of_pixel(&view(projection, 200, 100), [0.3, 0.4], [200, 100]);
        assert_eq!(cone.spread, 0.0);
        assert!((cone.after(1e3).width - 0.04).abs() < 1e-15);
    }

    #[test]
    fn a_convex_mirror_seen_straight_on_has_its_focus_at_half_its_radius() {
        // Parallel light of width w seems to come from r/2 behind the mirror: it spreads by w / (r/2).
        let cone = RayCone {
            width: 0.01,
            spread: 0.0,
        };
        assert_eq!(cone.reflected(1.0 / 5.0).spread, 0.01 / 2.5);
        // A concave mirror focuses it at r/2.
        let focus = cone.reflected(-1.0 / 5.0).after(2.5);
        assert!(focus.width.abs() < 1e-17);
    }

    #[test]
    fn a_lens_surface_seen_straight_on_has_the_lensmakers_focus() {
        // Lens-maker's equation n' / f = (n' - n) / r: from air into 1.5, r = 2, f = 6.
        let cone = RayCone {
            width: 0.01,
            spread: 0.0,
        };
        let inside = cone.refracted(1.5, [1.0, 1.0], 1.0 / 2.0);
        assert!((inside.after(6.0).width).abs() < 1e-16, "{inside:?}");
    }

    #[test]
    fn flat_refraction_keeps_etendue_and_is_reversible() {
        let cone = RayCone {
            width: 0.3,
            spread: 0.02,
        };
        let (eta, sin_i) = (1.5, 0.8f64);
        let cos_i = (1.0 - sin_i * sin_i).sqrt();
        let cos_t = (1.0 - (sin_i / eta).powi(2)).sqrt();
        let inside = cone.refracted(eta, [cos_i, cos_t], 0.0);
        let etendue = |cone: RayCone, n: f64| n * cone.width * cone.spread;
        assert!((etendue(inside, eta) - etendue(cone, 1.0)).abs() < 1e-16);
        let back = inside.refracted(1.0 / eta, [cos_t, cos_i], 0.0);
        assert!((back.width - cone.width).abs() < 1e-15 && (back.spread - cone.spread).abs() < 1e-15);
    }

    #[test]
    fn a_sphere_and_its_triangles_have_the_curvature_one_over_its_radius() {
        let n = [DVec3::X, DVec3::new(0.8, 0.6, 0.0), DVec3::new(0.8, 0.0, 0.6)];
        let curvature = triangle_curvature(n.map(|n| 4.0 * n), n);
        assert!((curvature - 0.25).abs() < 1e-15);
        assert_eq!(triangle_curvature([DVec3::ONE; 3], n), 0.0);
        assert_eq!(triangle_curvature(n, [DVec3::X; 3]), 0.0);
    }

    #[test]
    fn a_footprint_is_longer_by_the_cosine_along_the_plane_of_incidence() {
        let d = DVec3::new(0.6, 0.0, -0.8);
        let [longer, shorter] = axes_on_surface(0.1, d, DVec3::Z);
        assert!((longer - DVec3::X * 0.125).length() < 1e-16);
        assert!((shorter - DVec3::Y * 0.1).length() < 1e-16);
        let [longer, shorter] = axes_on_surface(0.1, -DVec3::Z, DVec3::Z);
        assert!((longer.length() - 0.1).abs() < 1e-16 && (shorter.length() - 0.1).abs() < 1e-16);
        for axis in axes_on_surface(0.1, DVec3::X, DVec3::Z)
            .into_iter()
            .chain(axes_on_surface(0.0, DVec3::X, DVec3::Z))
        {
            assert!(axis.is_finite());
        }
    }

    #[test]
    fn surface_step_maps_to_uv_at_any_scale() {
        for scale in [1e-160, 1e-20, 1.0, 1e20] {
            let derivatives = [
                DVec3::new(1.0, 2.0, 0.5) * scale,
                DVec3::new(0.3, -1.0, 2.0) * scale,
            ];
            let step = 0.25 * derivatives[0] - 3.0 * derivatives[1];
            let uv = uv_of(step, derivatives);
            assert!(
                (uv[0] - 0.25).abs() < 1e-6 && (uv[1] + 3.0).abs() < 1e-6,
                "{scale}: {uv:?}"
            );
        }
        assert_eq!(uv_of(DVec3::X, [DVec3::X, DVec3::X]), [0.0; 2]);
        assert_eq!(uv_of(DVec3::X, [DVec3::ZERO, DVec3::X]), [0.0; 2]);
    }

    #[test]
    fn uv_derivatives_of_triangle_and_shape_agree() {
        // For p = (4 u, 9 v, 0) one unit of uv area is 36 units of area.
        let uv = [[0.0f32, 0.0], [0.5, 0.0], [0.25, 0.75]];
        let p = uv.map(|[u, v]| DVec3::new(4.0 * f64::from(u), 9.0 * f64::from(v), 0.0));
        let triangle = triangle_uv_density(p, uv);
        let shape = shape_uv_density([DVec3::X * 4.0, DVec3::Y * 9.0]);
        assert!((triangle - 1.0 / 6.0).abs() < 1e-15 && (shape - 1.0 / 6.0).abs() < 1e-15);
        assert_eq!(uv_width(0.6, 0.5, shape), 0.2);
        assert_eq!(triangle_uv_density([DVec3::ZERO; 3], uv), 0.0);
        assert_eq!(uv_width(0.6, 0.0, shape), f32::MAX);
    }
}
