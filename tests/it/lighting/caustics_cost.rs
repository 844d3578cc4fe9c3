//! Noise and bias of photons as `whit cost` reports them, against those to the closed form of a ring's caustic.

use std::f64::consts::PI;

use serde_json::Value;
use whit::gltf::LoadOptions;
use whit::image::LinearImage;
use whit::render::RenderSettings;
use whit::scene::Scene;
use whit::scene_file;

use super::caustics::{SIDE, displayed, thrown_by_ring};
use crate::cost::studies::study_of;
use crate::support::images::{rendered, settings};

/// Half of a ring of radius 1 that mirrors, on a white floor, with light of irradiance 1 on the floor at an elevation of 45
/// degrees; seen from below everything.
const RING: &str = r#"
background = 0
caustics = { photons = 65536 }

[output]
size = [64, 64]
spp = 4
exposure = -0.67

[camera]
from = [0.25, 0, 0.001]
at = [0.25, 0, 0]
up = [0, 1, 0]
height = 1

[[light]]
name = "sun"
kind = "directional"
direction = [1, 0, -1]
intensity = 1.41421356237

[material.floor]
base_color = 1
specular = 0

[material.mirror]
model = "metallic-roughness"
metallic = 1
roughness = 0
base_color = 1

[[object]]
name = "floor"
shape = "plane"
material = "floor"

[[object]]
name = "ring"
shape = { quadric = { coefficients = [1, 0, 0, 0, 1, 0, 0, 0, 0, -1], min = [0, -1, 0], max = [1, 1, 2] } }
material = "mirror"
"#;
/// Width and height of the images.
const PIXELS: usize = 64;
/// Stops of exposure in [`RING`].
const EXPOSURE: f64 = -0.67;
/// Number of images whose mean is compared with the closed form.
const IMAGES: u32 = 12;

/// Returns the displayed value of a radiance at the exposure of [`RING`].
fn exposed(radiance: f64) -> f64 {
    displayed(EXPOSURE.exp2() * radiance)
}

/// Returns the closed form's displayed values.
fn closed_form() -> Vec<f64> {
    let fine = thrown_by_ring([0.25, 0.5]);
    // Average the pixels of the finer image
    let block = SIDE / PIXELS;
    let mean = |index: usize| {
        let (row, column) = (index / PIXELS * block, index % PIXELS * block);
        let rows = (row..row + block).map(|row| fine[row * SIDE + column..][..block].iter().sum::<f64>());
        rows.sum::<f64>() / (block * block) as f64
    };
    (0..PIXELS * PIXELS)
        .map(|index| exposed((1.0 + mean(index)) / PI))
        .collect()
}

/// Squared bias to the closed form, and variance of an image, as means over the pixels.
struct Errors {
    squared_bias: f64,
    variance: f64,
}

/// Renders images with these numbers of photons and of samples per pixel, and compares them with the closed form.
fn errors_to(exact: &[f64], scene: &Scene, [photons, samples]: [u32; 2]) -> Errors {
    let mut scene = scene.clone();
    if let Some(caustics) = &mut scene.caustics {
        caustics.photons = photons;
    }
    // Sum up the displayed values and their squares
    let (mut sums, mut squares) = (vec![0.0; exact.len()], vec![0.0; exact.len()]);
    for seed in 0..IMAGES {
        let settings = RenderSettings {
            seed,
            ..settings(PIXELS as u32, samples)
        };
        let image: LinearImage = rendered(&scene, &scene.cameras[0], &settings).image;
        for (index, pixel) in image.pixels.iter().enumerate() {
            let value = exposed(f64::from(pixel[1]));
            sums[index] += value;
            squares[index] += value * value;
        }
    }
    // Separate the bias of the mean from its noise
    let (images, pixels) = (f64::from(IMAGES), exact.len() as f64);
    let (mut of_mean, mut variance) = (0.0, 0.0);
    for (index, exact) in exact.iter().enumerate() {
        let mean = sums[index] / images;
        of_mean += (mean - exact).powi(2) / pixels;
        variance += (squares[index] - images * mean * mean) / (images - 1.0) / pixels;
    }
    Errors {
        squared_bias: of_mean - variance / images,
        variance,
    }
}

#[test]
fn study_of_a_ring_has_the_noise_and_the_bias_of_photons_to_the_closed_form() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ring.toml");
    std::fs::write(&file, RING).unwrap();
    let scene = scene_file::load(&file, &LoadOptions::default()).unwrap().scene;
    let exact = closed_form();
    let study = study_of(
        file.to_str().unwrap(),
        ["64x64", "12"],
        &folder.path().join("study"),
    );
    // The reference has four times the scene's photons, and a bias of its own
    let of_reference = errors_to(&exact, &scene, [4 * 65536, 4]).squared_bias.sqrt();
    let mut biases = Vec::new();
    for point in study["points"].as_array().unwrap() {
        if point["knob"] != "photons" {
            continue;
        }
        let [photons, samples] =
            ["photons", "samples"].map(|key| point["settings"][key].as_str().unwrap().parse().unwrap());
        let number = |value: &Value| value.as_f64().unwrap();
        let found = Errors {
            squared_bias: number(&point["bias_squared"]["value"]),
            variance: number(&point["variance"]),
        };
        let expected = errors_to(&exact, &scene, [photons, samples]);
        let [bias, noise] = [found.squared_bias, found.variance].map(f64::sqrt);
        let [exact_bias, exact_noise] = [expected.squared_bias, expected.variance].map(f64::sqrt);
        println!(
            "{photons} photons: bias {bias:.4}, to the closed form {exact_bias:.4} ± {of_reference:.4}; noise {noise:.4}, {exact_noise:.4}"
        );
        // Two biases differ by that of the reference at most, but for the noise of few images
        let tolerance = of_reference + 0.1 * exact_bias;
        assert!((bias - exact_bias).abs() <= tolerance, "{photons} photons: bias");
        assert!(
            (noise / exact_noise - 1.0).abs() <= 0.2,
            "{photons} photons: noise"
        );
        biases.push(bias);
    }
    assert!(biases.len() == 3 && biases[0] > 2.0 * biases[2], "{biases:?}");
}
