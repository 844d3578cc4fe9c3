//! Hits of sixteen rays on analytic shapes, in object space: the f32 parameter that a backend reports is computed again
//! in f64, and the point is projected onto the surface.
//!
//! All lanes of one shape are computed at once. Each lane has the bits of the functions of [`Implicit`] for one ray.

use glam::DVec3;

use super::span::{Crossings, Span, TwoHits};
use super::{Cube, Disk, Implicit, Plane, Quad, Shape, ShapeHit, ShapeRay, Sphere, SurfacePoint};
use crate::numeric::{HitErrorBound, LANES, Lanes, Lanes3};

/// Hits of sixteen rays, each in the object space of what it hits. Lanes without a hit may hold any values.
pub(crate) struct ObjectHitPacket {
    /// Origins of the rays.
    pub(crate) origin: Lanes3<f64>,
    /// Directions of the rays, not normalised.
    pub(crate) direction: Lanes3<f64>,
    /// Parameters of the hits as the backend reported them.
    pub(crate) reported: Lanes<f64>,
    /// Parts of the shapes that were hit.
    pub(crate) part: Lanes<u32>,
    /// Centres and radii of the spheres, in the lanes that hit one.
    center: Lanes3<f64>,
    radius: Lanes<f64>,
    /// Points of the rays at the recomputed parameters, before their projection onto the surface.
    pub(crate) at: Lanes3<f64>,
    /// Points on the surface.
    pub(crate) p: Lanes3<f64>,
    /// Unit normals, as in [`SurfacePoint::n`].
    pub(crate) n: Lanes3<f64>,
    /// Error bounds of the points, as in [`SurfacePoint::error`].
    pub(crate) error: Lanes3<f64>,
}

impl ObjectHitPacket {
    /// Packet of zeros, without hits.
    pub(crate) const ZERO: ObjectHitPacket = ObjectHitPacket {
        origin: [[0.0; LANES]; 3],
        direction: [[0.0; LANES]; 3],
        reported: [0.0; LANES],
        part: [0; LANES],
        center: [[0.0; LANES]; 3],
        radius: [1.0; LANES],
        at: [[0.0; LANES]; 3],
        p: [[0.0; LANES]; 3],
        n: [[0.0; LANES]; 3],
        error: [[0.0; LANES]; 3],
    };

    /// Sets the sphere that lane `l` hit.
    #[inline(always)]
    pub(crate) fn set_sphere(&mut self, l: usize, sphere: &Sphere) {
        set_vector(&mut self.center, l, sphere.center);
        self.radius[l] = sphere.radius;
    }

    /// Computes the points that the lanes in `mask` hit on `shape`; for a sphere, each on its own
    /// ([`ObjectHitPacket::set_sphere`]).
    #[inline(always)]
    pub(crate) fn locate(&mut self, shape: &Shape, mask: &Lanes<bool>) {
        match shape {
            Shape::Sphere(_) => self.locate_spheres(mask),
            Shape::Plane => self.locate_lanes(&Plane, mask),
            Shape::Cube => self.locate_lanes(&Cube, mask),
            Shape::Disk => self.locate_lanes(&Disk, mask),
            Shape::Quad => self.locate_lanes(&Quad, mask),
            _ => self.locate_each(shape, mask),
        }
    }

    /// Computes points on a shape that is evaluated without branches, so that the loop vectorises.
    #[inline(always)]
    fn locate_lanes<S: TwoHits>(&mut self, shape: &S, mask: &Lanes<bool>) {
        for l in 0..LANES {
            let ray = self.ray(l);
            self.place(l, mask[l], &shape.intersections(&ray), shape);
        }
    }

    /// Computes points on spheres, of which each lane has its own.
    #[inline(always)]
    fn locate_spheres(&mut self, mask: &Lanes<bool>) {
        // Solve all lanes in f64, noting the close ones
        let (mut roots, mut close, mut any) = ([[0.0; LANES]; 2], [0u64; LANES], 0);
        for l in 0..LANES {
            let ray = self.ray(l);
            let origin = ray.origin.to_array();
            let ([t0, t1], is_close) = self.sphere(l).roots_f64(origin, ray.direction.to_array());
            (roots[0][l], roots[1][l]) = (t0, t1);
            close[l] = u64::from(is_close & mask[l]);
            any |= close[l];
        }
        // Solve the rare close lanes again in double-double precision
        if any != 0 {
            for l in (0..LANES).filter(|&l| close[l] != 0) {
                let ray = self.ray(l);
                let [t0, t1] = self.sphere(l).roots_double_double(ray.origin, ray.direction);
                (roots[0][l], roots[1][l]) = (t0, t1);
            }
        }
        // Place the points
        for l in 0..LANES {
            let span = Span::new(roots[0][l], roots[1][l], 0);
            let crossings = span.crossings_of_convex(&self.ray(l), true);
            let sphere = self.sphere(l);
            self.place(l, mask[l], &crossings, &sphere);
        }
    }

