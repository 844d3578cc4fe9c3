//! Thin ellipsoids with aspect ratios of up to a million: hit points and normals.

use glam::{DAffine3, DMat3, DVec3};

use super::transforms::{Oracle, turn};
use crate::accel::{AccelError, Hit, RayPacket};
use crate::numeric::{Bounds, Ray, SplitMix64};
use crate::render::{SpawnPoint, SpawnProbe};
use crate::scene::Scene;
use crate::shape::{Quadric, Shape, Sphere};
use crate::verify::harness::test_meshes::placed;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, towards};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H08",
    title: "thin ellipsoids",
    construction: "ellipsoids with axes up to 10^6 to 1, as stretched spheres and as quadrics, turned, from all sides",
    oracle: "the map's inverse, the roots and the gradient to 90 bits",
    bound: "t to 1 ulp and normals to 10^-5 radians; ties are right for an ellipsoid moved by 16 roundings of f64 times the condition squared",
    unit: "of 10^-5 radians",
    run: thin,
    ..Case::SHAPES
}];

/// Number of ellipsoids, which share the rays equally.
const COUNT: usize = 64;
/// Binary exponent of the shortest axis: 2^-20 is just under 10^-6.
const MIN_POWER: usize = 20;
/// Largest admissible error of a normal in radians.
const TILT: f64 = 1e-5;

/// Returns an ellipsoid as a shape, the transform of its instance, and the map of the unit sphere to it.
fn ellipsoid(part: usize, random: &mut SplitMix64) -> (Shape, DAffine3, DAffine3) {
    let mut axis = || 0.5f64.powi(random.below(MIN_POWER + 1) as i32);
    // Give every fourth the largest aspect ratio
    let axes = match part % 4 {
        0 => DVec3::new(1.0, 0.5f64.powi(MIN_POWER as i32), axis()),
        _ => DVec3::new(axis(), 1.0, axis()),
    };
    let turn = DAffine3::from_mat3(turn(random));
    let stretched = turn * DAffine3::from_scale(axes);
    if part.is_multiple_of(2) {
        return (Shape::Sphere(Sphere::UNIT), stretched, stretched);
    }
    let mut q = [0.0; 10];
    // Squares of powers of two are exact.
    (q[0], q[4], q[7], q[9]) = (axes.x.powi(-2), axes.y.powi(-2), axes.z.powi(-2), -1.0);
    let clip = Bounds {
        min: -1.25 * axes,
        max: 1.25 * axes,
    };
    match Quadric::new(q, clip) {
        Ok(quadric) => (Shape::Quadric(quadric.into()), turn, stretched),
        Err(_) => (Shape::Sphere(Sphere::UNIT), stretched, stretched),
    }
}

fn thin(trial: &CaseRunner) -> Result<Counts, AccelError> {
    trial.over_parts(COUNT, &|number, trial| {
        let (shape, place, stretched) = ellipsoid(number, &mut SplitMix64::new(0x08, number as u64));
        let Some(scene) = placed(shape, place) else {
            return Ok(Counts::default());
        };
        thin_of(&trial, &scene, &stretched)
    })
}

fn thin_of(trial: &CaseRunner, scene: &Scene, stretched: &DAffine3) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let departures = SpawnProbe::new(scene);
    let oracle = Oracle::new(stretched);
    let judge = |ray: &Ray, hit: Option<Hit>, tally: &mut Counts| {
        // Judge the hit, then the normal of an exact hit
        let correctness = oracle.judge(ray, hit, &mut Counts::default());
        match hit {
            Some(hit) if correctness == Correctness::Right => {
                let mut packet = RayPacket::EMPTY;
                packet.set(0, ray);
                packet.set_hit(0, &hit);
                let [at, ..] = departures.of(&packet);
                at.map_or(Correctness::Wrong, |at| tilted(&oracle, ray, &at, tally))
            }
            _ => correctness,
        }
    };
    Ok(trial.nearest(&engine, &|random| at(&stretched.matrix3, random), &judge))
}

/// Returns a ray at an ellipsoid, from a distance in units of its axes or of the world.
fn at(map: &DMat3, random: &mut SplitMix64) -> Ray {
    let distance = 10f64.powf(random.within(0.1, 1.0)) * random.direction();
    let origin = random.choose(&[*map * distance, distance]);
    let target = *map * (random.unit().cbrt() * random.direction());
    towards(origin, target)
}

fn tilted(oracle: &Oracle, ray: &Ray, at: &SpawnPoint, tally: &mut Counts) -> Correctness {
    // The angle is undefined if the exact line misses
    let Some((angle, bound)) = oracle.tilt(ray, at.ng) else {
        return Correctness::Right;
    };
    tally.record_error(angle / TILT);
    if angle <= TILT {
        Correctness::Right
    } else {
        Correctness::tie_if(angle <= bound)
    }
}
