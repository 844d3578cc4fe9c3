//! Comparison of backends with each other, on camera, shadow and bounced rays in scenes of all kinds.

use glam::DVec3;

use super::slivers::compared;
use super::spawned::{leave, outward};
use super::trial::{Answer, Engine, Tally, Trial, describe, embree_identity, order};
use super::worlds::{self, world};
use super::{Asks, Case, Closes};
use crate::accel::hit_compare::{HitComparison, compare_occlusion};
use crate::accel::{self, AccelError, AccelOptions, Backend};
use crate::numeric::{Ray, SplitMix64};
use crate::render::{Departure, Departures};
use crate::scene::Scene;

pub(super) const CASES: &[Case] = &[Case {
    id: "H34",
    title: "against each other",
    construction: "twelve scenes of meshes, shapes, slivers, copies and motion: camera, shadow and bounced rays",
    oracle: "the BSP for Embree; for the BSP brute force, with one ray in 64; what differs by the bounds on f32 a tie",
    bound: "no wrong hit, miss or shadow",
    unit: "",
    asks: Asks::Triangles,
    required: Closes::Edges,
    run: against_each_other,
}];

/// Number of rays for each one that is traced by brute force.
const SHARE: usize = 64;

fn against_each_other(trial: &Trial) -> Result<Tally, AccelError> {
    // Choose the reference: the BSP for Embree, brute force for the BSP
    let is_embree = embree_identity(trial.subject)?.is_some();
    let (referee, share) = if is_embree {
        (Backend::Bsp, 1)
    } else {
        (Backend::Brute, SHARE)
    };
    // Compare the backends on each scene
    trial.over_parts(worlds::COUNT, &|number, trial| {
        let scene = world(number);
        let options = AccelOptions {
            threads: rayon::current_num_threads(),
            ..AccelOptions::default()
        };
        let referee = Engine::of(accel::build(&scene, referee, &options)?, &scene);
        compare(&trial.part(0, share), &scene, &referee)
    })
}

fn compare(trial: &Trial, scene: &Scene, referee: &Engine) -> Result<Tally, AccelError> {
    // Build the backend under test
    let engine = trial.engine(scene)?;
    let departures = Departures::new(scene);
    let bounds = scene.bounds();
    let (center, reach) = (bounds.center(), 0.5 * bounds.extent().length());
    let moves = scene.instances.iter().any(|instance| instance.is_moving());
    // Trace camera rays, at random times if anything moves
    let tally = trial.in_chunks(&|random, count| {
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
        let engines = [&engine, referee];
        let mut tally = nearest(scene, engines, &camera, random);
        // Find the points where they hit surfaces
        let packets = engine.traced(&camera, order(random));
        let met: Vec<Option<Departure>> = packets.iter().flat_map(|packet| departures.of(packet)).collect();
        let left = camera
            .iter()
            .zip(met)
            .filter_map(|(ray, at)| Some((ray.time, at?)));
        // Spawn a shadow ray and a bounced ray from each
        let (mut shadows, mut bounced) = (Vec::new(), Vec::new());
        let lamp = center + reach * DVec3::new(0.3, 0.5, 0.9);
        for (time, at) in left {
            let to_lamp = leave(trial, &at, lamp - at.p);
            shadows.push(Ray {
                t_far: 1.0,
                time,
                ..to_lamp
            });
            if let Some(way) = outward(&at, random) {
                let ray = leave(trial, &at, way);
                bounced.push(Ray { time, ..ray });
            }
        }
        // Trace both kinds
        tally = tally.with(nearest(scene, engines, &bounced, random));
        tally.with(blocked(scene, engines, &shadows, random))
    });
    Ok(trial.with_drawing(&engine, tally))
}

fn nearest(scene: &Scene, engines: [&Engine; 2], rays: &[Ray], random: &mut SplitMix64) -> Tally {
    // Trace the rays in independent random orders
    let [found, expected] = engines.map(|engine| engine.nearest(rays, order(random)));
    let mut tally = Tally::default();
    for (i, ray) in rays.iter().enumerate() {
        let answer = compared(scene, ray, expected[i], found[i]);
        tally.count_ray(answer, ray, found[i]);
    }
    tally
}

fn blocked(scene: &Scene, engines: [&Engine; 2], rays: &[Ray], random: &mut SplitMix64) -> Tally {
    // Trace the rays in independent random orders
    let [found, expected] = engines.map(|engine| engine.blocked(rays, order(random)));
    let mut tally = Tally::default();
    for (i, ray) in rays.iter().enumerate() {
        let answer = match compare_occlusion(scene, ray, expected[i], found[i]) {
            HitComparison::Same => Answer::Right,
            HitComparison::Tie => Answer::Tie,
            HitComparison::Wrong => Answer::Wrong,
        };
        tally.count(answer, || format!("shadow {}", describe(ray, None)));
    }
    tally
}
