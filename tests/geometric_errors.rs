//! Rays of a picture through ways of finding hits: what they err by.

use std::path::Path;
use std::time::{Duration, Instant};

use whit::accel::{Accel, AccelOptions, Backend, Precision, build};
use whit::cost::{Answered, GeometricErrors};
use whit::gltf::{LoadOptions, load};
use whit::render::{RecordedRays, RenderSettings, record};
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
    build(scene, Backend::Bsp, &AccelOptions::default()).unwrap()
}

fn recorded(scene: &Scene, settings: &RenderSettings) -> RecordedRays {
    record(scene, &scene.cameras[0], &*exact(scene), settings)
}

fn errors(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> GeometricErrors {
    let right = recorded(scene, &self::settings());
    let left = recorded(scene, settings);
    let reference = exact(scene);
    let deadline = Instant::now() + Duration::from_secs(600);
    Answered::by(&*reference, &right).errors(accel, &left.shadow, deadline)
}

#[test]
fn watertight_paths_err_nowhere() {
    let scene = scene();
    for backend in [Backend::default(), Backend::Bsp] {
        let options = AccelOptions {
            precision: Precision::Watertight,
            ..AccelOptions::default()
        };
        let accel = build(&scene, backend, &options).unwrap();
        let errors = errors(&scene, &*accel, &settings());
        assert_eq!(errors.count(), 0, "{backend}: {errors:?}");
    }
}
