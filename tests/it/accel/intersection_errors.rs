//! Errors of the rays of an image for inexact intersection variants and spawn policies.

use std::path::Path;
use std::time::{Duration, Instant};

use whit::accel::{Accel, AccelOptions, Backend, Precision, build};
use whit::cost::{GeometricErrors, ReferenceResults};
use whit::gltf::{LoadOptions, load};
use whit::numeric::SpawnPolicy;
use whit::render::{HitPoint, RecordedRays, RenderSettings, record};
use whit::scene::Scene;

fn scene() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/first_light.gltf");
    load(&path, &LoadOptions::default()).unwrap()
}

fn settings() -> RenderSettings {
    RenderSettings {
        width: 160,
        height: 120,
        depth: 0,
        ..RenderSettings::default()
    }
}

fn exact(scene: &Scene) -> Box<dyn Accel + '_> {
    build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap()
}

fn recorded(scene: &Scene, settings: &RenderSettings) -> RecordedRays {
    record(
        scene.validate().unwrap(),
        &scene.cameras[0],
        &*exact(scene),
        settings,
    )
}

fn errors(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> GeometricErrors {
    let right = recorded(scene, &self::settings());
    let left = recorded(scene, settings);
    let reference = exact(scene);
    let deadline = Instant::now() + Duration::from_secs(600);
    ReferenceResults::by(&*reference, &right).errors(accel, &left.shadow, deadline)
}

#[test]
fn error_bound_offset_avoids_self_shadowing() {
    let scene = scene();
    let accel = exact(&scene);
    let by = |spawn| errors(&scene, &*accel, &RenderSettings { spawn, ..settings() });
    let bounded = by(SpawnPolicy::Bounded);
    assert_eq!(bounded.camera_rays, 160 * 120);
    assert!(bounded.shadow_rays > 5000, "{bounded:?}");
    assert_eq!((bounded.count(), bounded.ties), (0, 0), "{bounded:?}");
    // Where rounding takes every other point into its surface, about half of the rays hit it.
    let none = by(SpawnPolicy::None);
    assert!(none.false_shadows > none.shadow_rays / 100, "{none:?}");
    // Less than the rounding of coordinates.
    let little = by(SpawnPolicy::Fixed(1e-9));
    assert!(little.false_shadows > little.shadow_rays / 100, "{little:?}");
    // A twentieth of the scene: beyond what is near a surface, on both sides of a shadow's edge.
    let much = by(SpawnPolicy::Fixed(0.05));
    assert!(much.false_shadows + much.light_leaks > 0, "{much:?}");
    assert_eq!((much.leaks, much.false_hits), (0, 0), "camera rays leave nothing");
}

#[test]
fn watertight_variants_have_no_intersection_errors() {
    let scene = scene();
    for backend in [Backend::default(), Backend::Bsp] {
        let options = AccelOptions {
            precision: Precision::Watertight,
            ..AccelOptions::default()
        };
        let accel = build(scene.validate().unwrap(), backend, &options).unwrap();
        let errors = errors(&scene, &*accel, &settings());
        assert_eq!(errors.count(), 0, "{backend}: {errors:?}");
    }
}

#[test]
fn points_from_the_ray_parameter_exceed_the_bound() {
    let scene = scene();
    let accel = exact(&scene);
    let reported = RenderSettings {
        hit_points: HitPoint::Reported,
        ..settings()
    };
    let errors = errors(&scene, &*accel, &reported);
    assert!(errors.false_shadows > 0, "{errors:?}");
    assert_eq!((errors.leaks, errors.false_hits), (0, 0), "{errors:?}");
}
