//! What patterns, filters and adaptive sampling promise, on whole pictures.
//!
//! The measurements that defaults rest on are ignored tests: `cargo test --release --test sampling -- --ignored
//! --nocapture`.

#[path = "common"]
mod common {
    #![allow(dead_code, unreachable_pub, reason = "this program uses a part of it")]

    pub mod meshes;
    pub mod sampling_scenes;
    pub mod wave_scenes;
}

use std::sync::atomic::AtomicBool;

use clap::ValueEnum;
use common::sampling_scenes::{self, scenes};
use whit::accel::{self, AccelOptions, Backend};
use whit::image::LinearImage;
use whit::render::{Adaptive, FilterKind, Monitor, Pattern, PixelFilter, RenderSettings, Rendering, render};
use whit::scene::Scene;

const SIZE: (u32, u32) = (96, 72);

fn settings(spp: u32) -> RenderSettings {
    RenderSettings {
        width: SIZE.0,
        height: SIZE.1,
        spp,
        ..RenderSettings::default()
    }
}

fn adaptive(error: f64, spp: u32) -> RenderSettings {
    RenderSettings {
        adaptive: Some(Adaptive { error, gain: 1.0 }),
        ..settings(spp)
    }
}

fn rendered(scene: &Scene, settings: RenderSettings) -> Rendering {
    let accel = accel::build(scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
    };
    render(scene, &scene.cameras[0], &*accel, &settings, &monitor).unwrap()
}

/// Jittered, so that no sequence under test is a part of it.
fn reference(scene: &Scene, spp: u32) -> LinearImage {
    let settings = RenderSettings {
        pattern: Pattern::Jittered,
        ..settings(spp)
    };
    rendered(scene, settings).image
}

/// Root mean square difference of sRGB values, black 0 and white 1.
fn rmse(image: &LinearImage, reference: &LinearImage) -> f64 {
    let pairs = image
        .pixels
        .as_flattened()
        .iter()
        .zip(reference.pixels.as_flattened());
    let squares: f64 = pairs.map(|(a, b)| (srgb(*a) - srgb(*b)).powi(2)).sum();
    (squares / (3 * image.pixels.len()) as f64).sqrt()
}

fn srgb(radiance: f32) -> f64 {
    let radiance = f64::from(radiance).clamp(0.0, 1.0);
    if radiance <= 0.003_130_8 {
        12.92 * radiance
    } else {
        1.055 * radiance.powf(1.0 / 2.4) - 0.055
    }
}

#[test]
#[ignore = "a measurement of a minute"]
fn errors_of_the_patterns() {
    println!("sRGB error in thousandths; jittered reference of 4096 samples");
    for (name, scene) in scenes() {
        let reference = reference(&scene, 4096);
        for spp in [4, 16, 64, 256] {
            print!("{name:17} {spp:4} spp:");
            for pattern in Pattern::value_variants() {
                let settings = RenderSettings {
                    pattern: *pattern,
                    ..settings(spp)
                };
                let error = rmse(&rendered(&scene, settings).image, &reference);
                print!("  {pattern:?} {:.3}", 1e3 * error);
            }
            println!();
        }
    }
}

/// The uniform number of samples that has this error, by the power law between the measured ones.
fn equivalent_spp(curve: &[(f64, f64)], error: f64) -> f64 {
    let at = curve.windows(2).find(|pair| pair[1].1 <= error);
    let [(n0, e0), (n1, e1)] = at.map_or([curve[curve.len() - 2], curve[curve.len() - 1]], |p| [p[0], p[1]]);
    let slope = (n1 / n0).ln() / (e1 / e0).ln();
    n0 * ((error / e0).ln() * slope).exp()
}

#[test]
#[ignore = "a measurement of a few minutes"]
fn adaptive_sampling_takes_fewer_samples_for_the_same_error() {
    for pattern in [Pattern::Sobol, Pattern::R2] {
        let mut good = 0;
        for (name, scene) in scenes() {
            let reference = reference(&scene, 4096);
            let curve: Vec<(f64, f64)> = [16, 32, 64, 128, 256, 512]
                .into_iter()
                .map(|spp| {
                    let settings = RenderSettings {
                        pattern,
                        ..settings(spp)
                    };
                    (
                        f64::from(spp),
                        rmse(&rendered(&scene, settings).image, &reference),
                    )
                })
                .collect();
            print!("{name:17} uniform:");
            for (spp, error) in &curve {
                print!(" {spp} {:.3}", 1e3 * error);
            }
            println!();
            let mut best = f64::INFINITY;
            for spp in [256, 1024] {
                for error in [0.02, 0.01, 0.005] {
                    let settings = RenderSettings {
                        pattern,
                        ..adaptive(error, spp)
                    };
                    let rendering = rendered(&scene, settings);
                    let found = rmse(&rendering.image, &reference);
                    let uniform = equivalent_spp(&curve, found);
                    let ratio = rendering.samples.mean / uniform;
                    best = best.min(ratio);
                    println!(
                        "  {pattern:?} {name:17} {spp} target {error}: {:.1} samples a pixel, error {:.3}, as {uniform:.1} uniform: {ratio:.2}",
                        rendering.samples.mean,
                        1e3 * found
                    );
                }
            }
            good += usize::from(best <= 0.4);
        }
        println!("{good} scenes");
    }
}
