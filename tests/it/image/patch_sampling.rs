//! Tests of patch sampling: patches of an image predict properties of the whole.

use crate::support::sampling_scenes::{first_light, mostly_empty};
use whit::accel::{self, AccelOptions, Backend};
use whit::render::{
    Adaptive, FilterKind, Monitor, PatchGrid, Pattern, PixelFilter, RenderSettings, Rendering, render,
    render_patches,
};
use whit::scene::Scene;

fn settings(spp: u32) -> RenderSettings {
    RenderSettings {
        width: 100,
        height: 70,
        spp,
        ..RenderSettings::default()
    }
}

/// Renders the whole image and a mosaic of about this many pixels.
fn both(scene: &Scene, settings: &RenderSettings, pixels: f64) -> (Rendering, Rendering, PatchGrid) {
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let monitor = Monitor::default();
    let camera = &scene.cameras[0];
    let mosaic = PatchGrid::of(settings, pixels).unwrap();
    let whole = render(scene.validate().unwrap(), camera, &*accel, settings, &monitor).unwrap();
    let pieces = render_patches(
        (scene.validate().unwrap(), camera),
        &*accel,
        settings,
        mosaic,
        &monitor,
    )
    .unwrap();
    (whole, pieces, mosaic)
}

#[test]
fn patches_have_the_bits_of_the_full_image() {
    let scene = first_light();
    let mitchell = PixelFilter::of_kind(FilterKind::Mitchell);
    for (filter, side) in [(PixelFilter::default(), 16), (mitchell, 12)] {
        let settings = RenderSettings {
            filter,
            ..settings(4)
        };
        let (whole, pieces, mosaic) = both(&scene, &settings, 1600.0);
        assert_eq!(
            mosaic.size(&settings),
            [mosaic.columns * side, mosaic.rows * side]
        );
        assert_eq!([pieces.image.width, pieces.image.height], mosaic.size(&settings));
        let bits =
            |pixels: &[[f32; 3]]| -> Vec<u32> { pixels.iter().flatten().map(|x| x.to_bits()).collect() };
        let cut = mosaic.of_picture(&settings, &whole.image);
        assert_eq!(bits(&cut.pixels), bits(&pieces.image.pixels));
        assert!(cut.pixels.iter().any(|pixel| pixel[1] > 0.0));
    }
}

#[test]
fn adaptive_sample_counts_of_patches_match_the_full_image() {
    for (name, scene) in [("first light", first_light()), ("mostly empty", mostly_empty())] {
        let settings = RenderSettings {
            pattern: Pattern::Sobol,
            adaptive: Some(Adaptive {
                error: 0.01,
                gain: 1.0,
            }),
            ..settings(256)
        };
        // The mosaic contains all but the edges: four columns of four rows, of six of four.
        let (whole, pieces, _) = both(&scene, &settings, 5400.0);
        let ratio = pieces.samples.mean / whole.samples.mean;
        assert!((0.8..1.25).contains(&ratio), "{name}: {ratio}");
        assert!(pieces.image.pixels.iter().flatten().all(|x| x.is_finite()));
    }
}
