//! Intersection of cylinder, cone, torus and polyhedra where their equations lose a degree, cancel or have double
//! roots.
//!
//! A result is right if it is exact for a solid whose surface is displaced by no more than rounding explains: a ray
//! that certainly hits the smaller solid must hit, and a hit must lie between the surfaces of both.
//!
//! Embree traverses to user geometry without the conservative rounding of its robust triangles: it misses boxes of
//! shapes by some roundings of the distance of a ray's origin. The padding of the boxes compensates for origins as far
//! away as the farthest camera of the scene.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Camera;
use crate::shape::oracle::{
    self, FirstCrossing, Intervals, cut, first_crossing_of_torus, inside_quadric, inside_torus, whole_line,
};
use crate::shape::{Cone, Cylinder, HalfSpace, Polyhedron, Shape, Torus};
use crate::verify::harness::test_meshes::among_others;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, towards};

/// Approximate largest distance of a ray's origin from a solid's centre.
const FARTHEST: f64 = 1e5;

/// Values that all cases of solids share.
const SOLID: Case = Case {
    oracle: "intervals of the line inside the solid, shrunk and grown by rounding, to 100 bits",
    bound: "no wrong decision, t to 1 ulp of f32; ties are right for a solid moved by rounding",
    unit: "ulp of t",
    ..Case::SHAPES
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H05",
        title: "along a cylinder",
        construction: "directions off the axis by 2^-1 to 2^-149, from the wall, the inside, the outside and far away",
        run: |trial| at_solids(trial, vec![cylinder()], along_cylinder),
        ..SOLID
    },
    Case {
        id: "H06",
        title: "along a cone",
        construction: "lines parallel to a generator or nearly so, and through the apex and roundings of it",
        run: |trial| at_solids(trial, vec![cone()], along_cone),
        ..SOLID
    },
    Case {
        id: "H07",
        title: "distant torus",
        construction: "tori with tubes of 1/2 to 10^-3, from 1 to 10^5 away, at the tube and at tangents of it",
        run: distant_tori,
        ..SOLID
    },
    Case {
        id: "H10",
        title: "along polyhedra",
        construction: "rays in the faces, along the edges and through the corners of a cube and a dodecahedron",
        run: |trial| at_solids(trial, vec![cube(), dodecahedron()], along_faces),
        ..SOLID
    },
];

type Inside = dyn Fn(DVec3, DVec3, f64) -> Intervals + Sync;

/// Shape with an oracle for the parts of a line inside it when its surface is displaced outward.
struct Solid {
    shape: Shape,
    inside: Box<Inside>,
    /// Displacement that rounding may explain, in roundings of 2^-53 of the coordinates involved.
    roundings: f64,
    /// Vertices of a polyhedron, at which rays are aimed.
    corners: Vec<DVec3>,
    /// Tube radius of a torus, whose exact roots are expensive: marching confirms most results without them.
    tube: Option<f64>,
}

/// Returns the capped cylinder x² + y² <= 1, |z| <= 1.
fn cylinder() -> Solid {
    let inside = |o: DVec3, d: DVec3, delta: f64| {
        let radius = 1.0 + delta;
        let wall = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -radius * radius];
        let wall = inside_quadric(&wall, DVec3::ZERO, o, d);
        cut(cut(wall, DVec3::Z, radius, o, d), -DVec3::Z, radius, o, d)
    };
    Solid {
        shape: Shape::Cylinder(Cylinder { capped: true }),
        inside: Box::new(inside),
        roundings: 16.0,
        corners: Vec::new(),
        tube: None,
    }
}

/// Returns the lower nappe of the cone x² + y² <= (1 - z)² / 4 above z = -1.
fn cone() -> Solid {
    let inside = |o: DVec3, d: DVec3, delta: f64| {
        // Displacing the wall by delta moves the apex by √5 delta.
        let apex = 1.0 + 5f64.sqrt() * delta;
        let walls = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.25, 0.0, 0.0];
        let walls = inside_quadric(&walls, apex * DVec3::Z, o, d);
        cut(cut(walls, DVec3::Z, apex, o, d), -DVec3::Z, 1.0 + delta, o, d)
    };
    Solid {
        shape: Shape::Cone(Cone { capped: true }),
        inside: Box::new(inside),
        roundings: 16.0,
        corners: Vec::new(),
        tube: None,
    }
}

fn torus(minor_radius: f64) -> Solid {
    Solid {
        shape: Shape::Torus(Torus { minor_radius }),
        inside: Box::new(move |o, d, delta| inside_torus(minor_radius, delta, o, d)),
        // At tangents the coefficients of the quartic, up to 16, and the division by the tube radius amplify rounding.
        roundings: 64.0,
        corners: Vec::new(),
        tube: Some(minor_radius),
    }
}

