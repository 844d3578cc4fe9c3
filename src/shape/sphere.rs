//! Analytic shape: the sphere |p - c|² = r².
//!
//! Roots use the perpendicular-distance discriminant and citardauq's second root (Haines, Günther, Akenine-Möller,
//! "Precision improvements for ray/sphere intersection", Ray Tracing Gems, 2019, ch. 7), with the constant term
//! factored as (|f| - r)(|f| + r), which keeps huge spheres accurate. Rays that approach a sphere from closer than
//! 2^-26 of its radius, as on a planet, are solved in double-double numbers of 106 bits: there f64 has lost the height.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::parametrization::{nearest_to_origin, polar, unit_angle};
use super::span::{Crossings, Span, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay};
use crate::numeric::roots::quadratic_roots;
use crate::numeric::{Bounds, DoubleDouble};

/// Sphere in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre of the sphere in object space.
    pub center: DVec3,
    /// Radius of the sphere; positive and finite.
    pub radius: f64,
}

impl Sphere {
    /// Sphere of radius 1 at the origin.
    pub const UNIT: Sphere = Sphere {
        center: DVec3::ZERO,
        radius: 1.0,
    };

    /// Returns the bounding box in object space.
    pub fn bounds(&self) -> Bounds {
        Bounds {
            min: self.center - DVec3::splat(self.radius),
            max: self.center + DVec3::splat(self.radius),
        }
    }

    /// Returns both parameters at which the line `origin + t direction` intersects the sphere, the smaller first;
    /// `None` for a miss.
    ///
    /// A tangent line has two equal roots. `direction` may have any non-zero length.
    #[inline(always)]
    pub fn roots(&self, origin: DVec3, direction: DVec3) -> Option<[f64; 2]> {
        let roots = self.roots_or_nan(origin, direction);
        (!roots[0].is_nan()).then_some(roots)
    }

    /// Returns both roots as [`Sphere::roots`] does, NaN for a miss.
    #[inline(always)]
    fn roots_or_nan(&self, origin: DVec3, direction: DVec3) -> [f64; 2] {
        let (roots, is_close) = self.roots_f64(origin.to_array(), direction.to_array());
        if is_close {
            self.roots_double_double(origin, direction)
        } else {
            roots
        }
    }

    /// Computes the roots in f64, without branches. Also returns whether the ray is too close to the sphere for f64:
    /// see [`CLOSE`].
    #[inline(always)]
    pub(super) fn roots_f64(&self, origin: [f64; 3], direction: [f64; 3]) -> ([f64; 2], bool) {
        let direction = DVec3::from_array(direction);
        let f = DVec3::from_array(origin) - self.center;
        let a = direction.length_squared();
        let b = -f.dot(direction);
        // Take the part of `f` perpendicular to the ray: its length is the distance of the line from the centre.
        let perpendicular = f + (b / a) * direction;
        let square = self.radius * self.radius;
        let discriminant = square - perpendicular.length_squared();
        let distance = f.length();
        let c = (distance - self.radius) * (distance + self.radius);
        let close = if b > 0.0 { CLOSE } else { TOUCHING };
        let roots = quadratic_roots(a, b, c, a * discriminant);
        (roots, c.abs() <= close * square)
    }

