//! Area light in the shape of a sphere; directions are uniform in the cone that it subtends.
//!
//! The cone's half-angle has sin = r / d. The textbook's 1 - cos and d² - r² lose their digits for far and near
//! spheres, so they are computed as sin² / (1 + cos) and (d - r) (d + r).

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::{AreaLightError, LightSample, LightVector, SurfacePoint, is_density};
use crate::numeric::warp;
use crate::shape::tangents;

/// Sphere light, which emits outward, and inward to points inside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereLight {
    center: DVec3,
    radius: f64,
}

impl SphereLight {
    /// Creates the sphere of `radius` metres around `center`.
    pub fn new(center: DVec3, radius: f64) -> Result<SphereLight, AreaLightError> {
        let light = SphereLight { center, radius };
        let has_area = radius > 0.0 && center.is_finite() && is_density(light.area());
        has_area.then_some(light).ok_or(AreaLightError::NoArea)
    }

    /// Samples the point that `u` in [0, 1)² selects for `p`: on the visible cap from outside, on the whole sphere from
    /// inside.
    #[inline(always)]
    pub fn sample(&self, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        let vector = self.sample_vector(p, u);
        if !vector.is_front {
            return self.sample_inside(self.center - p, p, u);
        }
        let distance = vector.to_light.length();
        self.sample_toward(p, vector.to_light / distance, distance, vector.pdf)
    }

    /// Samples the vector from `p` to the point of the visible cap that `u` selects, without branches; not on the front
    /// from inside.
    #[inline(always)]
    pub(super) fn sample_vector(&self, p: DVec3, u: [f64; 2]) -> LightVector {
        let to_center = self.center - p;
        let d = to_center.length();
        // Sample a direction in the cone that the sphere subtends
        let sin_max = self.radius / d;
        let cos_max = ((d - self.radius) * (d + self.radius)).sqrt() / d;
        let below_max = sin_max * sin_max / (1.0 + cos_max);
        let local = warp::direction(u[0] * below_max, u[1]);
        let axis = to_center / d;
        let [right, up] = tangents(axis);
        let direction = (local.x * right + local.y * up + local.z * axis).normalize();
        // Take the nearer root of t² - 2 t d cos + (d² - r²) = 0 as the known product of both roots over the other
        // root, which is a sum.
        let aside = d * (local.x * local.x + local.y * local.y).sqrt();
        let half_chord = ((self.radius - aside) * (self.radius + aside)).max(0.0).sqrt();
        let distance = (d - self.radius) * (d + self.radius) / (d * local.z + half_chord);
        LightVector {
            to_light: distance * direction,
            pdf: (TAU * below_max).recip(),
            is_front: d > self.radius,
        }
    }

    /// Returns the point that `u` selects uniformly from the sphere.
    pub(super) fn surface_point(&self, u: [f64; 2]) -> SurfacePoint {
        let normal = warp::direction(2.0 * u[0], u[1]);
        SurfacePoint {
            position: self.center + self.radius * normal,
            normal,
            primitive: 0,
        }
    }

    /// Samples a direction uniformly from inside the sphere.
    #[inline(always)]
    fn sample_inside(&self, to_center: DVec3, p: DVec3, u: [f64; 2]) -> Option<LightSample> {
        let direction = warp::direction(2.0 * u[0], u[1]);
        let d = to_center.length();
        let along = direction.dot(to_center);
        let power = (self.radius - d) * (self.radius + d);
        let root = (along * along + power).max(0.0).sqrt();
        // Positive root of t² - 2 t along - power = 0, without cancellation.
        let distance = if along > 0.0 {
            along + root
        } else {
            power / (root - along)
        };
        self.sample_toward(p, direction, distance, (2.0 * TAU).recip())
    }

    /// Returns the sample in a direction, or `None` if density or distance is zero or not finite.
    #[inline(always)]
    fn sample_toward(&self, p: DVec3, direction: DVec3, distance: f64, pdf: f64) -> Option<LightSample> {
        let position = p + distance * direction;
        (is_density(pdf) && distance > 0.0 && distance < f64::INFINITY).then(|| LightSample {
            position,
            direction,
            distance,
            normal: (position - self.center).normalize_or(-direction),
            primitive: 0,
            pdf,
        })
    }

    /// Returns the density per steradian with which directions from `p` to the sphere are chosen, equal for all of
    /// them; 0 where the sphere is too small to have one.
    #[inline(always)]
    pub fn pdf(&self, p: DVec3) -> f64 {
        let d = (self.center - p).length();
        if !(d > self.radius) {
            return (2.0 * TAU).recip();
        }
        let sin_max = self.radius / d;
        let cos_max = ((d - self.radius) * (d + self.radius)).sqrt() / d;
        let pdf = (1.0 + cos_max) / (TAU * sin_max * sin_max);
        if is_density(pdf) { pdf } else { 0.0 }
    }

