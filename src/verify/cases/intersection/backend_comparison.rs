//! Comparison of backends with each other, on camera, shadow and bounced rays in scenes of all kinds.

use glam::DVec3;

use super::self_intersection::{outward_direction, spawn_ray};
use crate::accel::hit_compare::compare_occlusion;
use crate::accel::{self, AccelError, AccelOptions, Backend};
use crate::numeric::{Ray, SplitMix64};
use crate::render::{SpawnPoint, SpawnProbe};
use crate::scene::{Scene, ValidScene};
use crate::verify::harness::test_scenes::{self, test_scene};
use crate::verify::harness::{
    Case, CaseRunner, Counts, Engine, Watertightness, describe, embree_identity, judge_against, order,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H34",
    title: "backend comparison",
    construction: "twelve scenes of meshes, shapes, slivers, instances and motion: camera, shadow and reflection rays",
    oracle: "the BSP checks Embree; brute force checks the BSP for one ray in 64; a difference within the f32 bounds \
        is a tie",
    bound: "no wrong hit, miss or occlusion",
    required: Watertightness::Edges,
    run: against_each_other,
    ..Case::TRIANGLES
}];

/// Number of rays for each one that is traced by brute force.
const SHARE: usize = 64;

fn against_each_other(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Choose the reference: the BSP for Embree, brute force for the BSP
    let is_embree = embree_identity(trial.subject)?.is_some();
    let (reference, share) = if is_embree {
        (Backend::Bsp, 1)
    } else {
        (Backend::Brute, SHARE)
    };
    // Compare the backends on each scene
    trial.over_parts(test_scenes::COUNT, &|number, trial| {
        let scene = test_scene(number);
        let options = AccelOptions {
            threads: rayon::current_num_threads(),
            ..AccelOptions::default()
        };
        let reference = Engine::of(
            accel::build(ValidScene::assume(&scene), reference, &options)?,
            &scene,
        );
        compare(&trial.part(0, share), &scene, &reference)
    })
}

fn compare(trial: &CaseRunner, scene: &Scene, reference: &Engine) -> Result<Counts, AccelError> {
    // Build the backend under test
    let engine = trial.engine(scene)?;
    let departures = SpawnProbe::new(scene);
    let bounds = scene.bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    let moves = scene.instances.iter().any(|instance| instance.is_moving());
    // Trace camera rays, at random times if anything moves
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        let camera: Vec<Ray> = (0..count.div_ceil(3))
            .map(|_| {
                let origin = (center + 1.5 * reach * random.direction()).as_vec3();
                let target = center + 0.5 * reach * random.in_cube();
                Ray {
                    time: if moves { random.unit() as f32 } else { 0.0 },
                    ..Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
                }
            })
            .collect();
        let engines = [&engine, reference];
        let mut tally = nearest(scene, engines, &camera, random);
        // Find the points where they hit surfaces
        let packets = engine.traced(&camera, order(random));
        let hit_points: Vec<Option<SpawnPoint>> =
            packets.iter().flat_map(|packet| departures.of(packet)).collect();
        let left = camera
            .iter()
            .zip(hit_points)
            .filter_map(|(ray, at)| Some((ray.time, at?)));
        // Spawn a shadow ray and a bounced ray from each
        let (mut shadows, mut bounced) = (Vec::new(), Vec::new());
        let light_position = center + reach * DVec3::new(0.3, 0.5, 0.9);
        for (time, at) in left {
            let shadow_ray = spawn_ray(trial, &at, light_position - at.p);
            shadows.push(Ray {
                t_far: 1.0,
                time,
                ..shadow_ray
            });
            if let Some(way) = outward_direction(&at, random) {
                let ray = spawn_ray(trial, &at, way);
                bounced.push(Ray { time, ..ray });
            }
        }
        // Trace both kinds
        tally = tally.with(nearest(scene, engines, &bounced, random));
        tally.with(blocked(scene, engines, &shadows, random))
    }))
}

fn nearest(scene: &Scene, engines: [&Engine; 2], rays: &[Ray], random: &mut SplitMix64) -> Counts {
    // Trace the rays in independent random orders
    let [found, expected] = engines.map(|engine| engine.nearest(rays, order(random)));
    let mut tally = Counts::default();
    for (i, ray) in rays.iter().enumerate() {
        let correctness = judge_against(scene, ray, expected[i], found[i]);
        tally.count_ray(correctness, ray, found[i]);
    }
    tally
}

fn blocked(scene: &Scene, engines: [&Engine; 2], rays: &[Ray], random: &mut SplitMix64) -> Counts {
    // Trace the rays in independent random orders
    let [found, expected] = engines.map(|engine| engine.blocked(rays, order(random)));
    let mut tally = Counts::default();
    for (i, ray) in rays.iter().enumerate() {
        let correctness = compare_occlusion(scene, ray, expected[i], found[i]).into();
        tally.count(correctness, || format!("shadow {}", describe(ray, None)));
    }
    tally
}