    /// Computes points lane by lane.
    #[inline(never)]
    fn locate_each(&mut self, shape: &Shape, mask: &Lanes<bool>) {
        for l in (0..LANES).filter(|&l| mask[l]) {
            let ray = self.ray(l);
            let at = ray.at(refined_parameter(shape, &ray, self.part[l], self.reported[l]));
            self.store(l, at, shape.surface(at, self.part[l]));
        }
    }

    /// Places the point of lane `l`, which has these crossings with `shape`, if the lane `is_hit`. There are no branches,
    /// so that loops over lanes vectorise.
    #[inline(always)]
    fn place(&mut self, l: usize, is_hit: bool, crossings: &Crossings, shape: &impl Implicit) {
        let (ray, part, reported) = (self.ray(l), self.part[l], self.reported[l]);
        let mut nearest = f64::NAN;
        for hit in crossings {
            let nearer = nearer(nearest, *hit, part, reported);
            nearest = if ray.in_range(hit.t) { nearer } else { nearest };
        }
        let at = ray.at(if nearest.is_nan() { reported } else { nearest });
        let point = shape.surface(at, part);
        let old = |v: &Lanes3<f64>| vector(v, l);
        let (at, p, n, error) = if is_hit {
            (at, point.p, point.n, point.error.0)
        } else {
            (old(&self.at), old(&self.p), old(&self.n), old(&self.error))
        };
        self.store(
            l,
            at,
            SurfacePoint {
                p,
                n,
                error: HitErrorBound(error),
            },
        );
    }

    #[inline(always)]
    fn store(&mut self, l: usize, at: DVec3, point: SurfacePoint) {
        set_vector(&mut self.at, l, at);
        set_vector(&mut self.p, l, point.p);
        set_vector(&mut self.n, l, point.n);
        set_vector(&mut self.error, l, point.error.0);
    }

    #[inline(always)]
    fn ray(&self, l: usize) -> ShapeRay {
        ShapeRay::new(vector(&self.origin, l), vector(&self.direction, l))
    }

    #[inline(always)]
    fn sphere(&self, l: usize) -> Sphere {
        Sphere {
            center: vector(&self.center, l),
            radius: self.radius[l],
        }
    }
}

/// Returns the parameter of the ray's hit on `part` of `shape` that is nearest to the one that a backend reported.
pub(crate) fn refined_parameter(shape: &Shape, ray: &ShapeRay, part: u32, reported: f64) -> f64 {
    let mut nearest = f64::NAN;
    shape.crossings(ray, &mut |hit| nearest = nearer(nearest, hit, part, reported));
    // Rounding may lose a grazing intersection; then use the reported parameter.
    if nearest.is_nan() { reported } else { nearest }
}

/// Returns the parameter of `hit` if it is on `part` and nearer to `reported` than `nearest`, which may be NaN; else
/// `nearest`.
#[inline(always)]
fn nearer(nearest: f64, hit: ShapeHit, part: u32, reported: f64) -> f64 {
    let is_nearer = !((hit.t - reported).abs() >= (nearest - reported).abs());
    if (hit.part == part) & is_nearer {
        hit.t
    } else {
        nearest
    }
}

/// Returns lane `l` of a vector in structure-of-arrays form.
#[inline(always)]
pub(crate) fn vector(v: &Lanes3<f64>, l: usize) -> DVec3 {
    DVec3::new(v[0][l], v[1][l], v[2][l])
}

/// Sets lane `l` of a vector in structure-of-arrays form.
#[inline(always)]
pub(crate) fn set_vector(v: &mut Lanes3<f64>, l: usize, value: DVec3) {
    for axis in 0..3 {
        v[axis][l] = value[axis];
    }
}