    /// Returns the area in square metres.
    pub fn area(&self) -> f64 {
        4.0 * PI * self.radius * self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::super::AreaLight;
    use super::super::tests::mean;
    use super::*;

    fn sphere(center: DVec3, radius: f64) -> AreaLight {
        AreaLight::Sphere(SphereLight::new(center, radius).unwrap())
    }

    #[test]
    fn sphere_solid_angle_is_that_of_its_cap() {
        for (distance, radius, exact) in [
            (2.0, 1.0, TAU * (1.0 - 0.75f64.sqrt())),
            (5.0, 3.0, TAU * 0.2),
            // Series π sin² (1 + sin²/4 + ...) for small spheres.
            (1e9, 1.0, PI * 1e-18),
            // Nearly the half-space: 2π (1 - sqrt(2 δ) ...) with d = 1 + δ.
            (1.0 + 1e-12, 1.0, TAU * (1.0 - 2e-12f64.sqrt())),
        ] {
            let light = SphereLight::new(DVec3::new(0.0, distance, 0.0), radius).unwrap();
            let found = light.pdf(DVec3::ZERO).recip();
            // 1 + 1e-12 as a number is off by 1e-4 of its 1e-12, so its root of 1.4e-6 is off by 7e-11.
            assert!(
                (found / exact - 1.0).abs() < 1e-10,
                "{distance}: {found}, not {exact}"
            );
            let sampled = light.sample(DVec3::ZERO, [0.3, 0.6]).unwrap().pdf;
            assert!((sampled * found - 1.0).abs() < 4.0 * f64::EPSILON);
        }
    }

    #[test]
    fn a_sphere_above_the_horizon_lights_a_plane_by_its_square_ratio_times_the_cosine() {
        for (center, radius) in [
            (DVec3::new(0.0, 0.0, 2.0), 1.0),
            (DVec3::new(3.0, -1.0, 2.0), 1.5),
            (DVec3::new(0.0, 1e4, 1e4), 1.0),
            (DVec3::new(0.0, 0.0, 1.0 + 1e-9), 1.0),
        ] {
            let found = mean(&sphere(center, radius), DVec3::ZERO, 512, |s| {
                s.direction.z.max(0.0) / s.pdf
            });
            // E = π L (r / d)² cos.
            let d = center.length();
            let exact = PI * (radius / d).powi(2) * center.z / d;
            assert!(
                (found / exact - 1.0).abs() < 2e-5,
                "{center}: {found}, not {exact}"
            );
        }
    }

    #[test]
    fn samples_lie_on_the_side_of_the_sphere_that_is_seen() {
        for (distance, radius) in [(1.0 + 1e-9, 1.0), (2.0, 1.0), (1e6, 1.0), (3e-8, 1e-8)] {
            let light = sphere(DVec3::new(0.0, 0.0, distance), radius);
            mean(&light, DVec3::ZERO, 32, |s| {
                let off = (s.position - DVec3::new(0.0, 0.0, distance)).length() - radius;
                // A few roundings of the distance; at the rim, where the ray grazes, the root of them, in the normal
                // only.
                assert!(
                    off.abs() <= 8.0 * f64::EPSILON * distance,
                    "{distance} {radius}: {off}"
                );
                assert!(s.direction.dot(s.normal) < 1e-6, "{distance} {radius}");
                0.0
            });
        }
    }

    #[test]
    fn from_inside_directions_are_uniform_and_hit_the_sphere() {
        for p in [
            DVec3::ZERO,
            DVec3::new(0.6, 0.0, 0.5),
            DVec3::new(0.0, 1.0 - 1e-12, 0.0),
        ] {
            let light = sphere(DVec3::ZERO, 1.0);
            let around = mean(&light, p, 64, |s| {
                assert!((s.position.length() - 1.0).abs() < 8.0 * f64::EPSILON);
                assert!(!s.is_front());
                s.pdf.recip()
            });
            assert!((around / (4.0 * PI) - 1.0).abs() < 1e-12);
            // For any normal, the whole hemisphere emits: E = π.
            let irradiance = mean(&light, p, 512, |s| s.direction.x.max(0.0) / s.pdf);
            assert!((irradiance / PI - 1.0).abs() < 1e-4, "{irradiance}");
        }
    }

    #[test]
    fn a_sphere_too_far_away_to_have_a_pdf_gives_no_sample() {
        let light = SphereLight::new(DVec3::new(0.0, 0.0, 1e160), 1.0).unwrap();
        assert_eq!(
            (light.sample(DVec3::ZERO, [0.5; 2]), light.pdf(DVec3::ZERO)),
            (None, 0.0)
        );
    }
}
