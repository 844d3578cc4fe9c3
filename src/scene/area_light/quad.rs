//! Area light in the shape of a parallelogram: directions are uniform in its solid angle if it is a rectangle seen from
//! near, otherwise points are uniform in area.

use std::f64::consts::TAU;

use glam::DVec3;

use super::{AreaLightError, LightSample, LightVector, SurfacePoint, area_and_normal, lane};
use crate::numeric::lane_math::{acos, sin_cos};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Quad light: the points `center` + x `half_u` + y `half_v` with |x|, |y| <= 1; its front is to the side of `half_u` ×
/// `half_v`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadLight {
    center: DVec3,
    half_u: DVec3,
    half_v: DVec3,
    /// Lengths of the half sides, and their unit vectors.
    lengths: [f64; 2],
    sides: [DVec3; 2],
    normal: DVec3,
    area: f64,
    is_rectangle: bool,
}

/// Largest deviation of a rectangle's sides from 90 degrees, as a cosine: the rounding of sides at a right angle.
const SQUARENESS: f64 = 16.0 * f64::EPSILON;

/// Solid angle in steradian below which points are sampled by area.
///
/// A solid angle is computed as a difference of angles of up to 2π, so to about 2^-50, and the point within with an
/// equal error: 2^-37 of 2^-13. So small a rectangle is seen at nearly one distance and angle, which is when both
/// sampling methods agree.
const MIN_SOLID_ANGLE: f64 = 1.0 / 8192.0;

impl QuadLight {
    /// Creates the parallelogram of these half sides around `center`, in metres.
    pub fn new(center: DVec3, half_u: DVec3, half_v: DVec3) -> Result<QuadLight, AreaLightError> {
        let (quarter, normal) = area_and_normal(half_u, half_v)?;
        let lengths = [half_u.length(), half_v.length()];
        Ok(QuadLight {
            center,
            half_u,
            half_v,
            lengths,
            sides: [half_u / lengths[0], half_v / lengths[1]],
            normal,
            area: 4.0 * quarter,
            is_rectangle: half_u.dot(half_v).abs() <= SQUARENESS * lengths[0] * lengths[1],
        })
    }

    /// Returns the point that `u` selects uniformly from the parallelogram.
    pub(super) fn surface_point(&self, u: [f64; 2]) -> SurfacePoint {
        let [x, y] = u.map(|u| 2.0 * u - 1.0);
        SurfacePoint {
            position: self.center + x * self.half_u + y * self.half_v,
            normal: self.normal,
            primitive: 0,
        }
    }

    /// Samples the point that `u` in [0, 1)² selects for `p`; `None` in the plane of the parallelogram.
    #[inline(always)]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        self.sample_vector(p, u).sample_of_flat(p, self.normal)
    }

    /// Samples the vector from `p` to the point that `u` selects, without branches but on the quad itself.
    #[inline(always)]
    pub(super) fn sample_vector(&self, p: DVec3, u: [f64; 2]) -> LightVector {
        let seen = self.is_rectangle.then(|| SphericalRectangle::new(self, p));
        self.sample_seen(seen.as_ref(), p, u)
    }

    /// Sets `views` to the projections of a rectangle onto the unit spheres around `p`, which all samples at these
    /// points share.
    #[inline(always)]
    pub(super) fn project(&self, p: &Lanes3<f64>, views: &mut SphericalRectanglePacket) {
        if self.is_rectangle {
            for l in 0..LANES {
                views.set(l, &SphericalRectangle::new(self, lane(p, l)));
            }
        }
    }

    /// Samples the vectors from sixteen points like [`QuadLight::sample_vector`]: returns that of lane `l`, whose
    /// projection is in `views`.
    #[inline(always)]
    pub(super) fn sample_vector_of(
        &self,
        views: &SphericalRectanglePacket,
        (l, p): (usize, DVec3),
        u: [f64; 2],
    ) -> LightVector {
        let seen = self.is_rectangle.then(|| views.get(l));
        self.sample_seen(seen.as_ref(), p, u)
    }

    /// Samples the vector from `p` to the point that `u` selects, with the projection of a rectangle.
    #[inline(always)]
    fn sample_seen(&self, seen: Option<&SphericalRectangle>, p: DVec3, u: [f64; 2]) -> LightVector {
        let (x, y) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
        let position = self.center + x * self.half_u + y * self.half_v;
        let by_area = LightVector::of_area(position - p, self.normal, self.area);
        let Some(seen) = seen else {
            return by_area;
        };
        // Sample by solid angle if the rectangle is large enough
        let by_angle = LightVector {
            to_light: seen.sample(self, u),
            pdf: seen.solid_angle.recip(),
            is_front: by_area.is_front,
        };
        by_angle.or(by_area, seen.solid_angle > MIN_SOLID_ANGLE)
    }

    /// Returns the density per steradian with which the direction from `p` to `position`, a point of the quad, is chosen.
    pub(super) fn pdf(&self, p: DVec3, position: DVec3) -> f64 {
        let solid_angle = match self.is_rectangle {
            true => SphericalRectangle::new(self, p).solid_angle,
            false => 0.0,
        };
        if solid_angle > MIN_SOLID_ANGLE {
            return solid_angle.recip();
        }
        LightVector::of_area(position - p, self.normal, self.area).pdf
    }

    /// Returns the area of one side in square metres.
    pub fn area(&self) -> f64 {
        self.area
    }
}

