//! Hits of sixteen rays on analytic shapes, in object space: the f32 parameter that a backend reports is computed again
//! in f64, and the point is projected onto the surface.
//!
//! All lanes of one shape are computed at once. Each lane has the bits of the functions of [`Implicit`] for one ray.

use glam::DVec3;

use super::span::{Crossings, Span, TwoHits};
use super::{Cube, Disk, Implicit, LocatedPoint, Plane, Polyhedron, Quad, Shape, ShapeHit, ShapeRay, Sphere};
use crate::numeric::{LANES, Lanes, Lanes3};

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
    /// Centres of the spheres, in the lanes that hit one.
    center: Lanes3<f64>,
    /// Radii of these spheres.
    radius: Lanes<f64>,
    /// Points of the rays at the recomputed parameters, before their projection onto the surface.
    pub(crate) at: Lanes3<f64>,
    /// Points on the surface.
    pub(crate) p: Lanes3<f64>,
    /// Unit normals, as in [`LocatedPoint::n`].
    pub(crate) n: Lanes3<f64>,
    /// Error bounds of the points, as in [`LocatedPoint::error`].
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
            Shape::Cylinder(cylinder) => self.locate_round(cylinder, mask),
            Shape::Cone(cone) => self.locate_round(cone, mask),
            Shape::Polyhedron(solid) => self.locate_faces(solid, mask),
            Shape::Torus(_) | Shape::Quadric(_) => self.locate_each(shape, mask),
        }
    }

    /// Computes points on a shape that is evaluated without branches, so that the loop vectorises.
    #[inline(always)]
    fn locate_lanes<S: TwoHits>(&mut self, shape: &S, mask: &Lanes<bool>) {
        for l in 0..LANES {
            let ray = self.ray(l);
            self.place(l, mask, &shape.intersections(&ray), shape);
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
            self.place(l, mask, &crossings, &sphere);
        }
    }

    /// Computes points on a shape around an axis, whose distances from it are computed lane by lane.
    #[inline(always)]
    fn locate_round<S: TwoHits>(&mut self, shape: &S, mask: &Lanes<bool>) {
        let mut at = [[0.0; LANES]; 3];
        for l in 0..LANES {
            set_vector(&mut at, l, self.nearest(l, &shape.intersections(&self.ray(l))));
        }
        self.project_each(shape, &at, mask);
    }

    /// Computes points on a polyhedron, clipping all rays with one half-space after the other.
    #[inline(always)]
    fn locate_faces(&mut self, solid: &Polyhedron, mask: &Lanes<bool>) {
        let mut spans = SpanLanes::ALL;
        for (part, half_space) in (0u32..).zip(solid.half_spaces()) {
            for l in 0..LANES {
                // No ray is known to start on the solid
                spans.set(l, half_space.clip(&spans.get(l), part, &self.ray(l), u32::MAX));
            }
        }
        let mut at = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let crossings = spans.get(l).crossings_of_convex(&self.ray(l), false);
            set_vector(&mut at, l, self.nearest(l, &crossings));
        }
        self.project_each(solid, &at, mask);
    }

    /// Computes points lane by lane.
    #[inline(never)]
    fn locate_each(&mut self, shape: &Shape, mask: &Lanes<bool>) {
        let mut at = [[0.0; LANES]; 3];
        for l in (0..LANES).filter(|&l| mask[l]) {
            let ray = self.ray(l);
            let t = refined_parameter(shape, &ray, self.part[l], self.reported[l]);
            set_vector(&mut at, l, ray.at(t));
        }
        self.project_each(shape, &at, mask);
    }

    /// Projects the points `at` onto the surface, lane by lane.
    #[inline(always)]
    fn project_each(&mut self, shape: &impl Implicit, at: &Lanes3<f64>, mask: &Lanes<bool>) {
        for l in (0..LANES).filter(|&l| mask[l]) {
            let at = vector(at, l);
            set_vector(&mut self.at, l, at);
            self.store(l, mask, &shape.surface(at, self.part[l]));
        }
    }

    /// Places the point of lane `l`, which has these crossings with `shape`, if the lane is in `mask`. There are no
    /// branches, so that loops over lanes vectorise.
    #[inline(always)]
    fn place(&mut self, l: usize, mask: &Lanes<bool>, crossings: &Crossings, shape: &impl Implicit) {
        let at = self.nearest(l, crossings);
        set_masked(&mut self.at, l, mask, at);
        self.store(l, mask, &shape.surface(at, self.part[l]));
    }

    /// Returns the point of the ray of lane `l` at the one of its `crossings` that [`refined_parameter`] chooses.
    #[inline(always)]
    fn nearest(&self, l: usize, crossings: &Crossings) -> DVec3 {
        let (ray, part, reported) = (self.ray(l), self.part[l], self.reported[l]);
        let mut nearest = f64::NAN;
        for hit in crossings {
            let nearer = nearer(nearest, *hit, part, reported);
            nearest = if ray.in_range(hit.t) { nearer } else { nearest };
        }
        ray.at(if nearest.is_nan() { reported } else { nearest })
    }

    /// Stores the point of lane `l` if the lane is in `mask`.
    #[inline(always)]
    pub(crate) fn store(&mut self, l: usize, mask: &Lanes<bool>, point: &LocatedPoint) {
        set_masked(&mut self.p, l, mask, point.p);
        set_masked(&mut self.n, l, mask, point.n);
        set_masked(&mut self.error, l, mask, point.error.0);
    }

    /// Returns the ray of lane `l`.
    #[inline(always)]
    fn ray(&self, l: usize) -> ShapeRay {
        ShapeRay::new(vector(&self.origin, l), vector(&self.direction, l))
    }

    /// Returns the sphere that lane `l` hit.
    #[inline(always)]
    fn sphere(&self, l: usize) -> Sphere {
        Sphere {
            center: vector(&self.center, l),
            radius: self.radius[l],
        }
    }
}

