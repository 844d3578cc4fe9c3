//! Self-intersection of rays spawned on instanced shapes that are translated, rotated, mirrored and stretched.

use glam::{DAffine3, DQuat, DVec3};

use super::self_intersection::{outward_direction, spawn_ray};
use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{SpawnPoint, SpawnProbe};
use crate::scene::Scene;
use crate::verify::harness::test_meshes::{convex_solids, placed};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, TracedRay, describe, order, towards};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H21",
        title: "leaving outward",
        construction: "convex solids up to 10^4 sizes away, or up to 10^2 and stretched up to 10^4 to 1: rays at them, and away again",
        oracle: "a ray at a point well inside hits; a ray that leaves a convex solid outward never hits it again",
        bound: "no hit missed, 0 false self-hits",
        run: |trial| spawn_and_trace(trial, Way::Outward),
        ..Case::SHAPES
    },
    Case {
        id: "H22",
        title: "leaving inward",
        construction: "the same solids, and rays that go on into them from where they were hit",
        oracle: "a ray into a solid, well away from its edges, hits it again",
        bound: "0 rays lost inside",
        run: |trial| spawn_and_trace(trial, Way::Inward),
        ..Case::SHAPES
    },
];

#[derive(Clone, Copy, PartialEq)]
enum Way {
    Outward,
    Inward,
}

/// Number of transforms for each solid.
const PLACEMENTS: usize = 24;

fn placement(random: &mut SplitMix64) -> DAffine3 {
    let size = 10f64.powf(random.within(-4.0, 4.0));
    let mut stretch = || 10f64.powf(random.within(-2.0, 2.0)) * random.choose(&[1.0, -1.0]);
    let scale = match size.to_bits() % 3 {
        0 => DVec3::ONE,
        _ => DVec3::new(stretch(), stretch(), stretch()),
    };
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    // Limit the distance of stretched solids: one thinner than an f32 step there cannot be entered.
    let farthest = if scale == DVec3::ONE { 1e4 } else { 1e2 };
    let far = random.choose(&[0.0, 1.0, farthest]) * size * random.direction();
    DAffine3::from_scale_rotation_translation(size * scale, turn, far)
}

fn spawn_and_trace(trial: &CaseRunner, way: Way) -> Result<Counts, AccelError> {
    let solids = convex_solids();
    trial.over_parts(solids.len() * PLACEMENTS, &|number, trial| {
        let shape = solids[number / PLACEMENTS].clone();
        let map = placement(&mut SplitMix64::new(0x91ace, number as u64));
        let Some(scene) = placed(shape, map) else {
            return Ok(Counts::default());
        };
        spawn_and_trace_instance(&trial, &scene, &map, way)
    })
}

fn spawn_and_trace_instance(
    trial: &CaseRunner,
    scene: &Scene,
    map: &DAffine3,
    way: Way,
) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let departures = SpawnProbe::new(scene);
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        // Aim at a point well inside the solid
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                // Choose the origin in object space, so that stretched solids are hit from all sides
                let origin = map.transform_point3(6.0 * random.direction());
                let target = map.transform_point3(0.25 / 3f64.sqrt() * random.in_cube());
                towards(origin, target)
            })
            .collect();
        let mut tally = Counts::default();
        let packets = engine.traced(&rays, order(random));
        let hit_points: Vec<Option<SpawnPoint>> =
            packets.iter().flat_map(|packet| departures.of(packet)).collect();
        let mut on = Vec::new();
        // Count a miss as wrong, else spawn a ray
        for (ray, at) in rays.iter().zip(&hit_points) {
            let Some(at) = at else {
                tally.figure_data.keep(TracedRay {
                    ray: *ray,
                    hit: None,
                    correctness: Correctness::Wrong,
                });
                tally.count(Correctness::Wrong, || format!("missed: {}", describe(ray, None)));
                continue;
            };
            let Some(direction) = outward_direction(at, random) else {
                continue;
            };
            let through = SpawnPoint { ng: -at.ng, ..*at };
            on.push(match way {
                Way::Outward => spawn_ray(trial, at, direction),
                // Continue straight, which is well inside
                Way::Inward => spawn_ray(trial, &through, ray.direction.as_dvec3()),
            });
        }
        // Outward rays must be unoccluded, inward rays occluded
        for (ray, is_blocked) in on.iter().zip(engine.blocked(&on, order(random))) {
            let is_wrong = is_blocked == (way == Way::Outward);
            tally.count_ray(Correctness::wrong_if(is_wrong), ray, None);
        }
        tally
    }))
}
