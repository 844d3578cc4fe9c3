//! Tests of supersampling by contrast: which pixels take all samples, and that every pixel has the bits of the image with
//! its number of samples.

use crate::support::images;
use crate::support::scene_folder;
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::render::{
    EdgeContrast, Exposure, FilterKind, Monitor, Parts, PixelFilter, Region, RenderSettings, Rendering,
    automatic_exposure,
};
use whit::scene::{Scene, image_settings::VisibleBackground};

/// Contrast limit of the tests.
const LIMIT: f64 = 0.03;

fn tree(scene: &Scene) -> Box<dyn Accel + '_> {
    accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap()
}

/// Returns settings in which neither side is a multiple of a tile's.
fn settings(spp: u32) -> RenderSettings {
    RenderSettings {
        width: 75,
        height: 101,
        spp,
        sample_aovs: true,
        ..RenderSettings::default()
    }
}

fn by_contrast(spp: u32, exposure: Exposure) -> RenderSettings {
    RenderSettings {
        edge_contrast: Some(EdgeContrast {
            limit: LIMIT,
            exposure,
        }),
        ..settings(spp)
    }
}

/// Returns the displayed value of a radiance by the curve of adaptive sampling, in f64.
fn displayed(radiance: f32, stops: f32) -> f64 {
    let shown = (f64::from(radiance) * f64::from(stops).exp2()).clamp(0.0, 1.0);
    let root = 0.0403f64;
    ((shown + root * root).sqrt() - root) * ((1.0 + root * root).sqrt() + root)
}

/// Returns the largest difference of each pixel from a neighbour, in any channel as displayed.
fn contrasts(image: &Rendering, stops: f32) -> Vec<f64> {
    let [width, height] = [image.image.width, image.image.height].map(|side| side as usize);
    let shown =
        |x: usize, y: usize, channel: usize| displayed(image.image.pixels[y * width + x][channel], stops);
    let contrast = |index: usize| {
        let (x, y) = (index % width, index / width);
        let mut greatest: f64 = 0.0;
        for other_y in y.saturating_sub(1)..(y + 2).min(height) {
            for other_x in x.saturating_sub(1)..(x + 2).min(width) {
                for channel in 0..3 {
                    let difference = shown(x, y, channel) - shown(other_x, other_y, channel);
                    greatest = greatest.max(difference.abs());
                }
            }
        }
        greatest
    };
    (0..width * height).map(contrast).collect()
}

#[test]
fn pixels_with_contrast_take_all_samples() {
    for (name, spp) in [
        ("whitted_1980.toml", 16),
        ("textured.toml", 20),
        ("mirror_room.toml", 5),
        ("soft_shadows.toml", 2),
    ] {
        let scene = scene_folder::named(name).scene;
        let accel = tree(&scene);
        let first = images::rendered_with(&scene, &*accel, &settings(1));
        let all = images::rendered_with(&scene, &*accel, &settings(spp));
        let stops = automatic_exposure(&first.image, None);
        let expected = contrasts(&first, stops);
        let mixed = images::rendered_with(&scene, &*accel, &by_contrast(spp, Exposure::Automatic));
        let counts = mixed.aovs.as_ref().unwrap();
        let mut edge_count = 0;
        for (index, &contrast) in expected.iter().enumerate() {
            // Packets of fewer samples than sixteen hold several pixels, which take them together
            let has_all = counts.samples[index] == spp as f32;
            assert!(has_all || counts.samples[index] == 1.0);
            if (contrast - LIMIT).abs() > 1e-4 {
                assert!(has_all || contrast < LIMIT, "{name} {index}: {contrast}");
                assert!(
                    !has_all || contrast > LIMIT || spp < 16,
                    "{name} {index}: {contrast}"
                );
            }
            // The bits are those of the image with that number of samples
            let of_count = if has_all { &all } else { &first };
            assert_eq!(mixed.image.pixels[index], of_count.image.pixels[index]);
            let variance = &of_count.aovs.as_ref().unwrap().variance;
            assert_eq!(counts.variance[index], variance[index]);
            edge_count += u64::from(has_all);
        }
        let pixel_count = expected.len() as u64;
        assert!(
            (pixel_count / 50..pixel_count).contains(&edge_count),
            "{name}: {edge_count}"
        );
        let spp = u64::from(spp);
        assert_eq!(mixed.samples.total, pixel_count + edge_count * (spp - 1));
        assert_eq!(mixed.ledger.camera_rays(), pixel_count + edge_count * spp);
    }
}

