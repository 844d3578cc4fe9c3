//! Tests of the error that is estimated after a render: against the error to converged images, for every way of
//! sampling, and that the estimate changes neither the image nor its statistics.

use crate::support::image_error::Judge;
use crate::support::images::{rendered, settings};
use crate::support::sampling_scenes::{first_light, noise};
use whit::accel::Backend;
use whit::render::{
    Adaptive, AovKind, AovSet, Exposure, FilterKind, ImageError, Pattern, PixelFilter, RenderSettings,
};
use whit::scene::{Background, Camera, Scene};

/// Sides of the images, of which less than half is rendered again.
const SIZE: u32 = 96;
/// Largest ratio, and inverse, of the estimated to the true error.
const MAX_RATIO: f64 = 1.25;

fn with_estimate(spp: u32) -> RenderSettings {
    RenderSettings {
        error_exposure: Some(Exposure::Stops(0.0)),
        ..settings(SIZE, spp)
    }
}

/// Requires that the estimate and its interval agree with the error to the references.
#[track_caller]
fn assert_agrees(what: &str, error: &ImageError, [truth, _]: [f64; 2]) {
    let [low, high] = error.interval;
    let is_within = truth > low / MAX_RATIO && truth < high * MAX_RATIO;
    assert!(
        is_within && low <= error.rmse && error.rmse <= high,
        "{what}: {error:?}, true {truth}"
    );
}

#[test]
fn estimate_agrees_with_the_error_to_converged_images() {
    for (name, scene) in [("first_light", first_light()), ("noise", noise())] {
        let judge = Judge::new(&scene, Backend::Bsp, settings(SIZE, 1), 12);
        let uniform = [
            (Pattern::Sobol, 1),
            (Pattern::Sobol, 4),
            (Pattern::Sobol, 16),
            (Pattern::R2, 4),
            (Pattern::Jittered, 4),
            (Pattern::Regular, 4),
        ];
        for (pattern, spp) in uniform {
            let rendering = judge.rendered(RenderSettings {
                pattern,
                ..with_estimate(spp)
            });
            let error = rendering.error.unwrap();
            let what = format!("{name}, {pattern:?}, {spp}");
            assert_agrees(&what, &error, judge.error(&rendering.image));
            let is_measured = pattern == Pattern::Sobol;
            assert_eq!(error.samples_of_half_error.is_some(), is_measured, "{what}");
        }
        let rendering = judge.rendered(RenderSettings {
            adaptive: Some(Adaptive {
                error: 0.03,
                gain: 1.0,
            }),
            ..with_estimate(32)
        });
        let error = rendering.error.unwrap();
        assert_agrees(
            &format!("{name}, adaptive"),
            &error,
            judge.error(&rendering.image),
        );
    }
}

#[test]
fn price_of_half_the_error_is_that_of_more_samples() {
    let scene = noise();
    let judge = Judge::new(&scene, Backend::Bsp, settings(SIZE, 1), 16);
    let error_of = |spp| {
        let rendering = judge.rendered(with_estimate(spp));
        (rendering.error.unwrap(), judge.error(&rendering.image)[0])
    };
    let [(_, few), (estimate, many)] = [4, 16].map(error_of);
    // Four times the samples divide the error by 4^r
    let rate = (few / many).log(4.0);
    let factor = estimate.samples_of_half_error.unwrap();
    assert!((factor.log2() * rate - 1.0).abs() < 0.15, "{factor}, rate {rate}");
}

#[test]
fn estimate_changes_neither_image_nor_statistics() {
    let scene = first_light();
    let filter = PixelFilter::of_kind(FilterKind::Gaussian);
    for filter in [PixelFilter::default(), filter] {
        let with = RenderSettings {
            filter,
            ledger: true,
            cost_aovs: true,
            layers: AovKind::ALL.into_iter().collect::<AovSet>(),
            ..with_estimate(9)
        };
        let without = RenderSettings {
            error_exposure: None,
            ..with
        };
        let [with, without] = [with, without].map(|settings| rendered(&scene, &scene.cameras[0], &settings));
        assert!(with.error.is_some() && without.error.is_none());
        assert_eq!(with.image, without.image);
        assert_eq!(with.layers, without.layers);
        assert_eq!(with.ledger.total().rays, without.ledger.total().rays);
    }
}

#[test]
fn image_without_noise_has_no_error() {
    let scene = Scene {
        cameras: vec![Camera::default()],
        background: Background::Uniform([0.25; 3]),
        ..Scene::default()
    };
    let error = rendered(&scene, &scene.cameras[0], &with_estimate(4))
        .error
        .unwrap();
    assert_eq!(
        (error.rmse, error.interval, error.samples_of_half_error),
        (0.0, [0.0; 2], None)
    );
}
