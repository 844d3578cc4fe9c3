//! Regression tests for past bugs that no other case covers: rays with very short and very long directions, and
//! instanced meshes traced by whole packets. Embree's own instances, which only the variant `fast` uses, miss some of
//! these hits.

use glam::{DAffine3, DQuat, DVec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{Cone, Shape, Sphere, Torus};
use crate::verify::harness::test_meshes::{icosphere, rings, scene};
use crate::verify::harness::{
    Case, CaseRunner, Correctness, Counts, Engine, Watertightness, describe, judge_against, order,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H48",
    title: "regressions of whit",
    construction: "meshes and shapes, instanced and not, rays with directions of length 2^-80 to 2^59, for hits and \
        for shadows",
    oracle: "the same ray with a direction of length about one; a shadow ray is occluded exactly if the ray has a hit",
    bound: "the same hit, its t times the power of two",
    required: Watertightness::Edges,
    run: any_length,
    ..Case::TRIANGLES
}];

/// Binary exponents of the lengths of directions.
const EXPONENTS: [i32; 12] = [-80, -70, -62, -60, -59, -40, -20, -1, 1, 20, 40, 59];

/// Returns a scene of meshes and shapes, each once with the identity transform and three times rotated and scaled.
pub(in crate::verify::cases) fn mixed_scene() -> Scene {
    let center = DVec3::new(3.0, 0.0, 0.0);
    let ball = Sphere { center, radius: 1.0 };
    let mut scene = scene(vec![
        Geometry::Mesh(icosphere(3)),
        Geometry::Mesh(rings(12, -center, |theta, _| 1.0 + 0.1 * (6.0 * theta).sin())),
        Geometry::Shape(Shape::Sphere(ball)),
    ]);
    // Add analytic shapes
    let placed = [
        Shape::Cube,
        Shape::Cone(Cone { capped: true }),
        Shape::Torus(Torus { minor_radius: 0.3 }),
    ];
    scene.geometries.extend(placed.map(Geometry::Shape));
    // Instance each geometry with random, partly mirroring, transforms
    for number in 0..18u32 {
        let mut random = SplitMix64::new(0x48, number.into());
        let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
        let scale = DVec3::new(
            random.within(0.3, 1.0),
            random.within(0.3, 1.0),
            random.within(-1.0, -0.3),
        );
        let place = DAffine3::from_scale_rotation_translation(scale, turn, 6.0 * random.in_cube());
        scene.instances.extend(Instance::new("", number % 6, 0, place));
    }
    scene
}

fn any_length(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let scene = mixed_scene();
    let engine = trial.engine(&scene)?;
    Ok(trial.trace_in_chunks(&engine, &|random, count| {
        compare_lengths(&scene, &engine, random, count)
    }))
}

/// Traces pairs of rays that differ only by the length of their directions, and counts the differences.
fn compare_lengths(scene: &Scene, engine: &Engine, random: &mut SplitMix64, count: usize) -> Counts {
    // Generate pairs of rays whose directions differ by a power of two
    let plain: Vec<Ray> = (0..count.div_ceil(3)).map(|_| ray(random)).collect();
    let factors: Vec<f32> = plain
        .iter()
        .map(|_| 2f32.powi(random.choose(&EXPONENTS)))
        .collect();
    let scaled: Vec<Ray> = plain
        .iter()
        .zip(&factors)
        .map(|(ray, &factor)| Ray::new(ray.origin, factor * ray.direction))
        .collect();
    // Trace both, and the scaled ones as shadow rays
    let expected = engine.nearest(&plain, order(random));
    let found = engine.nearest(&scaled, order(random));
    let blocked = engine.blocked(&scaled, order(random));
    let mut tally = Counts::default();
    // Compare the hits of each pair
    for i in 0..plain.len() {
        // Rescale t to that of the plain ray
        let hit = found[i].map(|hit| Hit {
            t: hit.t * factors[i],
            ..hit
        });
        let correctness = match (expected[i], hit) {
            (Some(a), Some(b)) if (a.instance, a.primitive) == (b.instance, b.primitive) && a.t == b.t => {
                Correctness::Right
            }
            (None, None) => Correctness::Right,
            // Embree is free to choose between two triangles that the ray hits at equal distance.
            (expected, hit) => match judge_against(scene, &plain[i], expected, hit) {
                Correctness::Wrong => Correctness::Wrong,
                _ => Correctness::Tie,
            },
        };
        // Count the nearest hit, and the shadow ray against it
        tally.count_ray(correctness, &scaled[i], found[i]);
        let is_wrong = blocked[i] != found[i].is_some() && correctness == Correctness::Right;
        tally.count(Correctness::wrong_if(is_wrong), || {
            format!("shadow {}", describe(&scaled[i], found[i]))
        });
    }
    tally
}

/// Returns a random ray with a direction of length 1 to 2.
fn ray(random: &mut SplitMix64) -> Ray {
    let direction = random.within(1.0, 2.0) * random.direction();
    Ray::new((8.0 * random.in_cube()).as_vec3(), direction.as_vec3())
}
