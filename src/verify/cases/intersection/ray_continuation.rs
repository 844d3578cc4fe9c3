//! Continuation of rays straight through several surfaces: no surface may be hit twice or skipped.

use glam::{DAffine3, DVec3, Vec3};

use super::self_intersection::spawn_ray;
use crate::accel::{AccelError, Hit, LANES, RayPacket};
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{SpawnPoint, SpawnProbe};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::test_meshes::{icosphere, mesh, scene, soup};
use crate::verify::harness::{
    Case, CaseRunner, Correctness, Counts, Engine, Watertightness, describe, order, towards,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H48g",
        title: "ray continuation",
        construction: "LuxCore #308: rays through eight surfaces 10 to 10^12 away, 32 ulp apart; then between two ends",
        oracle: "each surface is hit once, in order, then none; t lies between the ends",
        bound: "no surface hit twice or skipped",
        required: Watertightness::Edges,
        run: through_surfaces,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48h",
        title: "self-hits by scale",
        construction: "trimesh #48: triangles of size 1 to 10^5, rays along their normals from where they were hit",
        oracle: "a ray that leaves a triangle does not hit it",
        bound: "0 self-hits",
        run: along_normals,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48i",
        title: "ball in a shell",
        construction: "Mitsuba 3 #1871: spheres of radius 1 and 1 + 4e-5, and two such meshes, rays through both",
        oracle: "the outer, the inner, the inner, the outer",
        bound: "none hit twice or skipped",
        required: Watertightness::Edges,
        run: through_shells,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48j",
        title: "box above a floor",
        construction: "POV-Ray #125: a cube 7e-7 above a plane, rays through the cube's bottom",
        oracle: "the cube, the cube, the plane",
        bound: "none hit twice or skipped",
        run: box_above_a_floor,
        ..Case::SHAPES
    },
];

/// Limit on the number of surfaces; it exceeds those of all cases, so that reaching it reveals a ray that makes no
/// progress.
const MAX_SURFACES: usize = 12;

/// Returns the instances that each ray hits one after the other when it continues straight, up to [`MAX_SURFACES`].
fn continuation_hits(
    trial: &CaseRunner,
    (engine, departures): (&Engine, &SpawnProbe),
    rays: &[Ray],
    random: &mut SplitMix64,
) -> Vec<Vec<u32>> {
    let mut visited = vec![Vec::new(); rays.len()];
    let mut active_rays: Vec<(usize, Ray)> = rays.iter().copied().enumerate().collect();
    for _ in 0..MAX_SURFACES {
        // Trace the rays that have not left the scene
        let packets_to_trace: Vec<Ray> = active_rays.iter().map(|&(_, ray)| ray).collect();
        let packets = engine.traced(&packets_to_trace, order(random));
        let at = packets.iter().flat_map(|packet| departures.of(packet));
        let mut next = Vec::with_capacity(active_rays.len());
        // Record the hit, and spawn a ray on the far side
        for ((&(number, ray), at), hit) in active_rays.iter().zip(at).zip(hits(&packets)) {
            let (Some(at), Some(hit)) = (at, hit) else {
                continue;
            };
            visited[number].push(hit.instance);
            let through = SpawnPoint { ng: -at.ng, ..at };
            next.push((number, spawn_ray(trial, &through, ray.direction.as_dvec3())));
        }
        active_rays = next;
    }
    visited
}

/// Returns the hits of all lanes of the packets.
fn hits(packets: &[RayPacket]) -> impl Iterator<Item = Option<Hit>> {
    packets
        .iter()
        .flat_map(|packet| (0..LANES).map(|lane| packet.hit(lane)))
}

