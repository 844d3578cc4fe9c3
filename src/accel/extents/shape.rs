//! The two bounding volumes: a box and a sphere, in f32, enlarged by the rounding errors of hits.

use glam::DVec3;

use super::ball::BoundingSphere;
use super::guard::{HitError, MIN_SQUARE, UNIT};
use crate::numeric::{Bounds, Ray};

/// Relative error of the squared distance of a line from a point, in units of the squared distance of its origin: 4u by
/// the differences, 3u by either sum of products, squared where it is the dot product's, 3u by the length, 3u more:
/// 16u. Doubled, for the effect of one rounding on another.
const SQUARE_SLACK: f64 = 32.0 * UNIT;
/// Relative error of a parameter computed by a dot product: 8u, doubled for the effect of one rounding on another.
const ALONG_SLACK: f64 = 16.0 * UNIT;
/// Error of f64 computations of points, boxes and balls relative to coordinates: far less than any guard.
const WIDE_SLACK: f64 = 1.0 / (1u64 << 40) as f64;

/// An axis-aligned bounding box in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxVolume {
    pub(super) low: [f32; 3],
    pub(super) high: [f32; 3],
    /// Depth error of hits, as in [`HitError::depth`].
    pub(super) depth: f32,
}

/// A bounding sphere in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereVolume {
    pub(super) center: [f32; 3],
    /// Factor of the squared distance of the origin, a little less than 1.
    pub(super) shrink: f32,
    /// Squared distance from the centre beyond which a line misses.
    pub(super) square: f32,
    /// Largest distance of a hit along the ray from the point nearest to the centre.
    pub(super) reach: f32,
    /// Addition to `reach` relative to the distance of the origin.
    pub(super) slack: f32,
}

impl BoxVolume {
    /// Creates the box around everything within `bounds`.
    pub(super) fn new(bounds: &Bounds, guard: &HitError) -> BoxVolume {
        let pad = DVec3::splat(guard.own + WIDE_SLACK * bounds.magnitude());
        let padded = Bounds {
            min: bounds.min - pad,
            max: bounds.max + pad,
        };
        let (low, high) = padded.to_f32_outward();
        BoxVolume {
            low,
            high,
            depth: (guard.depth as f32).next_up(),
        }
    }

    /// Returns the surface area of the box.
    pub fn area(&self) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|axis| f64::from(self.high[axis]) - f64::from(self.low[axis]));
        2.0 * (x * y + y * z + z * x)
    }
}

impl SphereVolume {
    /// Creates the sphere around everything within `ball`.
    ///
    /// A hit is displaced by `√3 (k |o| + own)` at most, k = [`HitError::origin_factor`], and |o| is at most the origin's
    /// distance D from the centre C and |C|. With `R' = R + √3 (k |C| + own)` and `e = √3 k`, all lines that may hit
    /// are nearer than `R' + e D`, whose square is at most `(1 + e) R'² + (e + e²) D²`.
    pub(super) fn new(ball: &BoundingSphere, guard: &HitError) -> SphereVolume {
        let center = ball.center.as_vec3();
        // Add the rounding of the centre, the displacement of hits, and f64 errors to the radius
        let moved = center.as_dvec3().distance(ball.center);
        let size = ball.center.abs().max_element();
        let root = 3f64.sqrt();
        let e = root * guard.origin_factor;
        let wide = WIDE_SLACK * (size + ball.radius);
        let radius = ball.radius + moved + e * size + root * guard.own + wide;
        let up = |x: f64| (x as f32).next_up();
        SphereVolume {
            center: center.to_array(),
            shrink: ((1.0 - SQUARE_SLACK - e - e * e) as f32).next_down(),
            square: up((1.0 + e + SQUARE_SLACK) * radius * radius) + MIN_SQUARE,
            reach: up((radius + guard.depth) * (1.0 + ALONG_SLACK)),
            slack: up(e + ALONG_SLACK),
        }
    }

    /// Creates the centroid sphere: around the mean of the points, as far as the farthest, for rays that are tested
    /// exactly.
    pub fn of_centroid(points: &[DVec3]) -> SphereVolume {
        SphereVolume::new(&BoundingSphere::of_centroid(points), &HitError::NONE)
    }

    /// Creates the smallest sphere around the points.
    pub fn smallest(points: &[DVec3]) -> SphereVolume {
        SphereVolume::new(&BoundingSphere::smallest(points), &HitError::NONE)
    }

    /// Returns whether a line may hit the sphere: the test for a single ray, in f64, without overflow and without a
    /// division.
    #[inline(always)]
    pub(crate) fn may_hit(&self, ray: &Ray) -> bool {
        let f = ray.origin.as_dvec3() - DVec3::from(self.center.map(f64::from));
        let d = ray.direction.as_dvec3();
        let along = f.dot(d);
        let square = d.length_squared();
        let beside = f64::from(self.shrink) * f.length_squared() * square - along * along;
        !(beside > f64::from(self.square) * square)
    }

    /// Returns the radius, including all enlargements.
    pub fn radius(&self) -> f64 {
        f64::from(self.square).sqrt()
    }

    /// Returns the surface area of the sphere.
    pub fn area(&self) -> f64 {
        4.0 * std::f64::consts::PI * f64::from(self.square)
    }
}

/// Bounding volume that is tested before an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum BoundingVolume {
    /// No volume: the object is always tested.
    None,
    /// A box around the object.
    Box(BoxVolume),
    /// A sphere around the object.
    Sphere(SphereVolume),
}
