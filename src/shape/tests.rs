//! Tests of every shape against the oracle: random and degenerate rays, and rays that start on the surface.

use std::sync::Arc;

use glam::DVec3;

use super::oracle::{
    Intervals, at, cut, dodecahedron, dot, inside_quadric, inside_torus, is_within, whole_line,
};
use super::{
    Cone, Cylinder, HalfSpace, Implicit, OriginSurface, Polyhedron, Quadric, Shape, ShapeRay, Side, Sphere,
    Torus,
};
use crate::numeric::{Bounds, DoubleDouble, SplitMix64, spawn_point};

/// Number of roundings, of 2^-53 of the coordinates involved, by which a surface may seem to be moved: two for the
/// shifted origin, four for the quadratic's coefficients, which curvature doubles, and two for `t`.
const ROUNDINGS: f64 = 16.0;
/// Number of roundings by which a torus may seem to be moved: the quartic adds none, as roots are polished on the
/// distance form, unless a ray is nearly tangent; there its coefficients of up to 16 and its division by the tube's
/// radius count.
const TORUS_ROUNDINGS: f64 = 64.0;
/// Seed of all random numbers in these tests.
const SEED: u64 = 20_260_101;

/// Quadric moved outward by `delta`: coefficients and the point that they are relative to.
type Moved = fn(delta: f64) -> ([f64; 10], DVec3);

/// Description of a shape for the oracle: xᵀ Q x <= 0 moved outward by `delta`, and half-spaces. The half-spaces bound
/// a solid, or they clip an open surface.
struct ShapeOracle {
    shape: Shape,
    quadric: Option<Moved>,
    half_spaces: Vec<HalfSpace>,
    /// Lower bound on the radius of curvature: a chord from the surface at an angle to it is longer than half of this
    /// times the sine. For a cone it is the distance from the axis.
    curvature: f64,
}

fn diagonal(x: f64, y: f64, z: f64, lz: f64, constant: f64) -> [f64; 10] {
    [x, 0.0, 0.0, 0.0, y, 0.0, 0.0, z, lz, constant]
}

fn square(x: f64) -> f64 {
    x * x
}

const SPHERE: Sphere = Sphere {
    center: DVec3::new(0.25, -0.5, 0.125),
    radius: 0.75,
};

fn moved_sphere(delta: f64) -> ([f64; 10], DVec3) {
    let constant = -square(SPHERE.radius + delta);
    (diagonal(1.0, 1.0, 1.0, 0.0, constant), SPHERE.center)
}

fn cylinder(delta: f64) -> ([f64; 10], DVec3) {
    (diagonal(1.0, 1.0, 0.0, 0.0, -square(1.0 + delta)), DVec3::ZERO)
}

/// Returns x² + y² - z² / 4 about the apex, which moves by √5 delta if the wall moves by delta.
fn cone(delta: f64) -> ([f64; 10], DVec3) {
    let apex = 1.0 + 5f64.sqrt() * delta;
    (diagonal(1.0, 1.0, -0.25, 0.0, 0.0), apex * DVec3::Z)
}

fn ellipsoid(delta: f64) -> ([f64; 10], DVec3) {
    (diagonal(1.0, 2.0, 3.0, 0.25, -0.75 - delta), DVec3::ZERO)
}

fn one_sheet(delta: f64) -> ([f64; 10], DVec3) {
    (diagonal(1.0, 1.0, -1.0, 0.0, -0.25 - delta), DVec3::ZERO)
}

fn two_sheets(delta: f64) -> ([f64; 10], DVec3) {
    (diagonal(-1.0, -1.0, 1.0, 0.0, -0.25 - delta), DVec3::ZERO)
}

fn saddle(delta: f64) -> ([f64; 10], DVec3) {
    let mut q = diagonal(0.0, 0.0, 0.0, -0.5, -delta);
    q[1] = 0.5;
    (q, DVec3::ZERO)
}

fn box_half_spaces(axes: std::ops::Range<usize>) -> Vec<HalfSpace> {
    axes.flat_map(|axis| {
        [-1.0, 1.0].map(|sign| HalfSpace {
            n: sign * DVec3::AXES[axis],
            h: 1.0,
        })
    })
    .collect()
}

