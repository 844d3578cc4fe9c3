//! Determinism of whole images: bit-identical for any number of threads.

use std::collections::HashSet;

use glam::{DAffine3, DVec3};

use crate::accel::{Accel, AccelError};
use crate::parallel;
use crate::render::{Monitor, RenderSettings, render};
use crate::scene::{Background, Camera, Geometry, Instance, Light, LightKind, Scene, ValidScene};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::test_meshes::{icosphere, scene};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

pub(in crate::verify::cases) const CASES: &[Case] = &[Case {
    id: "H44",
    title: "threads",
    construction: "an image of mirrors and shadows, rendered by 1, 2, 3 and 8 threads, twice each",
    oracle: "the image rendered by one thread",
    bound: "the same bits in every pixel",
    run: threads,
    ..Case::TRIANGLES
}];

/// Smallest number of colours of the image, to rule out an empty one.
const MIN_COLORS: usize = 256;
/// Width and height of the image in pixels.
const SIZE: u32 = 48;

/// Returns a scene of a mesh and a sphere over a cube, with a directional light and a gradient background.
fn image_scene() -> Scene {
    let ball = Sphere {
        center: DVec3::new(1.2, 0.5, -4.0),
        radius: 0.8,
    };
    let shape = |shape| Geometry::Shape(shape);
    let mut scene = scene(vec![
        Geometry::Mesh(icosphere(3)),
        shape(Shape::Sphere(ball)),
        shape(Shape::Cube),
    ]);
    // Place the objects in front of the default camera
    let places = [
        DAffine3::from_translation(DVec3::new(-1.0, 0.0, -5.0)),
        DAffine3::IDENTITY,
        DAffine3::from_translation(DVec3::new(0.0, -5.0, -5.0)) * DAffine3::from_scale(DVec3::splat(4.0)),
    ];
    scene.instances = places
        .into_iter()
        .zip(0..)
        .filter_map(|(place, geometry)| Instance::new("", geometry, 0, place).ok())
        .collect();
    // Add light, so that there are shadow rays and mirror rays
    scene.lights = vec![Light {
        name: "sun".into(),
        intensity: [3.0; 3],
        kind: LightKind::Directional {
            to_light: DVec3::new(0.48, 0.8, 0.36),
        },
    }];
    scene.background = Background::Gradient {
        horizon: [0.6, 0.5, 0.4],
        up: [0.1, 0.2, 0.7],
        down: [0.05; 3],
    };
    scene.ambient = [0.1; 3];
    scene
}

/// Renders an image with that number of threads and returns the bits of all pixels.
fn bits(scene: &Scene, accel: &dyn Accel, thread_count: usize) -> Option<Vec<[u32; 3]>> {
    let settings = RenderSettings {
        width: SIZE,
        height: SIZE,
        spp: 4,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(thread_count)
        .build()
        .ok()?;
    let rendering = parallel::install(&pool, || {
        render(
            ValidScene::assume(scene),
            &Camera::default(),
            accel,
            &settings,
            &monitor,
        )
    })
    .ok()?;
    Some(
        rendering
            .image
            .pixels
            .iter()
            .map(|pixel| pixel.map(f32::to_bits))
            .collect(),
    )
}

fn threads(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let scene = image_scene();
    let mut tally = Counts::default();
    let mut first = None;
    for thread_count in [1, 1, 2, 2, 3, 3, 8, 8] {
        // Rebuild the structure, because it may depend on the threads that built it
        let accel = (trial.subject.build)(&scene)?;
        let Some(bits) = bits(&scene, &*accel, thread_count) else {
            continue;
        };
        let first = first.get_or_insert_with(|| bits.clone());
        // Check that the image is not empty
        let looks: HashSet<_> = bits.iter().collect();
        if looks.len() < MIN_COLORS {
            tally.count(Correctness::Wrong, || {
                format!("the image has {} colours", looks.len())
            });
        }
        // Compare all pixels with the first image
        for (pixel, (was, is)) in first.iter().zip(&bits).enumerate() {
            tally.count(Correctness::wrong_if(was != is), || {
                format!("pixel {pixel}, rendered by {thread_count} threads")
            });
        }
    }
    if trial.draws_scenes() {
        tally.figure_data.draw(&scene);
    }
    Ok(tally)
}
