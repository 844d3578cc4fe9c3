//! Self-intersection of spawned rays: a ray that leaves a surface must neither hit it again nor start beyond a surface
//! close in front of it.

use glam::{DAffine3, DQuat, DVec3, Vec3};

use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{SpawnPoint, SpawnProbe};
use crate::scene::{Geometry, Scene};
use crate::verify::harness::test_meshes::{icosahedron, mesh, scene};
use crate::verify::harness::{
    Case, CaseRunner, Correctness, Counts, Engine, TracedRay, Watertightness, describe, order, towards,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H19",
        title: "self-shadows",
        construction: "rays that leave icosahedra of radius 10^-9 to 10^9, 1 to 10^6 radii from the origin, outward",
        oracle: "the mesh is convex: a ray that leaves it outward misses it",
        bound: "0 false shadows",
        required: Watertightness::Edges,
        run: self_shadows,
        ..Case::TRIANGLES
    },
    Case {
        id: "H19s",
        title: "self-shadows of slivers",
        construction: "rays that leave single triangles, 1 to 10^6 times as long as high",
        oracle: "a triangle is flat: a ray that leaves it does not hit it again",
        bound: "0 false shadows",
        required: Watertightness::Vertices,
        run: sliver_shadows,
        ..Case::TRIANGLES
    },
    Case {
        id: "H20",
        title: "smallest gap",
        construction: "rays from one surface to another that is 1 to 64 ulp of the coordinates in front of it",
        oracle: "surfaces at whole ulps: a ray that starts between them or hits the second is right",
        bound: "no ray starts beyond a surface that is more than 8 ulp away",
        unit: "ulp",
        run: smallest_gap,
        ..Case::TRIANGLES
    },
];

/// Decimal exponents of the mesh's radius.
const SCALES: std::ops::RangeInclusive<i32> = -9..=9;
/// Decimal exponents of the mesh's distance from the origin, in radii.
const DISTANCES: std::ops::RangeInclusive<i32> = 0..=6;

/// Returns the ray that leaves the hit point `at` along a direction on the side of its normal.
pub(super) fn spawn_ray(trial: &CaseRunner, at: &SpawnPoint, direction: DVec3) -> Ray {
    let origin = (trial.subject.formulas.spawn_point)(at.p, at.ng, at.error);
    Ray::new(origin, direction.as_vec3())
}

/// Returns the hit points of `rays`, each with a ray spawned there along the direction that `direction` chooses.
fn spawned_rays(
    trial: &CaseRunner,
    (engine, departures): (&Engine, &SpawnProbe),
    rays: &[Ray],
    random: &mut SplitMix64,
    direction: impl Fn(&SpawnPoint, &mut SplitMix64) -> Option<DVec3>,
) -> Vec<(SpawnPoint, Ray)> {
    // Find the points where rays leave surfaces
    let packets = engine.traced(rays, order(random));
    let hit_points = packets.iter().flat_map(|packet| departures.of(packet));
    // Spawn a ray from each
    hit_points
        .flatten()
        .filter_map(|at| direction(&at, random).map(|way| (at, spawn_ray(trial, &at, way))))
        .collect()
}

/// Returns a random direction on the side of the normal, so far from the tangent plane that rounding keeps it there.
pub(super) fn outward_direction(at: &SpawnPoint, random: &mut SplitMix64) -> Option<DVec3> {
    let way = random.direction();
    let way = if way.dot(at.ng) < 0.0 { -way } else { way };
    // Normal and direction have errors of a few roundings of f32.
    (way.dot(at.ng) > 16.0 * f64::from(f32::EPSILON)).then_some(way)
}

fn self_shadows(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Combine all sizes with all distances
    let cells: Vec<(i32, i32)> = SCALES
        .flat_map(|scale| DISTANCES.map(move |distance| (scale, distance)))
        .collect();
    trial.over_parts(cells.len(), &|number, trial| {
        let (scale, distance) = cells[number];
        self_shadows_of(&trial, 10f64.powi(scale), 10f64.powi(distance))
    })
}

