//! Tests of sample patterns, filters and adaptive sampling on complete images.
//!
//! The measurements that justify the defaults are in the slow tier: `tests/ci/slow sampling --nocapture`.

use crate::support::images;
use std::path::PathBuf;

use crate::support::image_error::{Comparison, Judge};
use crate::support::sampling_scenes::{self, scenes};
use crate::support::scene_folder;
use clap::ValueEnum;
use whit::accel::{self, AccelOptions, Backend};
use whit::render::{
    Adaptive, EdgeContrast, Exposure, FilterKind, Pattern, PixelFilter, RenderSettings, Rendering,
};
use whit::scene::Scene;

const SIZE: (u32, u32) = (96, 72);
/// Side of the references' sample grids: 45² and 45 · 46 samples.
const REFERENCE_SIDE: u32 = 45;

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

/// Returns the settings with a uniform number of samples per pixel.
fn uniform(settings: RenderSettings) -> RenderSettings {
    RenderSettings {
        adaptive: None,
        ..settings
    }
}

fn rendered(scene: &Scene, settings: RenderSettings) -> Rendering {
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    images::rendered_with(scene, &*accel, &settings)
}

/// Returns all bits of an image and of its sample counts.
fn bits(rendering: &Rendering) -> Vec<u32> {
    let aovs = rendering
        .aovs
        .iter()
        .flat_map(|a| a.samples.iter().chain(&a.variance));
    let values = rendering.image.pixels.as_flattened().iter().chain(aovs);
    values.map(|value| value.to_bits()).collect()
}

#[test]
fn sampling_bits_do_not_depend_on_thread_count() {
    let scene = sampling_scenes::mirrored_spheres();
    let filtered = |kind| RenderSettings {
        filter: PixelFilter::of_kind(kind),
        pattern: Pattern::Jittered,
        ..settings(5)
    };
    // Collect settings: every filter, every pattern, adaptive sampling, and contrast
    let mut variants: Vec<RenderSettings> = FilterKind::value_variants()
        .iter()
        .copied()
        .map(filtered)
        .collect();
    variants.extend(Pattern::value_variants().iter().map(|&pattern| RenderSettings {
        pattern,
        ..settings(3)
    }));
    for pattern in [Pattern::R2, Pattern::Jittered, Pattern::Sobol] {
        variants.push(RenderSettings {
            pattern,
            ..adaptive(0.01, 100)
        });
    }
    variants.push(RenderSettings {
        edge_contrast: Some(EdgeContrast {
            limit: 0.03,
            exposure: Exposure::Automatic,
        }),
        ..settings(16)
    });
    // Compare the bits for several numbers of threads
    for settings in variants {
        let settings = RenderSettings {
            sample_aovs: true,
            ..settings
        };
        let mut first = None;
        for threads in [1, 2, 7] {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            let bits = bits(&pool.install(|| rendered(&scene, settings)));
            assert!(
                *first.get_or_insert_with(|| bits.clone()) == bits,
                "{threads} threads, {settings:?}"
            );
        }
    }
}

#[test]
fn sample_counts_stay_between_minimum_and_maximum() {
    for spp in [17, 40, 100] {
        let settings = RenderSettings {
            sample_aovs: true,
            ..adaptive(0.004, spp)
        };
        let rendering = rendered(&sampling_scenes::mirrored_spheres(), settings);
        let counts = rendering.aovs.unwrap().samples;
        let whole_rounds = |count: f32| count % 16.0 == 0.0 || count == spp as f32;
        assert!(
            counts
                .iter()
                .all(|&count| (16.0..=spp as f32).contains(&count) && whole_rounds(count))
        );
        let total: f64 = counts.iter().copied().map(f64::from).sum();
        assert_eq!(rendering.samples.total as f64, total);
        assert_eq!(rendering.ledger.camera_rays(), rendering.samples.total);
        assert_eq!(rendering.samples.max, spp);
        let mean = total / counts.len() as f64;
        assert!((rendering.samples.mean - mean).abs() < 1e-9 && mean > 16.0 && mean < f64::from(spp));
    }
}