/// Returns the oracle descriptions of all shapes except for the torus and flat open ones.
fn shape_oracles() -> Vec<ShapeOracle> {
    let clip = Bounds {
        min: -DVec3::ONE,
        max: DVec3::ONE,
    };
    let mut all = Vec::new();
    let mut add = |shape, quadric, half_spaces, curvature| {
        all.push(ShapeOracle {
            shape,
            quadric,
            half_spaces,
            curvature,
        });
    };
    // Add sphere, cube and dodecahedron
    add(Shape::Sphere(SPHERE), Some(moved_sphere as Moved), vec![], 0.75);
    add(Shape::Cube, None, box_half_spaces(0..3), f64::INFINITY);
    let polyhedron = Arc::new(Polyhedron::from_half_spaces(&dodecahedron()).unwrap());
    let planes = polyhedron.half_spaces().to_vec();
    add(Shape::Polyhedron(polyhedron), None, planes, f64::INFINITY);
    let above_base = vec![HalfSpace { n: -DVec3::Z, h: 1.0 }];
    // Add capped and open cylinders and cones
    for capped in [true, false] {
        add(
            Shape::Cylinder(Cylinder { capped }),
            Some(cylinder),
            box_half_spaces(2..3),
            1.0,
        );
        add(Shape::Cone(Cone { capped }), Some(cone), above_base.clone(), 0.0);
    }
    // Add quadrics
    let quadrics: [(Moved, f64); 4] = [
        (ellipsoid, 0.1),
        (one_sheet, 0.1),
        (two_sheets, 0.1),
        (saddle, 0.1),
    ];
    for (q, curvature) in quadrics {
        let quadric = Quadric::new(q(0.0).0, clip).unwrap();
        add(
            Shape::Quadric(Arc::new(quadric)),
            Some(q),
            box_half_spaces(0..3),
            curvature,
        );
    }
    all
}

/// Returns a ray at a random distance, aimed near the shape, of any length; every fourth is made degenerate by
/// snapping.
fn random_ray(random: &mut SplitMix64) -> ShapeRay {
    let mut target = 1.3 * random.in_cube();
    let distance = random.choose(&[0.0, 0.5, 3.0, 100.0, 1e6]);
    let mut direction = random.direction();
    if random.bits() & 3 == 0 {
        let snap = |random: &mut SplitMix64, x: f64| match random.bits() % 8 {
            0..6 => random.choose(&[0.0, -0.0, 1.0, -1.0, 0.5, -0.5]),
            _ => x,
        };
        target = DVec3::new(
            snap(random, target.x),
            snap(random, target.y),
            snap(random, target.z),
        );
        direction = DVec3::new(
            snap(random, direction.x),
            snap(random, direction.y),
            snap(random, direction.z),
        );
        if direction == DVec3::ZERO {
            direction = DVec3::new(-0.0, 0.0, 1.0);
        }
    }
    let scale = 2f64.powi((random.bits() % 60) as i32 - 30);
    ShapeRay {
        t_near: f64::NEG_INFINITY,
        ..ShapeRay::new(target - distance * direction, scale * direction)
    }
}

fn crossings(shape: &Shape, ray: &ShapeRay) -> Vec<f64> {
    let mut all = Vec::new();
    shape.crossings(ray, &mut |hit| all.push(hit.t));
    all
}

fn pairs(crossings: &[f64]) -> Intervals {
    crossings
        .chunks_exact(2)
        .map(|pair| [DoubleDouble::of(pair[0]), DoubleDouble::of(pair[1])])
        .collect()
}

/// Returns the distance by which rounding may move a surface.
fn tolerance(ray: &ShapeRay) -> f64 {
    ROUNDINGS * 0.5 * f64::EPSILON * (1.0 + ray.origin.length())
}

impl ShapeOracle {
    /// Returns the intervals of the line inside the shape moved outward by `delta`.
    fn inside(&self, ray: &ShapeRay, delta: f64) -> Intervals {
        self.half_spaces.iter().fold(self.wall(ray, delta), |found, s| {
            cut(found, s.n, s.h + delta, ray.origin, ray.direction)
        })
    }

    /// Returns the intervals inside the quadric alone; of a cone, inside the lower nappe.
    fn wall(&self, ray: &ShapeRay, delta: f64) -> Intervals {
        let Some(moved) = self.quadric else {
            return whole_line();
        };
        let (o, d) = (ray.origin, ray.direction);
        let (q, center) = moved(delta);
        let found = inside_quadric(&q, center, o, d);
        match self.shape {
            Shape::Cone(_) => cut(found, DVec3::Z, center.z, o, d),
            _ => found,
        }
    }