/// Counts the rays whose sequence of hit instances differs from `expected`.
fn expect(
    trial: &CaseRunner,
    scene: &Scene,
    ray: impl Fn(&mut SplitMix64) -> Ray + Sync,
    expected: &[u32],
) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let departures = SpawnProbe::new(scene);
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        // A ray costs one query a surface and a final one that misses.
        let rays: Vec<Ray> = (0..count.div_ceil(expected.len() + 1))
            .map(|_| ray(random))
            .collect();
        let mut tally = Counts::default();
        let visited = continuation_hits(trial, (&engine, &departures), &rays, random);
        for (ray, visited) in rays.iter().zip(visited) {
            tally.count(Correctness::wrong_if(visited != expected), || {
                format!("{}, then {visited:?}", describe(ray, None))
            });
        }
        tally
    }))
}

/// Distances of the first square from the origin.
const DISTANCES: [f64; 6] = [10.0, 1e3, 1e5, 1e7, 1e9, 1e12];
/// Number of parallel squares.
const SQUARES: u32 = 8;
/// Gap between neighbouring squares in ulps of f32, four times the guaranteed resolution.
const GAP: u32 = 32;

/// Returns parallel squares across the z axis, whose distance is half their width.
fn parallel_squares(distance: f64) -> Scene {
    let square = |number: u32| {
        let z = f32::from_bits((distance as f32).to_bits() + GAP * number);
        let at = |x: f64, y: f64| DVec3::new(x * distance, y * distance, f64::from(z));
        let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
        Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]))
    };
    scene((0..SQUARES).map(square).collect())
}

fn through_surfaces(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let expected: Vec<u32> = (0..SQUARES).collect();
    trial.over_parts(DISTANCES.len(), &|number, trial| {
        let distance = DISTANCES[number];
        let scene = parallel_squares(distance);
        let ray = |random: &mut SplitMix64| {
            let mut aside = || random.within(-0.4, 0.4);
            let direction = DVec3::new(aside(), aside(), 1.0);
            Ray::new((0.1 * distance * random.in_cube()).as_vec3(), direction.as_vec3())
        };
        let tally = expect(&trial.part(0, 2), &scene, ray, &expected)?;
        Ok(tally.with(between_ends(&trial.part(1, 2), &scene, distance)?))
    })
}

/// Traces rays whose interval ends at, before or behind a square, and counts hits outside the interval.
fn between_ends(trial: &CaseRunner, scene: &Scene, distance: f64) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let ray = |random: &mut SplitMix64| {
        let mut end = || {
            let steps = random.below((GAP * (SQUARES + 2)) as usize) as u32;
            f32::from_bits((distance as f32).to_bits() - GAP + steps)
        };
        let (a, b) = (end(), end());
        let mut aside = || random.within(-0.4, 0.4) as f32;
        Ray {
            t_near: a.min(b),
            t_far: a.max(b),
            ..Ray::new(Vec3::ZERO, Vec3::new(aside(), aside(), 1.0))
        }
    };
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        let is_between = |hit: Hit| ray.t_near <= hit.t && hit.t <= ray.t_far;
        Correctness::wrong_if(hit.is_some_and(|hit| !is_between(hit)))
    }))
}

/// Decimal exponents of the triangles' size.
const SCALES: std::ops::RangeInclusive<i32> = 0..=5;
/// Number of triangles of each size.
const TRIANGLES: usize = 64;

/// Returns triangles of a size in a grid about the origin, ten sizes apart.
fn triangles(size: f64) -> Mesh {
    let mut random = SplitMix64::new(48, size.to_bits());
    let triangle = |number: usize| {
        let cell = DVec3::new((number % 4) as f64, (number / 4 % 4) as f64, (number / 16) as f64);
        let place = 10.0 * (cell - DVec3::splat(1.5));
        [0; 3].map(|_| size * (place + random.in_cube()))
    };
    soup(&(0..TRIANGLES).map(triangle).collect::<Vec<_>>())
}

fn along_normals(trial: &CaseRunner) -> Result<Counts, AccelError> {
    trial.over_parts(SCALES.count(), &|number, trial| {
        let size = 10f64.powi(SCALES.start() + number as i32);
        let mesh = triangles(size);
        let scene = scene(vec![Geometry::Mesh(mesh.clone())]);
        along_normals_of(&trial, &scene, &mesh)
    })
}