    /// Computes the roots by the textbook formula in double-double numbers of 106 bits, for rays where f64 differences
    /// cancel.
    #[cold]
    #[inline(never)]
    pub(super) fn roots_double_double(&self, origin: DVec3, direction: DVec3) -> [f64; 2] {
        // Form the quadratic in double-double precision
        let f = [0, 1, 2].map(|k| DoubleDouble::of(origin[k]) - DoubleDouble::of(self.center[k]));
        let d = direction.to_array().map(DoubleDouble::of);
        let dot = |a: [DoubleDouble; 3], b: [DoubleDouble; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let radius = DoubleDouble::of(self.radius);
        let (a, b, c) = (dot(d, d), -dot(f, d), dot(f, f) - radius * radius);
        let discriminant = b * b - a * c;
        if discriminant < DoubleDouble::ZERO {
            return [f64::NAN; 2];
        }
        // Compute both roots without cancellation
        let root = discriminant.sqrt();
        let q = if b < DoubleDouble::ZERO {
            b - root
        } else {
            b + root
        };
        if q == DoubleDouble::ZERO {
            return [0.0; 2];
        }
        let [t0, t1] = [(c / q).nearest(), (q / a).nearest()];
        if t0 <= t1 { [t0, t1] } else { [t1, t0] }
    }

    /// Returns the nearest parameter within [`t_near`, `t_far`], both ends included.
    #[inline(always)]
    pub fn nearest(&self, origin: DVec3, direction: DVec3, t_near: f64, t_far: f64) -> Option<f64> {
        let t = first_within(self.roots_or_nan(origin, direction), [t_near, t_far]);
        (!t.is_nan()).then_some(t)
    }

    /// Evaluates [`Sphere::nearest`] for a packet of `W` rays, to identical bits; NaN in lanes that miss. Branch-free
    /// except for close rays, so that lanes vectorise.
    #[inline(always)]
    pub fn nearest_lanes<const W: usize>(
        &self,
        origin: &[[f64; W]; 3],
        direction: &[[f64; W]; 3],
        t_near: &[f64; W],
        t_far: &[f64; W],
    ) -> [f64; W] {
        // Solve all lanes in f64, noting the close ones
        let (mut t, mut close, mut any) = ([f64::NAN; W], [0u64; W], 0);
        for lane in 0..W {
            let of = |v: &[[f64; W]; 3]| [v[0][lane], v[1][lane], v[2][lane]];
            let (roots, is_close) = self.roots_f64(of(origin), of(direction));
            t[lane] = first_within(roots, [t_near[lane], t_far[lane]]);
            close[lane] = u64::from(is_close);
            any |= close[lane];
        }
        // Solve the rare close lanes again in double-double precision
        if any != 0 {
            for lane in (0..W).filter(|&lane| close[lane] != 0) {
                let of = |v: &[[f64; W]; 3]| DVec3::new(v[0][lane], v[1][lane], v[2][lane]);
                let roots = self.roots_double_double(of(origin), of(direction));
                t[lane] = first_within(roots, [t_near[lane], t_far[lane]]);
            }
        }
        t
    }

    /// Evaluates [`Sphere::nearest`] of `N` spheres for one ray, from `t_near` on; NaN for spheres that it misses, and
    /// for a NaN radius.
    #[cfg(feature = "embree")]
    #[inline(always)]
    pub(crate) fn nearest_of<const N: usize>(
        center: &[[f64; N]; 3],
        radius: &[f64; N],
        (origin, direction): (DVec3, DVec3),
        t_near: f64,
    ) -> [f64; N] {
        let sphere = |i: usize| Sphere {
            center: DVec3::new(center[0][i], center[1][i], center[2][i]),
            radius: radius[i],
        };
        // Solve all spheres in f64, noting the close ones
        let (mut t, mut close, mut any) = ([f64::NAN; N], [0u64; N], 0);
        for i in 0..N {
            let (roots, is_close) = sphere(i).roots_f64(origin.to_array(), direction.to_array());
            t[i] = first_within(roots, [t_near, f64::INFINITY]);
            close[i] = u64::from(is_close);
            any |= close[i];
        }
        // Solve the rare close ones again in double-double precision
        if any != 0 {
            for i in (0..N).filter(|&i| close[i] != 0) {
                t[i] = first_within(
                    sphere(i).roots_double_double(origin, direction),
                    [t_near, f64::INFINITY],
                );
            }
        }
        t
    }

    /// Returns both hits of the ray, after removal of its own root if it starts on the sphere.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let [mut t0, mut t1] = self.roots_or_nan(ray.origin, ray.direction);
        if ray.origin_surface.is_some() && t0.is_nan() {
            // A ray along the sphere whose start is rounded off the surface touches it at the nearest point.
            t0 = nearest_to_origin(ray.origin - self.center, ray.direction).0;
            t1 = t0;
        }
        Span::new(t0, t1, 0).crossings_of_convex(ray, true)
    }

    /// Returns the outward unit normal at a point on the surface.
    #[inline(always)]
    pub fn normal(&self, p: DVec3) -> DVec3 {
        (p - self.center).normalize_or_zero()
    }

    /// Returns the point of the surface nearest to `p`, which removes the error along the normal.
    pub fn project(&self, p: DVec3) -> DVec3 {
        self.center + self.radius * self.normal(p)
    }
}

/// Returns the first root within an interval, both ends included; NaN if there is none. Branch-free.
#[inline(always)]
fn first_within([t0, t1]: [f64; 2], [t_near, t_far]: [f64; 2]) -> f64 {
    let second = if (t_near <= t1) & (t1 <= t_far) {
        t1
    } else {
        f64::NAN
    };
    if (t_near <= t0) & (t0 <= t_far) {
        t0
    } else {
        second
    }
}

/// Ratio of the constant term to r² below which f64 no longer gives the root of an approaching ray to one unit of f32.
/// The distance |f| is off by 4 roundings of 2^-53 of itself, and so is the term by 8 of r²: 2^-25 of itself at this
/// ratio.
const CLOSE: f64 = 1.0 / (1u64 << 25) as f64;
/// Ratio of the constant term to r² below which the term may have the wrong sign; used for a receding ray, whose roots
/// are behind it.
const TOUCHING: f64 = 8.0 * f64::EPSILON;

