//! The sphere |p - c|² = r².
//!
//! Roots by the perpendicular-distance discriminant and citardauq's second root (Haines, Günther, Akenine-Möller,
//! "Precision improvements for ray/sphere intersection", Ray Tracing Gems, 2019, ch. 7), with the constant term
//! factored as (|f| - r)(|f| + r), which is what keeps huge spheres accurate.

use glam::DVec3;

use crate::numeric::Bounds;

/// A sphere in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Its centre.
    pub center: DVec3,
    /// Its radius; positive and finite.
    pub radius: f64,
}

impl Sphere {
    /// The sphere of radius 1 at the origin.
    pub const UNIT: Sphere = Sphere {
        center: DVec3::ZERO,
        radius: 1.0,
    };

    /// Its box in object space.
    pub fn bounds(&self) -> Bounds {
        Bounds {
            min: self.center - DVec3::splat(self.radius),
            max: self.center + DVec3::splat(self.radius),
        }
    }

    /// Both parameters at which the line `origin + t direction` meets the sphere, the smaller first; `None` for a miss.
    ///
    /// A tangent line meets it twice at the same parameter. `direction` may have any non-zero length.
    #[inline(always)]
    pub fn roots(&self, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
        let f = origin - self.center;
        let a = direction.length_squared();
        let b = -f.dot(direction);
        // The part of `f` perpendicular to the ray: its length is the distance of the line from the centre.
        let perpendicular = f + (b / a) * direction;
        let discriminant = self.radius * self.radius - perpendicular.length_squared();
        if !(discriminant >= 0.0) {
            return None;
        }
        let q = b + (a * discriminant).sqrt().copysign(b);
        let distance = f.length();
        let c = (distance - self.radius) * (distance + self.radius);
        if q == 0.0 {
            // The line starts at the point where it touches the sphere.
            return Some([0.0, 0.0]);
        }
        let (t0, t1) = (c / q, q / a);
        Some(if t0 <= t1 { [t0, t1] } else { [t1, t0] })
    }

    /// The nearest parameter within [`t_near`, `t_far`], both ends included.
    #[inline(always)]
    pub fn intersect(&self, origin: DVec3, direction: DVec3, t_near: f64, t_far: f64) -> Option<f64> {
        let within = |t: &f64| t_near <= *t && *t <= t_far;
        self.roots(origin, direction)?.into_iter().find(within)
    }

    /// The outward unit normal at a point on the surface.
    pub fn normal(&self, p: DVec3) -> DVec3 {
        (p - self.center).normalize_or_zero()
    }

    /// The point of the surface nearest to `p`, which removes the error along the normal.
    pub fn project(&self, p: DVec3) -> DVec3 {
        self.center + self.radius * self.normal(p)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lectures_ray_meets_the_unit_sphere_at_one_minus_and_plus_root_88_over_44() {
        let [t0, t1] = Sphere::UNIT
            .roots(DVec3::new(3.0, 2.0, 3.0), DVec3::new(-3.0, -2.0, -3.0))
            .unwrap();
        assert!((t0 - (1.0 - 88f64.sqrt() / 44.0)).abs() < 1e-15);
        assert!((t1 - (1.0 + 88f64.sqrt() / 44.0)).abs() < 1e-15);
    }

    #[test]
    fn a_distant_sphere_is_neither_missed_nor_misplaced() {
        for k in 1..=7 {
            let distance = 10f64.powi(k);
            let t = Sphere::UNIT
                .intersect(DVec3::new(0.5, 0.0, distance), -DVec3::Z, 0.0, f64::INFINITY)
                .unwrap();
            let exact = distance - 0.75f64.sqrt();
            assert!(
                (t - exact).abs() <= 4.0 * f64::EPSILON * distance,
                "distance {distance}"
            );
        }
    }

    #[test]
    fn a_huge_sphere_under_the_feet_is_one_unit_away() {
        for k in 3..=8 {
            let radius = 10f64.powi(k);
            let ground = Sphere {
                center: DVec3::new(0.0, -radius, 0.0),
                radius,
            };
            let t = ground.intersect(DVec3::Y, -DVec3::Y, 0.0, f64::INFINITY).unwrap();
            // |f| = R + 1 is exact, so only a few roundings of relative size 2^-53 remain in c / q.
            assert!((t - 1.0).abs() <= 8.0 * f64::EPSILON, "radius {radius}: {t}");
        }
    }

    #[test]
    fn from_inside_only_the_far_side_is_hit_and_from_behind_nothing() {
        let hit = |z: f64| Sphere::UNIT.intersect(DVec3::new(0.0, 0.0, z), DVec3::Z, 0.0, f64::INFINITY);
        assert_eq!(hit(0.0), Some(1.0));
        assert_eq!(hit(-3.0), Some(2.0));
        assert_eq!(hit(1.5), None);
    }

    #[test]
    fn a_ray_that_touches_hits_and_one_just_outside_misses() {
        let at = |x: f64| Sphere::UNIT.roots(DVec3::new(x, 0.0, -5.0), DVec3::Z);
        // c = |f|² - r² passes through a rounded √26: a relative error of a few 2^-53 in c / q.
        assert!(
            at(1.0)
                .unwrap()
                .iter()
                .all(|t| (t - 5.0).abs() <= 8.0 * f64::EPSILON)
        );
        assert_eq!(at(1.0 + f64::EPSILON), None);
    }
}