#[test]
fn ray_width_pilot_samples_are_few_and_deterministic() {
    let is_sought = |file: &PathBuf| file.ends_with("lecture_lighting.toml");
    let filed = scene_folder::load(&scene_folder::files().into_iter().find(is_sought).unwrap());
    let settings = RenderSettings {
        spp: 256,
        adaptive: adaptive(0.01, 256).adaptive,
        sample_aovs: true,
        ..filed.settings(48, 1)
    };
    let mut first = None;
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let rendering = pool.install(|| rendered(&filed.scene, settings));
        // A sixty-fourth of the pixels, or a few more where blocks are cropped, at most four times sixteen.
        let blocks = u64::from(settings.width.div_ceil(8) * settings.height.div_ceil(8));
        let more = rendering.ledger.camera_rays() - rendering.samples.total;
        assert!(
            more > 0 && more % (16 * blocks) == 0 && more <= 4 * 16 * blocks,
            "{more}"
        );
        assert!(rendering.samples.mean > 16.0 && rendering.samples.mean < 256.0);
        let bits = bits(&rendering);
        assert!(
            *first.get_or_insert_with(|| bits.clone()) == bits,
            "{threads} threads"
        );
    }
}

#[test]
fn image_without_edges_gets_the_minimum_samples() {
    let mut scene = sampling_scenes::mostly_empty();
    // Move the camera in front of all spheres.
    scene.cameras[0].world_from_camera.translation.z = -9.0;
    let rendering = rendered(&scene, adaptive(1e-6, 1024));
    assert_eq!((rendering.samples.mean, rendering.samples.max), (16.0, 16));
    assert!(rendering.image.pixels.iter().all(|&pixel| pixel == scene.ambient));
}

#[test]
fn sixteen_or_fewer_samples_are_not_adaptive() {
    let scene = sampling_scenes::mirrored_spheres();
    for spp in [1, 5, 16] {
        let uniform = rendered(&scene, settings(spp)).image;
        assert_eq!(rendered(&scene, adaptive(0.01, spp)).image, uniform);
    }
}

#[test]
fn sample_channels_do_not_change_image_bits() {
    let scene = sampling_scenes::mirrored_spheres();
    for settings in [settings(1), settings(5), settings(33), adaptive(0.01, 48)] {
        let plain = rendered(&scene, settings);
        assert!(plain.aovs.is_none());
        let with_channels = rendered(
            &scene,
            RenderSettings {
                sample_aovs: true,
                ..settings
            },
        );
        assert_eq!(plain.image, with_channels.image);
        assert_eq!(plain.samples, with_channels.samples);
    }
}

#[test]
fn constant_image_stays_constant_under_every_filter_and_pattern() {
    let mut scene = sampling_scenes::mostly_empty();
    scene.cameras[0].world_from_camera.translation.z = -9.0;
    for kind in FilterKind::value_variants() {
        for pattern in Pattern::value_variants() {
            let filter = PixelFilter::of_kind(*kind);
            let settings = RenderSettings {
                filter,
                pattern: *pattern,
                ..settings(6)
            };
            for pixel in rendered(&scene, settings).image.pixels {
                for channel in 0..3 {
                    // The mean in f64 is constant to 1e-12 (see the filters' own tests); one rounding to f32 remains.
                    let relative = f64::from(pixel[channel]) / f64::from(scene.ambient[channel]) - 1.0;
                    assert!(relative.abs() < 1.2e-7, "{kind:?} {pattern:?} {pixel:?}");
                }
            }
        }
    }
}

#[test]
fn adaptive_sampling_needs_two_fifths_of_samples_with_few_edges() {
    for scene in [
        sampling_scenes::mostly_empty(),
        sampling_scenes::mirrored_spheres(),
    ] {
        let sobol = RenderSettings {
            pattern: Pattern::Sobol,
            ..adaptive(0.005, 256)
        };
        let mut judge = Judge::new(&scene, Backend::Bsp, uniform(sobol), 22);
        let Comparison {
            samples: mean,
            error,
            uniform,
            ..
        } = judge.compare(sobol);
        println!("{mean:.1} samples a pixel, error {error:.5}, as of {uniform:.1} uniform ones");
        assert!(mean <= SAVING * uniform);
    }
}

#[test]
fn adaptive_sampling_has_no_overhead_without_savings() {
    for scene in [sampling_scenes::noise(), sampling_scenes::dust()] {
        let sobol = RenderSettings {
            width: 32,
            height: 24,
            pattern: Pattern::Sobol,
            ..adaptive(0.005, 256)
        };
        let mut judge = Judge::new(&scene, Backend::Bsp, uniform(sobol), 24);
        let Comparison {
            samples: mean,
            error,
            uniform,
            ..
        } = judge.compare(sobol);
        println!("{mean:.1} samples a pixel, error {error:.5}, as of {uniform:.1} uniform ones");
        assert!(mean <= COST * uniform);
    }
}