    /// Returns whether the claimed hits of a solid lie between those of the smaller and the larger shape.
    fn check_solid(&self, ray: &ShapeRay, claimed: &[f64]) -> bool {
        let delta = tolerance(ray);
        claimed.len().is_multiple_of(2)
            && is_within(&pairs(claimed), &self.inside(ray, delta))
            && is_within(&self.inside(ray, -delta), &pairs(claimed))
    }

    /// Returns whether the claimed hits of an open surface are correct and complete: every one lies between the smaller
    /// and the larger wall and inside the larger half-spaces; between two walls well inside the half-spaces there is
    /// one.
    fn check_open_surface(&self, ray: &ShapeRay, claimed: &[f64]) -> bool {
        let delta = tolerance(ray);
        // A quadric is moved by value, whose gradient within the tolerance is at most 4.
        let wall_delta = if matches!(self.shape, Shape::Quadric(_)) {
            4.0 * delta
        } else {
            delta
        };
        let (larger, smaller) = (self.wall(ray, wall_delta), self.wall(ray, -wall_delta));
        let kept = |t: DoubleDouble, delta: f64| {
            let p = at(ray.origin, ray.direction, t);
            self.half_spaces
                .iter()
                .all(|s| dot(s.n.to_array().map(DoubleDouble::of), p) <= DoubleDouble::of(s.h + delta))
        };
        // Check that every claimed hit is near the surface
        let right = claimed.iter().all(|&t| {
            let t = DoubleDouble::of(t);
            larger.iter().any(|i| i[0] <= t && t <= i[1])
                && !smaller.iter().any(|i| i[0] < t && t < i[1])
                && kept(t, delta)
        });
        // Check that every certain crossing is claimed
        let complete = smaller.iter().all(|inner| {
            let holds = |o: &&[DoubleDouble; 2]| o[0] <= inner[0] && inner[1] <= o[1];
            let Some(outer) = larger.iter().find(holds) else {
                return false;
            };
            [[outer[0], inner[0]], [inner[1], outer[1]]].iter().all(|[a, b]| {
                let certain = a.nearest().is_finite()
                    && b.nearest().is_finite()
                    && kept(*a, -delta)
                    && kept(*b, -delta);
                let hit_count = |t: &f64| *a <= DoubleDouble::of(*t) && DoubleDouble::of(*t) <= *b;
                !certain || claimed.iter().any(hit_count)
            })
        });
        right && complete
    }
}

#[test]
fn torus_crossings_equal_those_of_a_rounding_perturbed_torus() {
    for minor_radius in [0.25, 0.02, 0.9] {
        let shape = Shape::Torus(Torus { minor_radius });
        let mut random = SplitMix64::new(SEED, 0);
        let (mut hit_count, mut bad) = (0, 0);
        for _ in 0..20_000 {
            let ray = random_ray(&mut random);
            // Intersect a random ray
            let claimed = crossings(&shape, &ray);
            hit_count += usize::from(!claimed.is_empty());
            // Compare with the enlarged and the shrunk torus
            let delta = TORUS_ROUNDINGS * 0.5 * f64::EPSILON * (1.0 + ray.origin.length());
            let good = claimed.len().is_multiple_of(2)
                && is_within(
                    &pairs(&claimed),
                    &inside_torus(minor_radius, delta, ray.origin, ray.direction),
                )
                && is_within(
                    &inside_torus(minor_radius, -delta, ray.origin, ray.direction),
                    &pairs(&claimed),
                );
            if !good {
                bad += 1;
                if bad <= 3 {
                    println!("{ray:?} gave {claimed:?}");
                }
            }
        }
        println!("{shape:?}: {bad} wrong, {hit_count} hits");
        assert!(hit_count > 400);
        assert_eq!(bad, 0, "{shape:?}, seed {SEED}");
    }
}

#[test]
fn flat_open_shapes_are_hit_where_exact_division_says() {
    let mut random = SplitMix64::new(SEED, 0);
    let mut hit_count = 0;
    for _ in 0..100_000 {
        let ray = random_ray(&mut random);
        let delta = tolerance(&ray);
        let t = (DoubleDouble::of(-ray.origin.z) / DoubleDouble::of(ray.direction.z)).nearest();
        let p = at(ray.origin, ray.direction, DoubleDouble::of(t)).map(DoubleDouble::nearest);
        let sizes = [0.0, p[0].hypot(p[1]), p[0].abs().max(p[1].abs())];
        for (shape, size) in [Shape::Plane, Shape::Disk, Shape::Quad].iter().zip(sizes) {
            let claimed = crossings(shape, &ray);
            let crosses = ray.direction.z != 0.0 && size <= 1.0;
            let certain = ray.direction.z == 0.0 || (size - 1.0).abs() > delta;
            assert!(
                !certain || crosses != claimed.is_empty(),
                "{shape:?} {ray:?} seed {SEED}"
            );
            assert!(
                claimed.iter().all(|c| (c - t).abs() <= f64::EPSILON * t.abs()),
                "{ray:?}"
            );
            hit_count += claimed.len();
        }
    }
    assert!(hit_count > 100_000);
}