/// Returns a scene, normalised as after loading, of a rotated icosahedron of that radius, `distance` + 3 radii from the
/// origin, and a second one at the origin.
fn far_icosahedron(random: &mut SplitMix64, radius: f64, distance: f64) -> Scene {
    let (corners, faces) = icosahedron();
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    let place = |center: DVec3| {
        let map = DAffine3::from_scale_rotation_translation(DVec3::splat(radius), turn, center);
        let corners: Vec<DVec3> = corners.iter().map(|&p| map.transform_point3(p)).collect();
        Geometry::Mesh(mesh(&corners, faces.clone()))
    };
    // The distance is large enough that neither occludes the other.
    let far = (distance + 3.0) * radius * random.direction();
    let mut scene = scene(vec![place(far), place(DVec3::ZERO)]);
    scene.normalise();
    scene
}

fn self_shadows_of(trial: &CaseRunner, radius: f64, distance: f64) -> Result<Counts, AccelError> {
    // Build the scene
    let scene = far_icosahedron(
        &mut SplitMix64::new(trial.rays, radius.to_bits() ^ distance.to_bits()),
        radius,
        distance,
    );
    let engine = trial.engine(&scene)?;
    let departures = SpawnProbe::new(&scene);
    // Bound the distant mesh, which is instance 0
    let bounds = scene.geometries[0].bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                let origin = center + 4.0 * reach * random.direction();
                let target = center + 0.3 * reach * random.in_cube();
                towards(origin, target)
            })
            .collect();
        // Rays that miss the distant mesh hit the one at the origin, or nothing; keep points on the distant mesh only.
        let spawned_rays = spawned_rays(trial, (&engine, &departures), &rays, random, |at, random| {
            let is_far = at.p.distance(center) < 2.0 * reach;
            outward_direction(at, random).filter(|_| is_far)
        });
        let out: Vec<Ray> = spawned_rays.iter().map(|&(_, ray)| ray).collect();
        let mut tally = Counts::default();
        // A hit on the other mesh is legitimate; only hits on the mesh that the ray leaves count.
        for (ray, hit) in out.iter().zip(engine.nearest(&out, order(random))) {
            let is_own = hit.is_some_and(|hit| hit.instance == 0);
            tally.count_ray(Correctness::wrong_if(is_own), ray, hit);
        }
        tally
    }))
}

/// Decimal exponents of a triangle's aspect ratio, length over height.
const ASPECTS: std::ops::RangeInclusive<i32> = 0..=6;
/// Number of triangles of each aspect ratio.
const TRIANGLES: usize = 16;

fn sliver_shadows(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let cells: Vec<i32> = ASPECTS
        .flat_map(|aspect| std::iter::repeat_n(aspect, TRIANGLES))
        .collect();
    trial.over_parts(cells.len(), &|number, trial| {
        let mut random = SplitMix64::new(0x19, number as u64);
        shadows_of_triangle(&trial, triangle(&mut random, 10f64.powi(cells[number])))
    })
}

/// Returns a triangle within a few units of the origin with that aspect ratio.
fn triangle(random: &mut SplitMix64, aspect: f64) -> [DVec3; 3] {
    let a = 2.0 * random.in_cube();
    let along = random.within(0.3, 1.0) * random.direction();
    let across = along.cross(random.direction()).normalize_or_zero() * along.length() / aspect;
    [a, a + along, a + random.unit() * along + across]
}

