//! Tests of the bound on the error of truncated paths, against the actual error of the image.
//!
//! In a white environment every path has a radiance of 1, so that a clear sphere is darker by exactly the truncated
//! throughput.

use crate::support::images;
use std::fs;

use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::{Adaptive, RenderSettings, Rendering};
use whit::scene_file;

/// Renders a sphere with these material lines in a white environment.
fn seen(material: &str, settings: &RenderSettings) -> Rendering {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ball.toml");
    let text = format!(
        "background = 1\n[camera]\nfrom = [0, 0, 4]\nat = [0, 0, 0]\n[material.m]\n{material}\n\
         [[object]]\nshape = 'sphere'\nmaterial = 'm'\n"
    );
    fs::write(&path, text).unwrap();
    let scene = scene_file::load(&path, &LoadOptions::default()).unwrap().scene;
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    images::rendered_with(&scene, &*accel, settings)
}

/// Returns the maximum and the mean deficit of an image from 1.
fn lacking(rendering: &Rendering) -> [f64; 2] {
    let pixels = rendering.image.pixels.iter();
    let lacks: Vec<f64> = pixels.map(|p| 1.0 - f64::from(p[1])).collect();
    let mean = lacks.iter().sum::<f64>() / lacks.len() as f64;
    [lacks.iter().copied().fold(0.0, f64::max), mean]
}

const GLASS: &str = "transmission = 1\nroughness = 0\nior = 1.5";

/// Tolerance for sums of a hundred throughputs and of their products in f32.
const ROUNDING: f64 = 1e-5;

#[test]
fn worst_pixel_loss_equals_the_reported_bound() {
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
        let reported = (
            ledger.max_lost_weight,
            ledger.lost_weight / rendering.samples.total as f64,
        );
        assert!(
            (reported.0 - most).abs() <= ROUNDING,
            "{depth}: {reported:?}, not {most}"
        );
        assert!(
            (reported.1 - mean).abs() <= ROUNDING,
            "{depth}: {reported:?}, not {mean}"
        );
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
fn adaptive_sampling_keeps_loss_within_the_bound() {
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
    let reported = rendering.ledger.max_lost_weight;
    assert!(
        most > 0.01 && most <= reported + ROUNDING && reported <= 2.0 * most,
        "{reported} for {most}"
    );
}

#[test]
fn loss_is_zero_without_truncated_rays() {
    let settings = RenderSettings {
        width: 16,
        height: 16,
        ..RenderSettings::default()
    };
    let ledger = seen("roughness = 1", &settings).ledger;
    assert_eq!((ledger.lost_rays, ledger.max_lost_weight), (0, 0.0));
}