impl Implicit for Sphere {
    #[inline]
    fn bounds(&self) -> Bounds {
        Sphere::bounds(self)
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        nearest(ray, self.intersections(ray))
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        report(ray, self.intersections(ray), out);
    }

    /// Returns the surface point; `u` is the longitude around z from +x towards +y as a fraction of the full circle,
    /// `v` the latitude from the south pole (-z) at 0 to the north pole at 1. At the poles `u` is 0 and `dpdu`
    /// vanishes.
    fn point(&self, p: DVec3, _part: u32) -> ShapePoint {
        let surface = self.surface(p, 0);
        let n = surface.n;
        let (rho, cos, sin) = polar(n);
        let uv = [unit_angle(n.x, n.y), rho.atan2(-n.z) / PI];
        let dpdu = TAU * self.radius * rho * DVec3::new(-sin, cos, 0.0);
        let dpdv = PI * self.radius * DVec3::new(-n.z * cos, -n.z * sin, rho);
        surface.parametrized(uv, [dpdu, dpdv])
    }

    #[inline(always)]
    fn surface(&self, p: DVec3, _part: u32) -> LocatedPoint {
        let n = self.normal(p);
        LocatedPoint::new(self.center + self.radius * n, n, self.radius)
    }

    #[inline]
    fn is_solid(&self) -> bool {
        true
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        p.distance(self.center) <= self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    #[test]
    fn lanes_give_the_bits_of_the_single_ray() {
        let seed = 7;
        let mut random = SplitMix64::new(seed, 0);
        let sphere = Sphere {
            center: DVec3::new(0.3, -0.2, 0.1),
            radius: 0.9,
        };
        for _ in 0..10_000 {
            let mut vectors = |scale: f64| [(); 3].map(|()| [(); 8].map(|()| scale * (random.unit() - 0.5)));
            let (origin, direction) = (vectors(4.0), vectors(2.0));
            let (t_near, t_far) = (
                [(); 8].map(|()| random.unit()),
                [(); 8].map(|()| 5.0 * random.unit()),
            );
            let lanes = sphere.nearest_lanes(&origin, &direction, &t_near, &t_far);
            for lane in 0..8 {
                let of = |v: &[[f64; 8]; 3]| DVec3::new(v[0][lane], v[1][lane], v[2][lane]);
                let one = sphere.nearest(of(&origin), of(&direction), t_near[lane], t_far[lane]);
                assert_eq!(
                    one.map(f64::to_bits),
                    (!lanes[lane].is_nan()).then(|| lanes[lane].to_bits()),
                    "seed {seed}"
                );
            }
        }
    }

    #[test]
    fn the_textbook_ray_hits_the_unit_sphere_at_one_minus_and_plus_root_88_over_44() {
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
                .nearest(DVec3::new(0.5, 0.0, distance), -DVec3::Z, 0.0, f64::INFINITY)
                .unwrap();
            let exact = distance - 0.75f64.sqrt();
            assert!(
                (t - exact).abs() <= 4.0 * f64::EPSILON * distance,
                "distance {distance}"
            );
        }
    }

    #[test]
    fn huge_sphere_below_is_one_unit_away() {
        for k in 3..=8 {
            let radius = 10f64.powi(k);
            let ground = Sphere {
                center: DVec3::new(0.0, -radius, 0.0),
                radius,
            };
            let t = ground.nearest(DVec3::Y, -DVec3::Y, 0.0, f64::INFINITY).unwrap();
            // |f| = R + 1 is exact, so only a few roundings of relative size 2^-53 remain in c / q.
            assert!((t - 1.0).abs() <= 8.0 * f64::EPSILON, "radius {radius}: {t}");
        }
    }

    #[test]
    fn planet_sized_sphere_has_accurate_distance() {
        for k in 3..=8 {
            let radius = 10f64.powi(k);
            let ground = Sphere {
                center: DVec3::new(0.0, -radius, 0.0),
                radius,
            };
            for height in [1e-3f32, 0.3, 0.9] {
                let height = f64::from(height);
                let t = ground.nearest(height * DVec3::Y, -DVec3::Y, 0.0, f64::INFINITY);
                // Straight down; closer than 2^-26 of the radius the result is exact except for the last rounding.
                let bound = if height < radius * 2f64.powi(-26) {
                    0.5 * f64::EPSILON
                } else {
                    2f64.powi(-25)
                };
                let off = (t.unwrap() - height).abs() / height;
                assert!(off <= bound, "radius {radius}, height {height}: {off:e}");
            }
        }
    }

    #[test]
    fn ray_from_inside_hits_far_side_and_behind_misses() {
        let hit = |z: f64| Sphere::UNIT.nearest(DVec3::new(0.0, 0.0, z), DVec3::Z, 0.0, f64::INFINITY);
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
