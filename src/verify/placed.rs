//! Self-intersection of rays spawned on instanced shapes that are translated, rotated, mirrored and stretched.

use glam::{DAffine3, DQuat, DVec3};

use super::meshes::convex_solids;
use super::sketch::Asked;
use super::spawned::{leave, outward};
use super::trial::{Answer, Tally, Trial, describe, order};
use super::{Asks, Case, Closes};
use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::render::{Departure, Departures};
use crate::scene::{Geometry, Instance, Material, Scene};

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H21",
        title: "leaving outward",
        construction: "convex solids up to 10^4 sizes away, or up to 10^2 and stretched up to 10^4 to 1: rays at them, and away again",
        oracle: "a ray at a point well inside hits; what leaves a convex solid outward never meets it again",
        bound: "no hit missed, 0 false self-hits",
        unit: "",
        asks: Asks::Shapes,
        required: Closes::Faces,
        run: |trial| leaving(trial, Way::Outward),
    },
    Case {
        id: "H22",
        title: "leaving inward",
        construction: "the same solids, and rays that go on into them from where they were hit",
        oracle: "what goes into a solid, well away from its edges, meets it again",
        bound: "0 rays lost inside",
        unit: "",
        asks: Asks::Shapes,
        required: Closes::Faces,
        run: |trial| leaving(trial, Way::Inward),
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
    let mut stretch = || 10f64.powf(random.within(-2.0, 2.0)) * random.pick(&[1.0, -1.0]);
    let scale = match size.to_bits() % 3 {
        0 => DVec3::ONE,
        _ => DVec3::new(stretch(), stretch(), stretch()),
    };
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    // Limit the distance of stretched solids: one thinner than an f32 step there cannot be entered.
    let farthest = if scale == DVec3::ONE { 1e4 } else { 1e2 };
    let far = random.pick(&[0.0, 1.0, farthest]) * size * random.direction();
    DAffine3::from_scale_rotation_translation(size * scale, turn, far)
}

fn leaving(trial: &Trial, way: Way) -> Result<Tally, AccelError> {
    let solids = convex_solids();
    trial.over_parts(solids.len() * PLACEMENTS, &|number, trial| {
        let shape = solids[number / PLACEMENTS].clone();
        let map = placement(&mut SplitMix64::new(0x91ace, number as u64));
        let Ok(instance) = Instance::new("", 0, 0, map) else {
            return Ok(Tally::default());
        };
        let scene = Scene {
            geometries: vec![Geometry::Shape(shape)],
            instances: vec![instance],
            materials: vec![Material::default()],
            ..Scene::default()
        };
        leaving_of(&trial, &scene, &map, way)
    })
}

fn leaving_of(trial: &Trial, scene: &Scene, map: &DAffine3, way: Way) -> Result<Tally, AccelError> {
    let engine = trial.engine(scene)?;
    let departures = Departures::new(scene);
    let tally = trial.in_chunks(&|random, count| {
        // Aim at a point well inside the solid
        let rays: Vec<Ray> = (0..count)
            .map(|_| {
                // Choose the origin in object space, so that stretched solids are hit from all sides
                let origin = map.transform_point3(6.0 * random.direction()).as_vec3();
                let target = map.transform_point3(0.25 / 3f64.sqrt() * random.in_cube());
                Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
            })
            .collect();
        let mut tally = Tally::default();
        let packets = engine.traced(&rays, order(random));
        let met: Vec<Option<Departure>> = packets.iter().flat_map(|packet| departures.of(packet)).collect();
        let mut on = Vec::new();
        // Count a miss as wrong, else spawn a ray
        for (ray, at) in rays.iter().zip(&met) {
            let Some(at) = at else {
                tally.sketch.keep(Asked {
                    ray: *ray,
                    hit: None,
                    answer: Answer::Wrong,
                });
                tally.count(Answer::Wrong, || format!("missed: {}", describe(ray, None)));
                continue;
            };
            let Some(direction) = outward(at, random) else {
                continue;
            };
            let through = Departure { ng: -at.ng, ..*at };
            on.push(match way {
                Way::Outward => leave(trial, at, direction),
                // Continue straight, which is well inside
                Way::Inward => leave(trial, &through, ray.direction.as_dvec3()),
            });
        }
        // Outward rays must be unoccluded, inward rays occluded
        for (ray, is_blocked) in on.iter().zip(engine.blocked(&on, order(random))) {
            let is_wrong = is_blocked == (way == Way::Outward);
            tally.count_ray(Answer::wrong_if(is_wrong), ray, None);
        }
        tally
    });
    Ok(trial.with_drawing(&engine, tally))
}