/// Intervals of sixteen rays, as structure of arrays.
struct SpanLanes {
    /// Parameters of the entries and the exits.
    t: [Lanes<f64>; 2],
    /// Parts of the surface at the entries and the exits.
    part: [Lanes<u32>; 2],
}

impl SpanLanes {
    /// Intervals of whole lines.
    const ALL: SpanLanes = SpanLanes {
        t: [[Span::ALL.enter.t; LANES], [Span::ALL.exit.t; LANES]],
        part: [[Span::ALL.enter.part; LANES], [Span::ALL.exit.part; LANES]],
    };

    #[inline(always)]
    fn get(&self, l: usize) -> Span {
        let hit = |end: usize| ShapeHit {
            t: self.t[end][l],
            part: self.part[end][l],
        };
        Span {
            enter: hit(0),
            exit: hit(1),
        }
    }

    #[inline(always)]
    fn set(&mut self, l: usize, span: Span) {
        for (end, hit) in [span.enter, span.exit].into_iter().enumerate() {
            self.t[end][l] = hit.t;
            self.part[end][l] = hit.part;
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

/// Sets lane `l` of a vector if the lane is in `mask`, without a branch.
#[inline(always)]
pub(crate) fn set_masked(v: &mut Lanes3<f64>, l: usize, mask: &Lanes<bool>, value: DVec3) {
    for axis in 0..3 {
        v[axis][l] = if mask[l] { value[axis] } else { v[axis][l] };
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::numeric::SplitMix64;
    use crate::shape::{Cone, Cylinder, HalfSpace, Quadric, Torus};

    fn shapes() -> Vec<Shape> {
        let half_spaces: Vec<HalfSpace> = [DVec3::ONE, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z]
            .map(|n| HalfSpace { n, h: 0.7 })
            .into();
        let clip = Sphere::UNIT.bounds();
        let paraboloid = Quadric::new([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -0.5, 0.0], clip);
        vec![
            Shape::Sphere(Sphere::UNIT),
            Shape::Plane,
            Shape::Cube,
            Shape::Disk,
            Shape::Quad,
            Shape::Cylinder(Cylinder { capped: true }),
            Shape::Cylinder(Cylinder { capped: false }),
            Shape::Cone(Cone { capped: true }),
            Shape::Cone(Cone { capped: false }),
            Shape::Polyhedron(Arc::new(Polyhedron::from_half_spaces(&half_spaces).unwrap())),
            Shape::Torus(Torus { minor_radius: 0.3 }),
            Shape::Quadric(Arc::new(paraboloid.unwrap())),
        ]
    }

    /// Returns a coordinate that is often exactly on a face, an edge or an axis of the shapes.
    fn coordinate(random: &mut SplitMix64) -> f64 {
        let special = [-1.0, -0.5, -0.0, 0.0, 0.5, 1.0, 1.0 + f64::EPSILON, 1e-200, 1e9];
        match (random.unit() * 24.0) as usize {
            k if k < special.len() => special[k],
            _ => 3.0 * (random.unit() - 0.5),
        }
    }

    fn bits(v: DVec3) -> [u64; 3] {
        v.to_array()
            .map(|x| if x.is_nan() { f64::NAN } else { x }.to_bits())
    }

    #[test]
    fn lanes_have_the_bits_of_single_rays_on_every_shape() {
        let seed = 5;
        let mut random = SplitMix64::new(seed, 0);
        for shape in shapes() {
            for _ in 0..2000 {
                let mut hits = ObjectHitPacket::ZERO;
                let mut mask = [false; LANES];
                // Hits are reported on a crossing, between two, or on none; lanes without a hit hold NaN
                for l in 0..LANES {
                    mask[l] = random.unit() < 0.7;
                    let mut vector = || DVec3::from_array([(); 3].map(|()| coordinate(&mut random)));
                    let (origin, direction) = (vector(), vector());
                    if mask[l] && direction != DVec3::ZERO {
                        set_vector(&mut hits.origin, l, origin);
                        set_vector(&mut hits.direction, l, direction);
                        let mut crossings = Vec::new();
                        shape.crossings(&ShapeRay::new(origin, direction), &mut |hit| crossings.push(hit));
                        let count = crossings.len().max(1);
                        let hit = crossings.get((random.unit() * count as f64) as usize);
                        hits.part[l] = hit.map_or(0, |hit| hit.part);
                        hits.reported[l] = f64::from(hit.map_or(0.5, |hit| hit.t) as f32);
                    } else {
                        mask[l] = false;
                        set_vector(&mut hits.origin, l, DVec3::NAN);
                        set_vector(&mut hits.direction, l, DVec3::NAN);
                        hits.reported[l] = f64::NAN;
                    }
                    // The second half of the lanes hits spheres that are moved and scaled
                    hits.set_sphere(l, &sphere(l));
                }
                hits.locate(&shape, &mask);
                for l in 0..LANES {
                    let got = [&hits.at, &hits.p, &hits.n, &hits.error].map(|v| vector(v, l));
                    if !mask[l] {
                        assert_eq!(got, [DVec3::ZERO; 4], "lane without a hit, {shape:?}");
                        continue;
                    }
                    let shape = match &shape {
                        Shape::Sphere(_) => Shape::Sphere(sphere(l)),
                        shape => shape.clone(),
                    };
                    let ray = hits.ray(l);
                    let at = ray.at(refined_parameter(&shape, &ray, hits.part[l], hits.reported[l]));
                    let point = shape.point(at, hits.part[l]);
                    assert_eq!(
                        got.map(bits),
                        [at, point.p, point.n, point.error.0].map(bits),
                        "seed {seed}, {shape:?}, {ray:?}"
                    );
                }
            }
        }
    }

    fn sphere(l: usize) -> Sphere {
        let scale = if l < LANES / 2 { 0.0 } else { l as f64 };
        Sphere {
            center: scale * DVec3::new(0.1, -0.02, 0.07),
            radius: 1.0 + 0.1 * scale,
        }
    }
}