/// Returns the intersection of half-spaces as a solid.
fn within(shape: Shape, half_spaces: Vec<HalfSpace>) -> Solid {
    let corners = corners(&half_spaces);
    let inside = move |o: DVec3, d: DVec3, delta: f64| {
        half_spaces.iter().fold(whole_line(), |found, space| {
            cut(found, space.n, space.h + delta, o, d)
        })
    };
    Solid {
        shape,
        inside: Box::new(inside),
        roundings: 16.0,
        corners,
        tube: None,
    }
}

/// Returns the vertices: points where three planes intersect that lie within all other half-spaces.
fn corners(half_spaces: &[HalfSpace]) -> Vec<DVec3> {
    let mut corners = Vec::new();
    for (i, a) in half_spaces.iter().enumerate() {
        for (j, b) in half_spaces.iter().enumerate().skip(i + 1) {
            for c in half_spaces.iter().skip(j + 1) {
                let m = glam::DMat3::from_cols(a.n, b.n, c.n).transpose();
                let p = m.inverse() * DVec3::new(a.h, b.h, c.h);
                // Rounding is far smaller than the distance of any other vertex from these planes.
                let slack = f64::from(f32::EPSILON);
                if p.is_finite() && half_spaces.iter().all(|s| s.n.dot(p) <= s.h + slack) {
                    corners.push(p);
                }
            }
        }
    }
    corners
}

fn cube() -> Solid {
    let faces = DVec3::AXES.into_iter().flat_map(|n| [n, -n]);
    within(Shape::Cube, faces.map(|n| HalfSpace { n, h: 1.0 }).collect())
}

fn dodecahedron() -> Solid {
    match Polyhedron::from_half_spaces(&oracle::dodecahedron()) {
        // Use the half-spaces as stored, with renormalised normals
        Ok(polyhedron) => {
            let half_spaces = polyhedron.half_spaces().to_vec();
            within(Shape::Polyhedron(Arc::new(polyhedron)), half_spaces)
        }
        Err(_) => cube(),
    }
}

/// Returns the parameter of the first boundary that is not behind the origin, and whether it is an entry.
fn first_ahead(intervals: &Intervals) -> Option<(f64, bool)> {
    let ends = intervals.iter().map(|[a, b]| (a.nearest(), b.nearest()));
    let mut ahead = ends.filter(|&(_, b)| b >= 0.0);
    ahead
        .next()
        .map(|(a, b)| if a >= 0.0 { (a, true) } else { (b, false) })
}

impl Solid {
    fn judge(&self, ray: &Ray, hit: Option<Hit>, tally: &mut Counts) -> Correctness {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        // Try the torus march, which confirms most results
        let delta = self.roundings * 0.5 * f64::EPSILON * (1.0 + o.length());
        if let Some(off) = self.tube.and_then(|r| found_by_march(r, delta, (o, d), hit)) {
            tally.record_error(off);
            return Correctness::Right;
        }
        // Intersect the smaller and the larger solid
        let [inner, outer] = [-delta, delta].map(|delta| (self.inside)(o, d, delta));
        let [sure, possible] = [&inner, &outer].map(first_ahead);
        // A parameter beyond the largest f32 counts as a miss.
        let is_near = |&(t, _): &(f64, bool)| (t as f32) < f32::INFINITY;
        // Compare the hit with the first boundaries of both
        match (sure.filter(is_near), possible.filter(is_near), hit) {
            (None, None, None) => Correctness::Right,
            (None, Some(_), None) => Correctness::Tie,
            (_, None, Some(_)) | (Some(_), _, None) => Correctness::Wrong,
            (Some((a, was)), Some((b, is)), Some(hit)) if was == is => {
                let off = beyond(hit.t, a.min(b), a.max(b));
                tally.record_error(off);
                Correctness::wrong_if(!(off <= 1.0))
            }
            // At a tangent, or for an origin on the surface, any point between the two surfaces is a tie.
            (_, _, Some(hit)) => {
                let t = f64::from(hit.t);
                let ulp = f64::from(hit.t.next_up()) - t;
                let holds = |i: &Intervals| {
                    i.iter()
                        .any(|[a, b]| a.nearest() < t - ulp && t + ulp < b.nearest())
                };
                let is_between = outer
                    .iter()
                    .any(|[a, b]| a.nearest() <= t + ulp && t - ulp <= b.nearest());
                Correctness::tie_if(is_between && !holds(&inner))
            }
        }
    }
}

/// Returns the largest error in ulps that marching a torus admits for a result; `None` if the march cannot confirm it.
fn found_by_march(r: f64, delta: f64, ray: (DVec3, DVec3), hit: Option<Hit>) -> Option<f64> {
    // Stop the march at an interval of 1/64 ulp
    const SHARE: f64 = 1.0 / (1u64 << 30) as f64;
    match (first_crossing_of_torus(r, delta, ray, SHARE)?, hit) {
        (FirstCrossing::Nowhere, None) => Some(0.0),
        (FirstCrossing::Between(low, high), Some(hit)) => {
            // The crossing may be at either end of the interval.
            let off = beyond(hit.t, high, low);
            (off <= 1.0).then_some(off)
        }
        _ => None,
    }
}

