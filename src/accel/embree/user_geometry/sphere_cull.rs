//! Conservative sphere culling in f32: finds the rays of a packet that surely miss a sphere, all of them at once.
//!
//! Of the sphere around `c` with radius `r` and the ray `o + t d`, let `f = o - c`, `s = -f·d / d·d` the parameter
//! nearest to the centre, and `p = f + s d` the vector from the centre to the nearest point. The ray misses where
//! `|p| > r`, where `s + r / |d| < 0`, as it starts at 0 or after, and where `s - r / |d|` is beyond its end.
//!
//! With the unit roundoff `u = 2^-24`, rounding the centre and `f` moves the sphere by at most `u (|c| + |f|)`; then
//! `s |d|` is off by `8 u |f|`, by the usual bounds for products and sums (N. Higham, "Accuracy and Stability of
//! Numerical Algorithms", 2002, ch. 3), and `p` by `11 u |f|`. The three comparisons are thus right for a radius that
//! is larger by `u (|c| + 16 |f|)` and by `8 u r` for their own rounding; rounding a root to f32 before it is compared
//! with the end takes another `u |f|`. The radius used here is larger by `32 u (|c| + r + |f|)`. Roots in f64 are
//! `2^-24` times as exact where they are needed, and where the sphere is behind the start or beyond the end neither
//! root suffers cancellation.

use crate::mesh::simd::SimdLevel;
use crate::numeric::Ray;
use crate::shape::Sphere;

/// Enlargement of radii relative to the distances involved: 32 units of roundoff.
const RADIUS_ERROR: f32 = 32.0 / (1 << 24) as f32;
/// Enlargement of every radius against underflow in f32, 2^-60: squares are at most 2^-126 off.
const MIN_RADIUS_ERROR: f64 = 1.0 / (1u64 << 60) as f64;
/// Least squared length of a direction, 2^-100; shorter rays are never culled.
const MIN_SQUARE: f32 = 1.0 / (1u128 << 100) as f32;

/// A sphere in f32 with an enlarged radius, for culling.
pub(super) struct Sphere32 {
    center: [f32; 3],
    /// Radius, enlarged by the error terms of radius and centre.
    enlarged_radius: f32,
}

impl Sphere32 {
    #[inline(always)]
    pub(super) fn of(sphere: &Sphere) -> Sphere32 {
        let center = sphere.center.to_array();
        let [x, y, z] = center.map(f64::abs);
        // Distances beyond the range of rays might overflow in products.
        let is_near = x.max(y).max(z) < f64::from(Ray::LIMIT);
        let enlarged_radius =
            sphere.radius + f64::from(RADIUS_ERROR) * (x + y + z + sphere.radius) + MIN_RADIUS_ERROR;
        Sphere32 {
            center: center.map(|x| x as f32),
            enlarged_radius: if is_near {
                enlarged_radius as f32
            } else {
                f32::INFINITY
            },
        }
    }
}

/// Packet of traceable rays, prepared for culling.
pub(super) struct PacketCull<const W: usize> {
    origin: [[f32; W]; 3],
    direction: [[f32; W]; 3],
    t_far: [f32; W],
    /// Inverse squared length of the direction, or NaN for directions too short to cull.
    per_square: [f32; W],
    /// Inverse length of the direction.
    per_length: [f32; W],
}

impl<const W: usize> PacketCull<W> {
    /// Prepares rays that end at `t_far`.
    #[inline(always)]
    pub(super) fn of(origin: [[f32; W]; 3], direction: [[f32; W]; 3], t_far: [f32; W]) -> PacketCull<W> {
        let (mut per_square, mut per_length) = ([0.0; W], [0.0; W]);
        for lane in 0..W {
            let [x, y, z] = [0, 1, 2].map(|axis| direction[axis][lane]);
            let square = x * x + y * y + z * z;
            per_square[lane] = if square >= MIN_SQUARE {
                1.0 / square
            } else {
                f32::NAN
            };
            per_length[lane] = per_square[lane].sqrt();
        }
        PacketCull {
            origin,
            direction,
            t_far,
            per_square,
            per_length,
        }
    }

    /// Sets the ends of the rays.
    #[inline(always)]
    pub(super) fn end_at(&mut self, t_far: [f32; W]) {
        self.t_far = t_far;
    }

    /// Returns a mask of sure misses: bit `i` is set if ray `i` surely misses.
    #[inline(always)]
    pub(super) fn miss_mask<I: SimdLevel>(&self, isa: I, ball: &Sphere32) -> u32 {
        let (mut square, mut most) = ([0.0; W], [0.0; W]);
        let (mut first, mut last) = ([0.0; W], [0.0; W]);
        for lane in 0..W {
            let [x, y, z] = [0, 1, 2].map(|axis| self.origin[axis][lane] - ball.center[axis]);
            let [u, v, w] = [0, 1, 2].map(|axis| self.direction[axis][lane]);
            let s = -(x * u + y * v + z * w) * self.per_square[lane];
            let [p, q, r] = [x + s * u, y + s * v, z + s * w];
            let enlarged_radius = ball.enlarged_radius + RADIUS_ERROR * (x.abs() + y.abs() + z.abs());
            let half = enlarged_radius * self.per_length[lane];
            square[lane] = p * p + q * q + r * r;
            most[lane] = enlarged_radius * enlarged_radius;
            first[lane] = s - half;
            last[lane] = s + half;
        }
        // Comparisons with NaN are false, so an overflow never counts as a sure miss.
        isa.lt(&most, &square) | isa.lt(&last, &[0.0; W]) | isa.lt(&self.t_far, &first)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::accel::shape_query::sphere_hit;
    use crate::mesh::simd::{SimdKernel, dispatch};

    /// SplitMix64 generator (Steele, Lea and Flood, 2014).
    struct Random(u64);

    impl Random {
        fn bits(&mut self) -> u64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        }

        /// Returns a uniform number in [-1, 1).
        fn number(&mut self) -> f64 {
            (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self) -> DVec3 {
            DVec3::new(self.number(), self.number(), self.number())
        }
    }

    /// Cull test of one ray, repeated in every lane.
    struct CullKernel<'a>(&'a Ray, &'a Sphere);

    impl SimdKernel for CullKernel<'_> {
        type Output = u32;

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> u32 {
            let lanes = |v: Vec3| v.to_array().map(|x| [x; 8]);
            let cull = PacketCull::of(lanes(self.0.origin), lanes(self.0.direction), [self.0.t_far; 8]);
            cull.miss_mask(isa, &Sphere32::of(self.1))
        }
    }