#[test]
#[ignore = "slow: a measurement of some minutes"]
fn print_errors_of_sampling_patterns() {
    println!("sRGB error in thousandths; jittered references of 4095 samples together");
    for (name, scene) in scenes() {
        let judge = Judge::new(&scene, Backend::Bsp, settings(1), REFERENCE_SIDE);
        for spp in [4, 16, 64, 256] {
            print!("{name:17} {spp:4} spp:");
            for pattern in Pattern::value_variants() {
                let settings = RenderSettings {
                    pattern: *pattern,
                    ..settings(spp)
                };
                let error = judge.error(&judge.rendered(settings).image)[0];
                print!("  {pattern:?} {:.3}", 1e3 * error);
            }
            println!();
        }
    }
}

/// Returns all scenes for measurements of adaptive sampling, with their settings for Sobol points.
fn measured_scenes() -> Vec<(String, Scene, RenderSettings)> {
    let mut all: Vec<_> = scenes()
        .into_iter()
        .map(|(name, scene)| (name.to_owned(), scene, settings(1)))
        .collect();
    for file in scene_folder::files() {
        let filed = scene_folder::load(&file);
        // This scene is in the list already.
        if filed.name != "first_light" {
            let settings = filed.settings(SIZE.0, 1);
            all.push((filed.name, filed.scene, settings));
        }
    }
    for (_, _, settings) in &mut all {
        settings.pattern = Pattern::Sobol;
    }
    all
}

/// Upper bound on the samples of adaptive sampling relative to uniform sampling of equal error, on scenes that are
/// mostly smooth, with a target of about one 8-bit code.
const SAVING: f64 = 0.4;
/// Upper bound on the relative number of samples, on any scene, with any target.
const COST: f64 = 1.05;
/// Largest relative uncertainty of a squared error that is evaluated. Highlights in repeated mirrors, brighter than a
/// thousand samples of white, make images whose error no reference can measure.
const MAX_UNCERTAINTY: f64 = 0.1;
/// Error targets: two and a half 8-bit codes, slightly more than one, less than one.
const TARGETS: [f64; 3] = [0.01, 0.005, 0.0025];

#[test]
#[ignore = "slow: a measurement of some minutes"]
fn adaptive_sampling_takes_fewer_samples_for_the_same_error() {
    let (mut savings, mut misses) = (0, Vec::new());
    // The variable selects scenes by name, separated by commas.
    let some = std::env::var("WHIT_SCENES").ok();
    let scenes = measured_scenes();
    let is_measured = |name: &str| {
        some.as_ref()
            .is_none_or(|some| some.split(',').any(|one| one == name))
    };
    // Measure each scene and target
    for (name, scene, settings) in scenes.iter().filter(|(name, ..)| is_measured(name)) {
        let mut judge = Judge::new(scene, Backend::default(), *settings, REFERENCE_SIDE);
        let mut ratios = Vec::new();
        for error in TARGETS {
            let Comparison {
                samples,
                error: found,
                uncertainty,
                uniform,
            } = judge.compare(RenderSettings {
                adaptive: Some(Adaptive { error, gain: 1.0 }),
                spp: 1024,
                ..*settings
            });
            let ratio = samples / uniform;
            println!(
                "{name:20} target {error:<6}: {samples:5.1} samples a pixel, sRGB error {:.3} thousandths (its square to \
                 {:.1} %), as of {uniform:.1} uniform ones: {ratio:.2}",
                1e3 * found,
                1e2 * uncertainty,
            );
            // Skip errors that the references cannot measure
            if !(uncertainty < MAX_UNCERTAINTY) {
                println!("    which the references cannot measure");
                ratios.push(f64::NAN);
                continue;
            }
            if ratio > COST {
                misses.push((name, error, ratio));
            }
            ratios.push(ratio);
        }
        savings += usize::from(ratios[1] <= SAVING);
    }
    println!("{savings} scenes at {SAVING} or less");
    assert!(misses.is_empty(), "{misses:?}");
    assert!(savings >= 3 || some.is_some(), "{savings} scenes");
}
