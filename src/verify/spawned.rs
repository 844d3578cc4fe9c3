//! Rays that leave a surface: they must neither meet it again nor start behind what is close in front of it.

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::meshes::{icosahedron, mesh, scene};
use super::sketch::Asked;
use super::trial::{Answer, Engine, Tally, Trial, describe, order};
use super::{Asks, Case, Closes};
use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{Departure, Departures};
use crate::scene::{Geometry, Material, Scene};

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H19",
        title: "self-shadows",
        construction: "rays that leave icosahedra of radius 10^-9 to 10^9, 1 to 10^6 radii from the origin, outward",
        oracle: "the mesh is convex: what leaves it outward meets nothing",
        bound: "0 false shadows",
        unit: "",
        asks: Asks::Triangles,
        required: Closes::Edges,
        run: self_shadows,
    },
    Case {
        id: "H19s",
        title: "self-shadows of slivers",
        construction: "rays that leave single triangles, 1 to 10^6 times as long as high",
        oracle: "a triangle is flat: what leaves it does not meet it again",
        bound: "0 false shadows",
        unit: "",
        asks: Asks::Triangles,
        required: Closes::Vertices,
        run: sliver_shadows,
    },
    Case {
        id: "H20",
        title: "smallest gap",
        construction: "rays from one sheet to another that is 1 to 64 ulp of the coordinates in front of it",
        oracle: "sheets of whole ulps: what starts between them or meets the second is right",
        bound: "no ray starts beyond a sheet that is more than 8 ulp away",
        unit: "ulp",
        asks: Asks::Triangles,
        required: Closes::Faces,
        run: smallest_gap,
    },
];

/// Powers of ten of the mesh's radius.
const SCALES: std::ops::RangeInclusive<i32> = -9..=9;
/// Powers of ten of its distance, in radii.
const DISTANCES: std::ops::RangeInclusive<i32> = 0..=6;

/// The ray that leaves `at` along a direction on the side of its normal.
pub(super) fn leave(trial: &Trial, at: &Departure, direction: DVec3) -> Ray {
    let origin = (trial.subject.formulas.spawn_point)(at.p, at.ng, at.error);
    Ray::new(origin, direction.as_vec3())
}

/// The hits of `rays` that a surface was found for, with the ray that leaves each, chosen by `direction`.
fn leaving(
    trial: &Trial,
    (engine, departures): (&Engine, &Departures),
    rays: &[Ray],
    random: &mut SplitMix64,
    direction: impl Fn(&Departure, &mut SplitMix64) -> Option<DVec3>,
) -> Vec<(Departure, Ray)> {
    let packets = engine.traced(rays, order(random));
    let met = packets.iter().flat_map(|packet| departures.of(packet));
    met.flatten()
        .filter_map(|at| direction(&at, random).map(|way| (at, leave(trial, &at, way))))
        .collect()
}

/// A direction on the side of the normal, and surely so after it is rounded.
pub(super) fn outward(at: &Departure, random: &mut SplitMix64) -> Option<DVec3> {
    let way = random.direction();
    let way = if way.dot(at.ng) < 0.0 { -way } else { way };
    // The normal and the direction are off by a few roundings of f32.
    (way.dot(at.ng) > 16.0 * f64::from(f32::EPSILON)).then_some(way)
}

fn self_shadows(trial: &Trial) -> Result<Tally, AccelError> {
    let cells: Vec<(i32, i32)> = SCALES
        .flat_map(|scale| DISTANCES.map(move |distance| (scale, distance)))
        .collect();
    trial.over_parts(cells.len(), &|number, trial| {
        let (scale, distance) = cells[number];
        self_shadows_of(&trial, 10f64.powi(scale), 10f64.powi(distance))
    })
}

/// A turned icosahedron of that radius, so many radii from the origin, where another stands: as a scene is loaded.
fn far_icosahedron(random: &mut SplitMix64, radius: f64, distance: f64) -> Scene {
    let (corners, faces) = icosahedron();
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    let place = |center: DVec3| {
        let map = DAffine3::from_scale_rotation_translation(DVec3::splat(radius), turn, center);
        let corners: Vec<DVec3> = corners.iter().map(|&p| map.transform_point3(p)).collect();
        Geometry::Mesh(mesh(&corners, faces.clone()))
    };
    // Far enough apart that none shadows the other.
    let far = (distance + 3.0) * radius * random.direction();
    let mut scene = Scene {
        materials: vec![Material::default()],
        ..scene(vec![place(far), place(DVec3::ZERO)])
    };
    scene.normalise();
    scene
}

fn self_shadows_of(trial: &Trial, radius: f64, distance: f64) -> Result<Tally, AccelError> {
    let scene = far_icosahedron(
        &mut SplitMix64::new(trial.rays, radius.to_bits() ^ distance.to_bits()),
        radius,
        distance,
    );
    let engine = trial.engine(&scene)?;
    let departures = Departures::new(&scene);
    let bounds = scene.geometries[0].bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    let tally = trial.in_chunks(&|random, count| {
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                let origin = (center + 4.0 * reach * random.direction()).as_vec3();
                let target = center + 0.3 * reach * random.in_cube();
                Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
            })
            .collect();
        // Rays that pass by the first meet the other, or nothing: either is left outward.
        let leaving = leaving(trial, (&engine, &departures), &rays, random, |at, random| {
            let is_far = at.p.distance(center) < 2.0 * reach;
            outward(at, random).filter(|_| is_far)
        });
        let out: Vec<Ray> = leaving.iter().map(|&(_, ray)| ray).collect();
        let mut tally = Tally::default();
        // Only the mesh that is left counts: the other may well stand in the way.
        for (ray, hit) in out.iter().zip(engine.nearest(&out, order(random))) {
            let is_own = hit.is_some_and(|hit| hit.instance == 0);
            tally.count_ray(Answer::wrong_if(is_own), ray, hit);
        }
        tally
    });
    Ok(trial.with_drawing(&engine, tally))
}