/// Returns the distance of `t` from the interval [`low`, `high`] in ulps of f32.
fn beyond(t: f32, low: f64, high: f64) -> f64 {
    let wide = f64::from(t);
    let ulp = f64::from(t.abs().next_up()) - f64::from(t.abs());
    (low - wide).max(wide - high).max(0.0) / ulp
}

fn at_solids(
    trial: &CaseRunner,
    solids: Vec<Solid>,
    ray: impl Fn(&Solid, &mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    trial.over_parts(solids.len(), &|number, trial| {
        let solid = &solids[number];
        // All of these solids lie within √3 of their centre.
        let mut scene = among_others(solid.shape.clone(), DVec3::ZERO, 3f64.sqrt());
        scene.cameras = vec![Camera {
            world_from_camera: DAffine3::from_translation(FARTHEST * DVec3::Z),
            ..Camera::default()
        }];
        let engine = trial.engine(&scene)?;
        Ok(
            trial.nearest(&engine, &|random| ray(solid, random), &|ray, hit, tally| {
                // One of the other geometries may occlude the solid.
                if hit.is_some_and(|hit| hit.instance != 0) {
                    return Correctness::Right;
                }
                solid.judge(ray, hit, tally)
            }),
        )
    })
}

fn along_cylinder(_: &Solid, random: &mut SplitMix64) -> Ray {
    // Choose a direction almost parallel to the axis
    let off = |random: &mut SplitMix64| match random.below(4) {
        0 => random.choose(&[0.0, -0.0]),
        _ => random.choose(&[1.0, -1.0]) * 0.5f64.powi(1 + random.below(149) as i32),
    };
    let direction = DVec3::new(off(random), off(random), random.choose(&[1.0, -1.0]));
    let radius = random.choose(&[0.0, 0.5, 1.0, 1.0, 1.0, 1.5]);
    let around = random.direction().with_z(0.0).normalize_or_zero();
    let around = random.choose(&[around, DVec3::X, -DVec3::Y]);
    let height = random.choose(&[0.0, 1.0, -1.0, 10.0, 1e4]);
    let origin = radius * around - direction.z * height * DVec3::Z;
    Ray::new(origin.as_vec3(), direction.as_vec3())
}

fn along_cone(_: &Solid, random: &mut SplitMix64) -> Ray {
    let around = random.direction().with_z(0.0).normalize_or_zero();
    let around = random.choose(&[around, DVec3::X, -DVec3::Y]);
    // The wall descends by 2 from the apex where its radius grows by 1.
    let generator = around - 2.0 * DVec3::Z;
    let nudge = match random.below(3) {
        0 => DVec3::ZERO,
        _ => 0.5f64.powi(random.below(60) as i32) * random.in_cube(),
    };
    let any = random.direction();
    let (target, direction) = match random.below(2) {
        0 => (
            DVec3::Z + nudge,
            random.choose(&[generator, -DVec3::Z, DVec3::X, any]),
        ),
        _ => (random.in_cube(), generator + nudge),
    };
    let origin = target - random.choose(&[0.0, 0.5, 1.0, 3.0, 100.0]) * direction;
    Ray::new(origin.as_vec3(), direction.as_vec3())
}

fn distant_tori(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let tori: Vec<Solid> = [0.5, 0.1, 0.01, 0.001].map(torus).into();
    at_solids(trial, tori, |solid, random| {
        let radius = match &solid.shape {
            Shape::Torus(torus) => torus.minor_radius,
            _ => 1.0,
        };
        let around = random.direction().with_z(0.0).normalize_or_zero();
        let way = random.direction();
        let beside = way.cross(random.direction()).normalize_or_zero();
        // Aim at the centre of the tube, within it, or at its tangents
        let off = radius * random.choose(&[0.0, 0.5, 1.0, 1.0 - 1e-6, 1.0 + 1e-6]);
        let distance = 10f64.powi(random.below(6) as i32);
        let origin = around + off * beside - distance * way;
        let target = around + off * beside;
        towards(origin, target)
    })
}

fn along_faces(solid: &Solid, random: &mut SplitMix64) -> Ray {
    let mut corner = || random.choose(&solid.corners);
    // Aim through a vertex, along an edge or diagonal, in a face, or across
    let [a, b, c] = [corner(), corner(), corner()];
    let along = if a == b { random.direction() } else { b - a };
    let target = match random.below(3) {
        0 => a,
        1 => a.lerp(c, random.unit()),
        _ => a.lerp(b, random.unit()),
    };
    let direction = match random.below(3) {
        0 => along,
        1 => along + 0.5f64.powi(random.below(60) as i32) * random.in_cube(),
        _ => random.direction(),
    };
    let origin = target - random.choose(&[0.0, 0.25, 1.0, 5.0, 100.0]) * direction;
    Ray::new(origin.as_vec3(), direction.as_vec3())
}