    fn is_sure_miss(ray: &Ray, sphere: &Sphere) -> bool {
        match dispatch(CullKernel(ray, sphere)) {
            0 => false,
            0xff => true,
            mask => panic!("equal lanes have different results: {mask:#b}"),
        }
    }

    #[test]
    fn cull_never_rejects_a_hitting_ray() {
        let seed = 11;
        let mut random = Random(seed);
        let mut hits = 0;
        for i in 0..200_000 {
            let scale = 10f64.powi((random.bits() % 25) as i32 - 12);
            let origin = (scale * random.vector()).as_vec3();
            let direction = (10f64.powi((random.bits() % 13) as i32 - 6) * random.vector()).as_vec3();
            // Centres near and far, ahead and behind; radii that the ray just hits or misses, by a relative amount from
            // 0 to 0.5.
            let center =
                origin.as_dvec3() + scale * 10f64.powi(-((random.bits() % 6) as i32)) * random.vector();
            let (f, d) = (origin.as_dvec3() - center, direction.as_dvec3().normalize());
            let distance = (f - f.dot(d) * d).length();
            let near = [0.0, 1e-15, 1e-9, 1e-7, 1e-5, 0.5][i % 6];
            let radius = distance * (1.0 + near * random.number());
            let sphere = Sphere { center, radius };
            let mut ray = Ray::new(origin, direction);
            let Some(t) = sphere_hit(&sphere, &ray) else {
                continue;
            };
            // Shorten the ray down to its hit: it must never be culled
            hits += 1;
            for t_far in [f32::INFINITY, t.next_up(), t] {
                ray.t_far = t_far;
                assert!(sphere_hit(&sphere, &ray).is_some());
                assert!(!is_sure_miss(&ray, &sphere), "seed {seed}: {ray:?} {sphere:?}");
            }
        }
        assert!(hits > 50_000, "{hits}");
    }

    #[test]
    fn cull_rejects_rays_beside_behind_or_ending_before_the_sphere() {
        let sphere = Sphere {
            center: DVec3::new(3.0, 4.0, 12.0),
            radius: 1.0,
        };
        // The distance of the centre is 13; all radii are larger by less than 32 · 2^-24 · (19 + 1 + 19) = 7.5e-5.
        let toward = |center: DVec3| Ray::new(Vec3::ZERO, center.as_vec3());
        let past = |x: f32| Ray::new(Vec3::new(3.0 + x, 4.0, 0.0), Vec3::Z);
        assert!(is_sure_miss(&past(1.0001), &sphere) && !is_sure_miss(&past(0.9999), &sphere));
        assert!(
            is_sure_miss(&toward(-sphere.center), &sphere) && !is_sure_miss(&toward(sphere.center), &sphere)
        );
        let until = |t_far: f32| Ray { t_far, ..past(0.0) };
        // From (3, 4, 0) along z it is hit at 11.
        assert!(is_sure_miss(&until(10.9999), &sphere) && !is_sure_miss(&until(11.0), &sphere));
        let from = |z: f32| Ray::new(Vec3::new(3.0, 4.0, z), Vec3::Z);
        assert!(is_sure_miss(&from(13.0001), &sphere) && !is_sure_miss(&from(13.0), &sphere));
    }

    #[test]
    fn cull_keeps_rays_outside_the_range_of_f32() {
        let hits = |center: DVec3, radius: f64, direction: Vec3| {
            let (ray, sphere) = (Ray::new(Vec3::ZERO, direction), Sphere { center, radius });
            assert!(sphere_hit(&sphere, &ray).is_some(), "{ray:?} {sphere:?}");
            assert!(!is_sure_miss(&ray, &sphere), "{ray:?} {sphere:?}");
        };
        hits(1e-30 * DVec3::X, 1e-32, Vec3::X);
        hits(1e-42 * DVec3::ONE, 1e-44, Vec3::ONE);
        hits(1e10 * DVec3::ONE, 1.0, 1e-25 * Vec3::ONE);
        hits(DVec3::ONE, 0.5, 1e-38 * Vec3::ONE);
        hits(1e18 * DVec3::X, 1e10, 1e18 * Vec3::X);
        hits(1e22 * DVec3::ONE, 1e17, 1e17 * Vec3::ONE);
        hits(1e20 * DVec3::X, 1e30, Vec3::X);
    }
}