fn along_normals_of(trial: &CaseRunner, scene: &Scene, mesh: &Mesh) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let departures = SpawnProbe::new(scene);
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        // Hit the triangles
        let rays: Vec<Ray> = (0..count).map(|_| at_a_triangle(mesh, random)).collect();
        let packets = engine.traced(&rays, order(random));
        let departing = packets.iter().flat_map(|packet| departures.of(packet));
        // Spawn rays along their normals
        let left: Vec<(Hit, Ray)> = departing
            .zip(hits(&packets))
            .filter_map(|(at, hit)| at.zip(hit))
            .map(|(at, hit)| (hit, spawn_ray(trial, &at, at.ng)))
            .collect();
        let away: Vec<Ray> = left.iter().map(|&(_, ray)| ray).collect();
        // Count hits on the triangle that a ray leaves
        let mut tally = Counts::default();
        for ((own, ray), hit) in left.iter().zip(engine.nearest(&away, order(random))) {
            let is_own = hit.is_some_and(|hit| hit.primitive == own.primitive);
            tally.count_ray(Correctness::wrong_if(is_own), ray, hit);
        }
        tally
    }))
}

/// Returns a ray at the centroid of a triangle, from two edge lengths away.
fn at_a_triangle(mesh: &Mesh, random: &mut SplitMix64) -> Ray {
    let [a, b, c] = mesh.corners_f64(random.below(mesh.triangles.len()) as u32);
    let middle = (a + b + c) / 3.0;
    towards(middle + 2.0 * a.distance(b) * random.direction(), middle)
}

/// Gap between the spheres from the bug report, in radii.
const SHELL: f64 = 4e-5;

fn through_shells(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Build concentric spheres, analytic and tessellated
    let ball = |radius| {
        let center = DVec3::ZERO;
        Geometry::Shape(Shape::Sphere(Sphere { center, radius }))
    };
    let faceted = |radius: f64| {
        let mut mesh = icosphere(4);
        let grown = mesh.positions.iter().map(|&p| {
            let p = radius * Vec3::from(p).as_dvec3();
            p.as_vec3().to_array()
        });
        mesh.positions = grown.collect::<Vec<_>>().into();
        Geometry::Mesh(mesh)
    };
    let scenes = [
        scene(vec![ball(1.0 + SHELL), ball(1.0)]),
        scene(vec![faceted(1.0 + SHELL), faceted(1.0)]),
    ];
    let ray = |random: &mut SplitMix64| {
        let origin = 3.0 * random.direction();
        // Aim at most 0.9 radii beside the centre
        towards(origin, 0.9 / 3f64.sqrt() * random.in_cube())
    };
    trial.over_parts(scenes.len(), &|number, trial| {
        expect(&trial, &scenes[number], ray, &[0, 1, 1, 0])
    })
}

fn box_above_a_floor(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mut scene = scene(vec![Geometry::Shape(Shape::Cube)]);
    scene.geometries.push(Geometry::Shape(Shape::Plane));
    // Use the height from the bug report, which the following version of POV-Ray could not resolve
    let floor = DAffine3::from_translation(DVec3::new(0.0, -1.000_000_7, 0.0)) * upright();
    scene.instances.extend(Instance::new("floor", 1, 0, floor));
    let ray = |random: &mut SplitMix64| {
        let mut inner = || random.within(-0.95, 0.95);
        let target = DVec3::new(inner(), -1.0, inner());
        towards(DVec3::new(1.0, 2.0, 3.0), target)
    };
    expect(trial, &scene, ray, &[0, 0, 1])
}

/// Returns the rotation from the plane's object space to one where +y is its normal.
fn upright() -> DAffine3 {
    DAffine3::from_rotation_x(-std::f64::consts::FRAC_PI_2)
}