/// Rectangle projected onto the unit sphere around a point (C. Ureña, M. Fajardo, A. King, "An Area-Preserving
/// Parametrization for Spherical Rectangles", EGSR 2013), in coordinates along its sides and its normal, with the point
/// as the origin.
struct SphericalRectangle {
    x: [f64; 2],
    y: [f64; 2],
    /// Distance of the rectangle's plane along its normal; negative in front of it.
    plane: f64,
    /// Third components of the normals of the planes through the point and the edges at `y[0]` and `y[1]`.
    b: [f64; 2],
    /// Value of 2π minus the last two of the four inner angles of the spherical rectangle.
    k: f64,
    /// Solid angle of the rectangle in steradian.
    solid_angle: f64,
}

impl SphericalRectangle {
    /// Projects `quad` onto the unit sphere around `p`.
    #[inline(always)]
    fn new(quad: &QuadLight, p: DVec3) -> SphericalRectangle {
        let to_center = quad.center - p;
        let plane = to_center.dot(quad.normal);
        let height = plane.abs();
        let extent = |axis: usize| {
            let middle = to_center.dot(quad.sides[axis]);
            [middle - quad.lengths[axis], middle + quad.lengths[axis]]
        };
        let (x, y) = (extent(0), extent(1));
        // The planes through the edges at y[0], x[1], y[1], x[0] have normals in the plane of one axis and the third.
        let length = |a: f64| (height * height + a * a).sqrt();
        let [n0, n2] = [length(y[0]), length(y[1])];
        let [n3, n1] = [length(x[0]), length(x[1])];
        let b = [-y[0] / n0, y[1] / n2];
        let c = [x[1] / n1, -x[0] / n3];
        // Inner angles: the dot products of neighbouring normals are those of their third components.
        let angle = |a: f64, b: f64| acos((-a * b).clamp(-1.0, 1.0));
        let g = [
            angle(b[0], c[0]),
            angle(c[0], b[1]),
            angle(b[1], c[1]),
            angle(c[1], b[0]),
        ];
        let k = TAU - g[2] - g[3];
        SphericalRectangle {
            x,
            y,
            plane,
            b,
            k,
            solid_angle: g[0] + g[1] - k,
        }
    }

    /// Returns the vector to a point of the rectangle, uniformly in solid angle.
    #[inline(always)]
    fn sample(&self, quad: &QuadLight, u: [f64; 2]) -> DVec3 {
        let height = self.plane.abs();
        let [sine, cosine] = sin_cos(u[0] * self.solid_angle + self.k);
        let f = (cosine * self.b[0] - self.b[1]) / sine;
        // Compute the direction cosine of the third axis' plane, and from it x: c / sqrt(1 - c²) with c = ±1 / sqrt(f²
        // + b²).
        let squared = (f * f + self.b[0] * self.b[0] - 1.0).max(0.0);
        let x = (height / squared.sqrt())
            .copysign(f)
            .max(self.x[0])
            .min(self.x[1]);
        // Sample y uniformly in height on the sphere's arc at x
        let squared = x * x + height * height;
        let sine = |y: f64| y / (squared + y * y).sqrt();
        let (h0, h1) = (sine(self.y[0]), sine(self.y[1]));
        let h = h0 + u[1] * (h1 - h0);
        let y = (h * (squared / ((1.0 - h) * (1.0 + h))).sqrt())
            .max(self.y[0])
            .min(self.y[1]);
        x * quad.sides[0] + y * quad.sides[1] + self.plane * quad.normal
    }
}