#[test]
fn the_nearest_hit_is_the_first_crossing_of_the_interval() {
    let mut random = SplitMix64::new(SEED, 0);
    let mut shapes: Vec<Shape> = shape_oracles().into_iter().map(|r| r.shape).collect();
    shapes.push(Shape::Torus(Torus { minor_radius: 0.4 }));
    for shape in shapes {
        for _ in 0..20_000 {
            let ray = random_ray(&mut random);
            let all = crossings(&shape, &ray);
            let near = 2.0 * (random.unit() - 0.3) * all.first().copied().unwrap_or(1.0);
            let interval = ShapeRay {
                t_near: near,
                t_far: near + random.unit() * all.last().copied().unwrap_or(1.0).abs(),
                ..ray
            };
            let first = all.iter().copied().find(|t| interval.in_range(*t));
            let hit = shape.intersect(&interval);
            assert_eq!(hit.map(|h| h.t), first, "{shape:?} {interval:?} seed {SEED}");
        }
    }
}

#[test]
fn crossings_equal_those_of_a_rounding_perturbed_surface() {
    let mut wrong = 0;
    for shape_oracle in shape_oracles() {
        let mut random = SplitMix64::new(SEED, 0);
        let (mut hit_count, mut bad) = (0, 0);
        for _ in 0..100_000 {
            let ray = random_ray(&mut random);
            let claimed = crossings(&shape_oracle.shape, &ray);
            hit_count += usize::from(!claimed.is_empty());
            let good = if shape_oracle.shape.is_solid() {
                shape_oracle.check_solid(&ray, &claimed)
            } else {
                shape_oracle.check_open_surface(&ray, &claimed)
            };
            if !good {
                bad += 1;
                if bad <= 3 {
                    println!("{:?}: {ray:?} gave {claimed:?}", shape_oracle.shape);
                }
            }
        }
        println!("{:?}: {bad} wrong, {hit_count} hits", shape_oracle.shape);
        assert!(hit_count > 10_000, "{:?}", shape_oracle.shape);
        wrong += bad;
    }
    assert_eq!(wrong, 0, "seed {SEED}");
}

/// Two roundings to f32 of three coordinates up to 1.75.
const START_ROUNDING: f64 = 6.0 * 1.75 / (1 << 24) as f64;

/// Calls `each` with points of the surface as a renderer gets them: hits of random rays.
fn surface_points(
    shape: &Shape,
    count: usize,
    random: &mut SplitMix64,
    mut each: impl FnMut(&mut SplitMix64, DVec3, u32),
) {
    let mut found = 0;
    while found < count {
        let origin = 3.0 * random.in_cube();
        let ray = ShapeRay::new(origin, 1.2 * random.in_cube() - origin);
        let mut hits = Vec::new();
        shape.crossings(&ray, &mut |hit| hits.push(hit));
        for hit in hits {
            found += 1;
            each(random, ray.at(hit.t), hit.part);
        }
    }
}

fn all_with_curvature() -> Vec<(Shape, f64)> {
    let mut all: Vec<_> = shape_oracles()
        .into_iter()
        .map(|r| (r.shape, r.curvature))
        .collect();
    for minor_radius in [0.25f64, 0.6] {
        let curvature = minor_radius.min(1.0 - minor_radius);
        all.push((Shape::Torus(Torus { minor_radius }), curvature));
    }
    for flat in [Shape::Plane, Shape::Disk, Shape::Quad] {
        all.push((flat, f64::INFINITY));
    }
    all
}

