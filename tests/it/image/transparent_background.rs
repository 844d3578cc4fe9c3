//! Tests of the background that camera rays see: coverage of pixels, and images before another background.

use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::LoadOptions;
use whit::render::{AovKind, FilterKind, Monitor, Parts, PixelFilter, Region, RenderSettings, Rendering};
use whit::scene::Scene;
use whit::scene::image_settings::VisibleBackground;
use whit::scene_file;

use crate::support::images::{rendered, settings};
use crate::support::scene_folder;

/// Returns the scene of a scene file with this text.
fn scene(text: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, text).unwrap();
    scene_file::load(&path, &LoadOptions::default()).unwrap().scene
}

/// Sphere that fills the middle of the image, lit and before a bright background, which must not matter.
const SPHERE: &str = "
background = 3
camera = { from = [0, 0, 4], at = [0, 0, 0], fov = 40 }
light = [{ kind = \"directional\", direction = [-1, -1, -2], intensity = 2 }]
object = [{ shape = \"sphere\" }]
";

/// Panes of glass paint and a mirror, one behind the other, with and without a gap before the background.
const PANES: &str = "
background = { horizon = [0.9, 0.5, 0.2], up = [0.1, 0.3, 0.9] }
ambient = 0.3
camera = { from = [0, 0, 4], at = [0, 0, 0], fov = 60 }
light = [{ kind = \"directional\", direction = [-1, -1, -2], intensity = 2 }]
object = [
    { shape = \"quad\", material = \"red\", transform = [{ translate = [0.3, 0, 1] }] },
    { shape = \"quad\", material = \"blue\", transform = [{ translate = [-0.3, 0.4, 0] }] },
    { shape = \"sphere\", material = \"mirror\", transform = [{ translate = [0, -0.8, -2] }] },
]
[material]
red = { base_color = [0.8, 0.1, 0.1, 0.35], alpha = \"blend\" }
blue = { base_color = [0.1, 0.1, 0.8, 0.6], alpha = \"blend\" }
mirror = { base_color = 0.9, metallic = 1, roughness = 0 }
";

fn with_background(background: VisibleBackground, settings: RenderSettings) -> RenderSettings {
    RenderSettings {
        background,
        ..settings
    }
}

fn show(scene: &Scene, background: VisibleBackground, settings: RenderSettings) -> Rendering {
    rendered(scene, &scene.cameras[0], &with_background(background, settings))
}

/// Returns settings with every filter.
fn all_filters(size: u32, spp: u32) -> impl Iterator<Item = RenderSettings> {
    let kinds = [FilterKind::Box, FilterKind::Gaussian, FilterKind::Mitchell];
    kinds.into_iter().map(move |kind| RenderSettings {
        filter: PixelFilter::of_kind(kind),
        ..settings(size, spp)
    })
}

#[test]
fn coverage_of_a_sphere_is_that_of_its_silhouette() {
    let lit = scene(SPHERE);
    // The same sphere in black before white shows 1 minus the coverage
    let mut black = lit.clone();
    black.lights.clear();
    for settings in all_filters(50, 16) {
        let image = show(&lit, VisibleBackground::Transparent, settings);
        let alpha = image.alpha.unwrap();
        let silhouette = show(&black, VisibleBackground::Color([1.0; 3]), settings);
        assert!(silhouette.alpha.is_none());
        for (alpha, white) in alpha.iter().zip(&silhouette.image.pixels) {
            // Sums of filter weights in f64, each rounded to f32 once.
            let difference = (1.0 - alpha - white[0]).abs();
            assert!(difference <= 2.0 * f32::EPSILON, "{alpha} {white:?}");
        }
        // The corner is empty, the middle is full, and the edge is between
        let (corner, middle) = (0, 25 * 50 + 25);
        assert_eq!((alpha[corner], image.image.pixels[corner]), (0.0, [0.0; 3]));
        assert_eq!(alpha[middle], 1.0);
        let between = alpha.iter().filter(|alpha| (0.1..0.9).contains(*alpha)).count();
        assert!(between > 40, "{between}");
    }
}

#[test]
fn coverage_equals_that_of_cryptomatte() {
    let lit = scene(SPHERE);
    let settings = RenderSettings {
        layers: [AovKind::CryptoObject].into_iter().collect(),
        ..settings(50, 16)
    };
    let image = show(&lit, VisibleBackground::Transparent, settings);
    let is_coverage = |layer: &&whit::render::Layer| layer.name == "CryptoObject00.G";
    let coverage = image.layers.iter().find(is_coverage).unwrap();
    assert_eq!(&coverage.values, image.alpha.as_ref().unwrap());
}

#[test]
fn premultiplied_colours_before_a_background_are_the_opaque_image() {
    let panes = scene(PANES);
    let color = [0.25, 2.0, 0.7];
    for settings in all_filters(60, 4) {
        let clear = show(&panes, VisibleBackground::Transparent, settings);
        let opaque = show(&panes, VisibleBackground::Color(color), settings);
        let alpha = clear.alpha.unwrap();
        for ((premultiplied, opaque), alpha) in
            clear.image.pixels.iter().zip(&opaque.image.pixels).zip(&alpha)
        {
            for channel in 0..3 {
                let behind = (1.0 - alpha) * color[channel];
                let difference = (premultiplied[channel] + behind - opaque[channel]).abs();
                // Some roundings to f32 of values up to 2.
                assert!(difference < 2e-6, "{premultiplied:?} {alpha} {opaque:?}");
            }
        }
        // One pane of 0.35, two of 0.35 and 0.6, and the mirror cover that much
        let plain = settings.filter.kind == FilterKind::Box;
        for wanted in [0.0, 0.35, 1.0 - 0.65 * 0.4, 1.0] {
            let count = alpha
                .iter()
                .filter(|&alpha| (alpha - wanted).abs() < 1e-6)
                .count();
            assert!(!plain || count > 20, "{wanted}: {count}");
        }
    }
}

#[test]
fn mirrors_and_lighting_keep_the_background_of_the_scene() {
    let panes = scene(PANES);
    let settings = settings(60, 4);
    let usual = show(&panes, VisibleBackground::Environment, settings);
    let clear = show(&panes, VisibleBackground::Transparent, settings);
    let colored = show(&panes, VisibleBackground::Color([9.0; 3]), settings);
    let alpha = clear.alpha.unwrap();
    let covered: Vec<usize> = (0..alpha.len()).filter(|&pixel| alpha[pixel] == 1.0).collect();
    assert!(covered.len() > 100, "{}", covered.len());
    for pixel in covered {
        assert_eq!(clear.image.pixels[pixel], usual.image.pixels[pixel]);
        assert_eq!(colored.image.pixels[pixel], usual.image.pixels[pixel]);
    }
    // Before the scene's own background as a colour, the image is the usual one
    let mut plain = panes.clone();
    plain.background = whit::scene::Background::Uniform([0.2, 0.4, 0.6]);
    let usual = show(&plain, VisibleBackground::Environment, settings);
    let same = show(&plain, VisibleBackground::Color([0.2, 0.4, 0.6]), settings);
    for (a, b) in usual.image.pixels.iter().zip(&same.image.pixels) {
        // Background and surfaces are added to the sum in another order.
        (0..3).for_each(|channel| assert!((a[channel] - b[channel]).abs() < 1e-6, "{a:?} {b:?}"));
    }
}

#[test]
fn parts_have_the_coverage_of_the_whole_image() {
    let foliage = scene_folder::named("foliage.toml").scene;
    let valid = foliage.validate().unwrap();
    let accel = accel::build(valid, Backend::Bsp, &AccelOptions::default()).unwrap();
    for settings in all_filters(70, 2) {
        let settings = with_background(VisibleBackground::Transparent, settings);
        let whole = rendered(&foliage, &foliage.cameras[0], &settings);
        let camera = (valid, &foliage.cameras[0]);
        let mut parts = Parts::new(camera, &*accel, &settings, &Monitor::default()).unwrap();
        let alpha = whole.alpha.unwrap();
        for [y, height] in [[0, 32], [30, 3], [69, 1]] {
            let region = Region::of_rows(&settings, y..y + height);
            let part = parts.region(&region, &Monitor::default()).unwrap();
            let rows = 70 * y as usize..70 * (y + height) as usize;
            assert_eq!(part.alpha.unwrap(), alpha[rows]);
        }
        assert!(alpha.iter().any(|&alpha| alpha < 0.5) && alpha.iter().any(|&alpha| alpha > 0.5));
    }
}