/// Projections of a rectangle onto the unit spheres around sixteen points.
#[derive(Clone, Debug)]
pub(super) struct SphericalRectanglePacket {
    x: [Lanes<f64>; 2],
    y: [Lanes<f64>; 2],
    plane: Lanes<f64>,
    b: [Lanes<f64>; 2],
    k: Lanes<f64>,
    solid_angle: Lanes<f64>,
}

impl SphericalRectanglePacket {
    pub(super) const ZERO: SphericalRectanglePacket = SphericalRectanglePacket {
        x: [[0.0; LANES]; 2],
        y: [[0.0; LANES]; 2],
        plane: [0.0; LANES],
        b: [[0.0; LANES]; 2],
        k: [0.0; LANES],
        solid_angle: [0.0; LANES],
    };

    #[inline(always)]
    fn set(&mut self, l: usize, rectangle: &SphericalRectangle) {
        for end in 0..2 {
            self.x[end][l] = rectangle.x[end];
            self.y[end][l] = rectangle.y[end];
            self.b[end][l] = rectangle.b[end];
        }
        self.plane[l] = rectangle.plane;
        self.k[l] = rectangle.k;
        self.solid_angle[l] = rectangle.solid_angle;
    }

    #[inline(always)]
    fn get(&self, l: usize) -> SphericalRectangle {
        SphericalRectangle {
            x: [self.x[0][l], self.x[1][l]],
            y: [self.y[0][l], self.y[1][l]],
            plane: self.plane[l],
            b: [self.b[0][l], self.b[1][l]],
            k: self.k[l],
            solid_angle: self.solid_angle[l],
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::super::AreaLight;
    use super::super::tests::mean;
    use super::*;

    /// Returns a window of 3 by 1 metres in an oblique position.
    fn window() -> QuadLight {
        let u = DVec3::new(0.48, 0.6, 0.64) * 1.5;
        let v = DVec3::new(-0.8, 0.0, 0.6) * 0.5;
        QuadLight::new(DVec3::new(0.3, 0.1, 2.0), u, v).unwrap()
    }

    /// Test points at the side, in front, behind, near and very near.
    const VIEWPOINTS: [DVec3; 6] = [
        DVec3::ZERO,
        DVec3::new(3.0, -1.0, 1.0),
        DVec3::new(-1.0, 2.0, 4.0),
        DVec3::new(0.3, 0.5, 1.8),
        DVec3::new(0.35, 0.11, 2.0),
        DVec3::new(6.0, 5.0, -7.0),
    ];

    fn corners(quad: &QuadLight) -> [DVec3; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| quad.center + x * quad.half_u + y * quad.half_v)
    }

    /// Returns the solid angle of a triangle: tan(Ω/2) = |a·(b×c)| / (1 + a·b + b·c + c·a) for unit vectors (A. van
    /// Oosterom, J. Strackee, IEEE Trans. Biomed. Eng. 30(2), 1983).
    fn triangle_solid_angle(p: DVec3, triangle: [DVec3; 3]) -> f64 {
        let [a, b, c] = triangle.map(|corner| (corner - p).normalize());
        let below = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        2.0 * a.dot(b.cross(c)).abs().atan2(below)
    }

    fn quad_solid_angle(quad: &QuadLight, p: DVec3) -> f64 {
        let [a, b, c, d] = corners(quad);
        triangle_solid_angle(p, [a, b, c]) + triangle_solid_angle(p, [a, c, d])
    }

    /// Returns ∫ ω dω over the quad: half the sum over the edges of their angle times the normal of their plane (J.
    /// Lambert, 1760).
    fn light_vector(quad: &QuadLight, p: DVec3) -> DVec3 {
        let seen = corners(quad).map(|corner| (corner - p).normalize());
        let sum: DVec3 = (0..4)
            .map(|i| {
                let across = seen[i].cross(seen[(i + 1) % 4]);
                across.normalize() * across.length().atan2(seen[i].dot(seen[(i + 1) % 4]))
            })
            .sum();
        let vector = 0.5 * sum;
        vector * vector.dot(quad.center - p).signum()
    }

    #[test]
    fn a_rectangle_is_seen_in_its_solid_angle() {
        let quad = window();
        assert!(quad.is_rectangle);
        for p in VIEWPOINTS {
            let exact = quad_solid_angle(&quad, p);
            let sample = quad.sample(p, [0.2, 0.7]).unwrap();
            assert!(
                (sample.pdf * exact - 1.0).abs() < 1e-11,
                "{p}: {}, not {}",
                sample.pdf.recip(),
                exact
            );
        }
        // From the axis of a square at a distance of its half side, it covers a sixth of the sphere.
        let side = QuadLight::new(DVec3::Z, DVec3::X, DVec3::Y).unwrap();
        let sixth = side.sample(DVec3::ZERO, [0.5; 2]).unwrap().pdf.recip();
        assert!((sixth - 4.0 * PI / 6.0).abs() < 1e-14);
    }

    #[test]
    fn the_directions_to_a_rectangle_add_up_to_lamberts_vector() {
        let quad = window();
        for p in VIEWPOINTS {
            let exact = light_vector(&quad, p);
            for axis in 0..3 {
                let found = mean(&AreaLight::Quad(quad), p, 512, |s| s.direction[axis] / s.pdf);
                assert!(
                    (found - exact[axis]).abs() < 5e-5 * exact.length(),
                    "{p}: {found}, not {exact}"
                );
            }
        }
    }

    #[test]
    fn all_samples_lie_within_the_rectangle() {
        let quad = window();
        for p in VIEWPOINTS {
            mean(&AreaLight::Quad(quad), p, 64, |s| {
                let from_center = s.position - quad.center;
                assert!(from_center.dot(quad.normal).abs() < 1e-14, "{p}");
                for half in [quad.half_u, quad.half_v] {
                    assert!(
                        from_center.dot(half).abs() <= half.length_squared() * (1.0 + 1e-12),
                        "{p}"
                    );
                }
                0.0
            });
        }
    }

    #[test]
    fn a_parallelogram_is_sampled_by_area_and_gives_its_solid_angle_and_vector() {
        let quad = QuadLight {
            half_u: window().half_u + 0.6 * window().half_v,
            is_rectangle: false,
            ..window()
        };
        for p in VIEWPOINTS.into_iter().filter(|p| p.distance(quad.center) > 0.5) {
            let light = AreaLight::Quad(quad);
            let exact = quad_solid_angle(&quad, p);
            let found = mean(&light, p, 1024, |s| s.pdf.recip());
            assert!((found / exact - 1.0).abs() < 1e-5, "{p}: {found}, not {exact}");
            let vector = light_vector(&quad, p);
            let found = mean(&light, p, 1024, |s| s.direction.x / s.pdf);
            assert!((found - vector.x).abs() < 1e-5 * vector.length(), "{p}");
        }
        assert!(
            !QuadLight::new(quad.center, quad.half_u, quad.half_v)
                .unwrap()
                .is_rectangle
        );
    }

    #[test]
    fn sampling_methods_agree_at_their_boundary() {
        let quad = window();
        // 3 square metres at 2^-13 sr: a distance of about 157 metres.
        let toward = (quad.normal + 0.3 * quad.half_u).normalize();
        for distance in [100.0, 140.0, 150.0, 160.0, 200.0, 1e4, 1e9] {
            let p = quad.center + distance * toward;
            let found = mean(&AreaLight::Quad(quad), p, 64, |s| s.pdf.recip());
            let exact = light_vector(&quad, p).length();
            // The vector is shorter than the solid angle by about Ω / 8π; the closed form has lost 2^-50 / Ω.
            let bound = 1e-4 * (100.0 / distance).powi(2) + 1e-15 / exact;
            assert!(
                (found / exact - 1.0).abs() < bound.max(1e-5),
                "{distance}: {found}, not {exact}"
            );
        }
    }
}