#[test]
fn spawned_ray_does_not_hit_its_origin_surface() {
    for (shape, curvature) in all_with_curvature() {
        let mut random = SplitMix64::new(SEED, 0);
        let (mut deflated_false_hits, mut offset_false_hits, mut deflated_hits, mut offset_hits) =
            (0, 0, 0, 0);
        surface_points(&shape, 100_000, &mut random, |random, p, part| {
            let point = shape.point(p, part);
            let mut direction = random.direction();
            if random.bits() & 3 == 0 {
                // Make every fourth direction grazing.
                let tangential = direction - direction.dot(point.n) * point.n;
                direction = tangential + 2f64.powi(-((random.bits() % 20) as i32)) * direction;
            }
            let direction = direction.as_vec3().as_dvec3();
            let curvature = if matches!(shape, Shape::Cone(_)) {
                p.x.hypot(p.y)
            } else {
                curvature
            };
            // Determine the side that the ray goes to
            let sine = direction.dot(point.n);
            let (side, n) = if sine > 0.0 {
                (Side::Outside, point.n)
            } else {
                (Side::Inside, -point.n)
            };
            let is_false = |hit: Option<super::ShapeHit>| {
                hit.is_some_and(|hit| {
                    let chord = hit.t * direction.length();
                    // The start's rounding to f32 moves the foot of the normal by as much.
                    let least = 0.5 * curvature * sine.abs() / direction.length() - START_ROUNDING;
                    hit.part == part && (chord == 0.0 || chord < least)
                        || (shape.is_solid() && is_convex(&shape) && side == Side::Outside)
                })
            };
            // Remove the own root by naming the surface
            let origin_surface = ShapeRay {
                origin_surface: Some(OriginSurface { part, side }),
                ..ShapeRay::new(point.p.as_vec3().as_dvec3(), direction)
            };
            let hit = shape.intersect(&origin_surface);
            deflated_hits += usize::from(hit.is_some());
            deflated_false_hits += usize::from(is_false(hit));
            // Offset the origin instead
            let origin = spawn_point(point.p, n, point.error.along(n)).as_dvec3();
            let hit = shape.intersect(&ShapeRay::new(origin, direction));
            offset_hits += usize::from(hit.is_some());
            offset_false_hits += usize::from(is_false(hit));
        });
        println!(
            "{deflated_false_hits} of {deflated_hits}, {offset_false_hits} of {offset_hits}: {shape:.0?}"
        );
        assert_eq!(
            (deflated_false_hits, offset_false_hits),
            (0, 0),
            "{shape:?} seed {SEED}"
        );
        // Except for the rounding of the start, both methods find equal hits.
        assert!(
            deflated_hits.abs_diff(offset_hits) <= 300,
            "{shape:?}: {deflated_hits}, {offset_hits}"
        );
    }
}

fn is_convex(shape: &Shape) -> bool {
    !matches!(shape, Shape::Torus(_) | Shape::Quadric(_))
}

#[test]
fn points_lie_on_their_surface_with_a_unit_normal_across_their_tangents() {
    for (shape, _) in all_with_curvature() {
        let mut random = SplitMix64::new(SEED, 0);
        surface_points(&shape, 2_000, &mut random, |_, p, part| {
            let point = shape.point(p, part);
            // Hits start within 6 units: 64 roundings are 2^-47.
            assert!(
                (point.p - p).length() <= 64.0 * f64::EPSILON,
                "{shape:?} {p} {point:?}"
            );
            assert!((point.n.length() - 1.0).abs() <= 4.0 * f64::EPSILON);
            let across = point.dpdu.cross(point.dpdv);
            let error = (across.normalize() - point.n).length() * across.length();
            assert!(
                error <= 256.0 * f64::EPSILON * (1.0 + across.length()),
                "{shape:?} {point:?}"
            );
            for (k, tangent) in [point.dpdu, point.dpdv].into_iter().enumerate() {
                assert_tangent(&shape, &point, part, k, tangent);
            }
        });
    }
}

/// Asserts that a small step along a tangent changes its coordinate by the step, up to the square of the step.
fn assert_tangent(shape: &Shape, point: &super::ShapePoint, part: u32, k: usize, tangent: DVec3) {
    const STEP: f64 = 1e-6;
    let [back, forth] = [-STEP, STEP].map(|h| shape.point(point.p + h * tangent, part).uv);
    for axis in 0..2 {
        let slope = (forth[axis] - back[axis]) / (2.0 * STEP);
        let expected = f64::from(u8::from(axis == k));
        let wraps = (forth[axis] - back[axis]).abs() > 0.5;
        let clamped = |x: f64| x <= STEP || x >= 1.0 - STEP;
        if !wraps && !clamped(point.uv[axis]) && point.dpdu.length() > 1e-2 {
            assert!(
                (slope - expected).abs() < 1e-4,
                "{shape:?} {point:?}: d{axis}/d{k} = {slope}"
            );
        }
    }
}