#[test]
fn parts_by_contrast_have_the_bits_of_the_full_image() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let accel = tree(&scene);
    let wanted = by_contrast(16, Exposure::Stops(0.5));
    let whole = images::rendered_with(&scene, &*accel, &wanted);
    let camera = &scene.cameras[0];
    let valid = scene.validate().unwrap();
    let mut parts = Parts::new((valid, camera), &*accel, &wanted, &Monitor::default()).unwrap();
    // Compare regions that begin and end in and at the borders of tiles
    for [x, y, width, height] in [[0, 0, 75, 101], [0, 32, 75, 32], [0, 40, 75, 7], [31, 63, 5, 3]] {
        let region = Region { x, y, width, height };
        let part = parts.region(&region, &Monitor::default()).unwrap();
        let rows = (y..y + height).map(|y| (75 * y + x) as usize);
        let expected: Vec<[f32; 3]> = rows
            .flat_map(|first| &whole.image.pixels[first..first + width as usize])
            .copied()
            .collect();
        assert_eq!(part.image.pixels, expected, "{region:?}");
    }
}

#[test]
fn spheres_by_contrast_have_the_error_of_all_samples_for_few() {
    let scene = crate::support::sampling_scenes::mirrored_spheres();
    let accel = tree(&scene);
    let size = |settings: RenderSettings| RenderSettings {
        width: 240,
        height: 180,
        ..settings
    };
    let rendered = |settings| images::rendered_with(&scene, &*accel, &size(settings));
    let reference = rendered(settings(400));
    let error = |image: &Rendering| {
        let pixels = image.image.pixels.as_flattened().iter();
        let pairs = pixels.zip(reference.image.pixels.as_flattened());
        let square = |(&a, &b): (&f32, &f32)| (displayed(a, 0.0) - displayed(b, 0.0)).powi(2);
        (pairs.map(square).sum::<f64>() / (3 * 240 * 180) as f64).sqrt()
    };
    let all = rendered(settings(16));
    let mixed = rendered(by_contrast(16, Exposure::Stops(0.0)));
    assert!(
        error(&mixed) < 1.1 * error(&all),
        "{} {}",
        error(&mixed),
        error(&all)
    );
    assert!(mixed.samples.mean < 8.0, "{}", mixed.samples.mean);
}

#[test]
fn settings_that_contrast_ignores_change_no_bit() {
    let scene = scene_folder::named("whitted_1980.toml").scene;
    let accel = tree(&scene);
    let plain = by_contrast(16, Exposure::Stops(0.0));
    let ignored = RenderSettings {
        filter: PixelFilter::of_kind(FilterKind::Mitchell),
        background: VisibleBackground::Transparent,
        ..plain
    };
    let [plain, ignored] = [plain, ignored].map(|settings| images::rendered_with(&scene, &*accel, &settings));
    assert_eq!(plain.image.pixels.len(), ignored.image.pixels.len());
    assert!(ignored.alpha.is_none() && ignored.layers.is_empty());
    let opaque = RenderSettings {
        filter: PixelFilter::of_kind(FilterKind::Mitchell),
        ..by_contrast(16, Exposure::Stops(0.0))
    };
    let opaque = images::rendered_with(&scene, &*accel, &opaque);
    assert_eq!(plain.image.pixels, opaque.image.pixels);
}
