//! The worst error of rays that were not followed, against what the picture really lacks.
//!
//! Before white surroundings every ray brings back 1, so a clear ball is as dark as the weights that were lost in it.

use std::fs;
use std::sync::atomic::AtomicBool;

use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::{Adaptive, Monitor, RenderSettings, Rendering, render};
use whit::scene_file;

/// What is seen of a ball of a material of these lines before white surroundings.
fn seen(material: &str, settings: &RenderSettings) -> Rendering {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ball.toml");
    let text = format!(
        "background = 1\n[camera]\nfrom = [0, 0, 4]\nat = [0, 0, 0]\n[material.m]\n{material}\n\
         [[object]]\nshape = 'sphere'\nmaterial = 'm'\n"
    );
    fs::write(&path, text).unwrap();
    let scene = scene_file::load(&path, &LoadOptions::default()).unwrap().scene;
    let accel = accel::build(&scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    render(&scene, &scene.cameras[0], &*accel, settings, &monitor).unwrap()
}

/// By how much a picture is darker than 1: the most and the mean.
fn lacking(rendering: &Rendering) -> [f64; 2] {
    let pixels = rendering.image.pixels.iter();
    let lacks: Vec<f64> = pixels.map(|p| 1.0 - f64::from(p[1])).collect();
    let mean = lacks.iter().sum::<f64>() / lacks.len() as f64;
    [lacks.iter().copied().fold(0.0, f64::max), mean]
}

const GLASS: &str = "transmission = 1\nroughness = 0\nior = 1.5";

/// Sums of a hundred weights and of their products in f32.
const ROUNDING: f64 = 1e-5;

#[test]
fn the_worst_pixel_lacks_what_is_booked_and_no_other_lacks_more() {
    for (depth, weight_cutoff, spp) in [(1, 0.0, 1), (3, 0.0, 4), (64, 0.05, 4), (4, 0.01, 9)] {
        let settings = RenderSettings {
            width: 45,
            height: 37,
            spp,
            depth,
            weight_cutoff,
            ..RenderSettings::default()
        };
        let rendering = seen(GLASS, &settings);
        let ledger = &rendering.ledger;
        let [most, mean] = lacking(&rendering);
        let told = (
            ledger.max_lost_weight,
            ledger.lost_weight / rendering.samples.total as f64,
        );
        assert!((told.0 - most).abs() <= ROUNDING, "{depth}: {told:?}, not {most}");
        assert!((told.1 - mean).abs() <= ROUNDING, "{depth}: {told:?}, not {mean}");
        assert!(most > 1e-3);
        let (by_depth, by_weight) = (ledger.depth_limit, ledger.weight_cutoff);
        assert_eq!(by_depth.rays + by_weight.rays, ledger.lost_rays);
        assert_eq!(
            (by_weight.rays == 0, by_depth.rays == 0),
            (weight_cutoff == 0.0, depth == 64)
        );
        assert!(by_depth.max_weight.max(by_weight.max_weight) <= ledger.max_lost_weight);
    }
}

#[test]
fn with_adaptive_sampling_no_pixel_lacks_more_than_is_told() {
    let settings = RenderSettings {
        width: 45,
        height: 37,
        spp: 256,
        depth: 2,
        weight_cutoff: 0.0,
        adaptive: Some(Adaptive {
            error: 0.002,
            gain: 1.0,
        }),
        ..RenderSettings::default()
    };
    let rendering = seen(GLASS, &settings);
    assert!(rendering.samples.max > 16, "some pixel takes several rounds");
    let [most, _] = lacking(&rendering);
    let told = rendering.ledger.max_lost_weight;
    assert!(
        most > 0.01 && most <= told + ROUNDING && told <= 2.0 * most,
        "{told} for {most}"
    );
}

#[test]
fn where_no_ray_is_cut_nothing_is_lacking() {
    let settings = RenderSettings {
        width: 16,
        height: 16,
        ..RenderSettings::default()
    };
    let ledger = seen("roughness = 1", &settings).ledger;
    assert_eq!((ledger.lost_rays, ledger.max_lost_weight), (0, 0.0));
}