/// Powers of ten of how many times a triangle is as long as high.
const ASPECTS: std::ops::RangeInclusive<i32> = 0..=6;
/// Triangles of each kind.
const TRIANGLES: usize = 16;

fn sliver_shadows(trial: &Trial) -> Result<Tally, AccelError> {
    let cells: Vec<i32> = ASPECTS
        .flat_map(|aspect| std::iter::repeat_n(aspect, TRIANGLES))
        .collect();
    trial.over_parts(cells.len(), &|number, trial| {
        let mut random = SplitMix64::new(0x19, number as u64);
        shadows_of_triangle(&trial, triangle(&mut random, 10f64.powi(cells[number])))
    })
}

/// A triangle within a few units of the origin, so many times as long as high.
fn triangle(random: &mut SplitMix64, aspect: f64) -> [DVec3; 3] {
    let a = 2.0 * random.in_cube();
    let along = random.within(0.3, 1.0) * random.direction();
    let across = along.cross(random.direction()).normalize_or_zero() * along.length() / aspect;
    [a, a + along, a + random.unit() * along + across]
}

fn shadows_of_triangle(trial: &Trial, corners: [DVec3; 3]) -> Result<Tally, AccelError> {
    let scene = Scene {
        materials: vec![Material::default()],
        ..scene(vec![Geometry::Mesh(mesh(&corners, vec![[0, 1, 2]]))])
    };
    let engine = trial.engine(&scene)?;
    let departures = Departures::new(&scene);
    let [a, b, c] = corners;
    let tally = trial.in_chunks(&|random, count| {
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                let (u, v) = (random.unit(), random.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let target = a + u * (b - a) + v * (c - a);
                let origin = (target + random.within(1.0, 3.0) * random.direction()).as_vec3();
                Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
            })
            .collect();
        let leaving = leaving(trial, (&engine, &departures), &rays, random, outward);
        let out: Vec<Ray> = leaving.iter().map(|&(_, ray)| ray).collect();
        let mut tally = Tally::default();
        for (ray, hit) in out.iter().zip(engine.nearest(&out, order(random))) {
            tally.count_ray(Answer::wrong_if(hit.is_some()), ray, hit);
        }
        tally
    });
    Ok(trial.with_drawing(&engine, tally))
}

/// Most ulps of a gap that is tried.
const GAPS: u32 = 64;
/// Beyond a sheet that is farther away than this no ray may start.
const RESOLVED: u32 = 8;

/// Pairs of parallel sheets about the point (1, 1, 1) times a power of two, `gap` ulp of the coordinates apart.
fn sheets(gap: u32) -> Scene {
    const HEIGHT: f32 = 1.5;
    let above = f32::from_bits(HEIGHT.to_bits() + gap);
    let sheet = |z: f32| {
        let at = |x: f32, y: f32| Vec3::new(x, y, z).as_dvec3();
        let corners = [at(0.5, 0.5), at(1.5, 0.5), at(1.5, 1.5), at(0.5, 1.5)];
        Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]))
    };
    Scene {
        materials: vec![Material::default()],
        ..scene(vec![sheet(HEIGHT), sheet(above)])
    }
}

fn smallest_gap(trial: &Trial) -> Result<Tally, AccelError> {
    trial.over_parts(GAPS as usize, &|number, trial| {
        let gap = 1 + number as u32;
        let scene = sheets(gap);
        let engine = trial.engine(&scene)?;
        let departures = Departures::new(&scene);
        let ask = |random: &mut SplitMix64, count| across(&trial, (&engine, &departures), gap, random, count);
        let tally = trial.in_chunks(&ask);
        Ok(trial.with_drawing(&engine, tally))
    })
}

/// Rays from below the lower sheet, that go through it upward from where they have met it; they must meet the upper one.
fn across(
    trial: &Trial,
    (engine, departures): (&Engine, &Departures),
    gap: u32,
    random: &mut SplitMix64,
    count: usize,
) -> Tally {
    let rays: Vec<Ray> = (0..count)
        .map(|_| {
            let mut inner = || random.within(0.7, 1.3);
            let target = DVec3::new(inner(), inner(), 1.5);
            let origin =
                (target + DVec3::new(random.within(-0.5, 0.5), random.within(-0.5, 0.5), -1.0)).as_vec3();
            Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
        })
        .collect();
    let leaving = leaving(trial, (engine, departures), &rays, random, |_, random| {
        // On the other side of the lower sheet, steeply enough to meet the upper one.
        let way = DVec3::new(random.within(-0.5, 0.5), random.within(-0.5, 0.5), 1.0);
        Some(way)
    });
    let up: Vec<Ray> = leaving
        .iter()
        .map(|(at, ray)| {
            let through = Departure { ng: -at.ng, ..*at };
            leave(trial, &through, ray.direction.as_dvec3())
        })
        .collect();
    let mut tally = Tally::default();
    for (ray, is_blocked) in up.iter().zip(engine.blocked(&up, order(random))) {
        if !is_blocked {
            tally.note(f64::from(gap));
        }
        let answer = match (is_blocked, gap > RESOLVED) {
            (true, _) => Answer::Right,
            (false, false) => Answer::Tie,
            (false, true) => Answer::Wrong,
        };
        tally.sketch.keep(Asked {
            ray: *ray,
            hit: None,
            answer,
        });
        tally.count(answer, || format!("{gap} ulp apart, {}", describe(ray, None)));
    }
    tally
}