fn shadows_of_triangle(trial: &CaseRunner, corners: [DVec3; 3]) -> Result<Counts, AccelError> {
    let scene = scene(vec![Geometry::Mesh(mesh(&corners, vec![[0, 1, 2]]))]);
    let engine = trial.engine(&scene)?;
    let departures = SpawnProbe::new(&scene);
    let [a, b, c] = corners;
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        // Aim at random points of the triangle, from all directions
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                let (u, v) = (random.unit(), random.unit());
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let target = a + u * (b - a) + v * (c - a);
                towards(target + random.within(1.0, 3.0) * random.direction(), target)
            })
            .collect();
        // Spawn rays outward; any hit is a self-intersection
        let spawned_rays = spawned_rays(trial, (&engine, &departures), &rays, random, outward_direction);
        let out: Vec<Ray> = spawned_rays.iter().map(|&(_, ray)| ray).collect();
        let mut tally = Counts::default();
        for (ray, hit) in out.iter().zip(engine.nearest(&out, order(random))) {
            tally.count_ray(Correctness::wrong_if(hit.is_some()), ray, hit);
        }
        tally
    }))
}

/// Largest gap that is tested, in ulps.
const GAPS: u32 = 64;
/// Gap in ulps beyond which no ray may start on the far side of the next surface.
const RESOLVED: u32 = 8;

/// Returns a scene of two parallel squares about (1, 1, 1.5), `gap` ulps of their z coordinate apart.
fn parallel_squares(gap: u32) -> Scene {
    const HEIGHT: f32 = 1.5;
    let above = f32::from_bits(HEIGHT.to_bits() + gap);
    let square = |z: f32| {
        let at = |x: f32, y: f32| Vec3::new(x, y, z).as_dvec3();
        let corners = [at(0.5, 0.5), at(1.5, 0.5), at(1.5, 1.5), at(0.5, 1.5)];
        Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]))
    };
    scene(vec![square(HEIGHT), square(above)])
}

fn smallest_gap(trial: &CaseRunner) -> Result<Counts, AccelError> {
    trial.over_parts(GAPS as usize, &|number, trial| {
        let gap = 1 + number as u32;
        let scene = parallel_squares(gap);
        let engine = trial.engine(&scene)?;
        let departures = SpawnProbe::new(&scene);
        let task =
            |random: &mut SplitMix64, count| across(&trial, (&engine, &departures), gap, random, count);
        Ok(trial.trace_in_chunks(&engine, &task))
    })
}

/// Traces rays from below to the lower square, spawns rays there that continue upward, and counts those that miss the
/// upper square.
fn across(
    trial: &CaseRunner,
    (engine, departures): (&Engine, &SpawnProbe),
    gap: u32,
    random: &mut SplitMix64,
    count: usize,
) -> Counts {
    // Aim at the lower square from below
    let rays: Vec<Ray> = (0..count)
        .map(|_| {
            let mut inner = || random.within(0.7, 1.3);
            let target = DVec3::new(inner(), inner(), 1.5);
            towards(
                target + DVec3::new(random.within(-0.5, 0.5), random.within(-0.5, 0.5), -1.0),
                target,
            )
        })
        .collect();
    let spawned_rays = spawned_rays(trial, (engine, departures), &rays, random, |_, random| {
        // Continue above the lower square, steeply enough to hit the upper one
        let way = DVec3::new(random.within(-0.5, 0.5), random.within(-0.5, 0.5), 1.0);
        Some(way)
    });
    // Spawn on the far side of the lower square, by flipping the normal
    let up: Vec<Ray> = spawned_rays
        .iter()
        .map(|(at, ray)| {
            let through = SpawnPoint { ng: -at.ng, ..*at };
            spawn_ray(trial, &through, ray.direction.as_dvec3())
        })
        .collect();
    // Count shadow rays that miss the upper square
    let mut tally = Counts::default();
    for (ray, is_blocked) in up.iter().zip(engine.blocked(&up, order(random))) {
        if !is_blocked {
            tally.record_error(f64::from(gap));
        }
        let correctness = match (is_blocked, gap > RESOLVED) {
            (true, _) => Correctness::Right,
            (false, false) => Correctness::Tie,
            (false, true) => Correctness::Wrong,
        };
        tally.figure_data.keep(TracedRay {
            ray: *ray,
            hit: None,
            correctness,
        });
        tally.count(correctness, || {
            format!("{gap} ulp apart, {}", describe(ray, None))
        });
    }
    tally
}
