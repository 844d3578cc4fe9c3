//! Parameters that a study varies: those that matter to the scene, and no others.

use crate::support::scene_folder;
use whit::accel::{Backend, BuildQuality, Precision};
use whit::cost::{Configuration, HitPath, Knob, LevelRange, SceneChange, knobs, with_knob};
use whit::render::{HitPoint, Plan, RenderSettings};
use whit::scene::{Camera, Effect, Scene};

fn base(path: HitPath) -> Configuration {
    Configuration {
        settings: RenderSettings::default(),
        path,
        change: SceneChange::default(),
        denoises: false,
    }
}

fn embree(precision: Precision) -> HitPath {
    HitPath {
        backend: Backend::Embree,
        precision,
        ..HitPath::BSP
    }
}

/// The places that a knob is turned to.
fn turned(scene: &Scene, base: &Configuration, knob: Knob) -> Vec<(String, Configuration)> {
    let camera = scene.cameras.first().cloned().unwrap_or_else(Camera::default);
    let plan = Plan::new(scene, &camera, &base.settings.effects);
    let all = knobs(scene, &plan, base, &LevelRange::of(8)).into_iter();
    all.filter(|(of, _, _)| *of == knob)
        .map(|(_, level, configuration)| (level, configuration))
        .collect()
}

fn levels(scene: &Scene, base: &Configuration, knob: Knob) -> Vec<String> {
    let all = turned(scene, base, knob).into_iter();
    all.map(|(level, _)| level).collect()
}

#[test]
fn embree_build_options_are_knobs_only_for_triangles() {
    let [meshes, shapes] =
        ["first_light.gltf", "mirror_room.toml"].map(|name| scene_folder::named(name).scene);
    let [fast, robust, watertight] = Precision::ALL.map(|precision| base(embree(precision)));
    let of = |scene: &Scene, base: &Configuration, knob| levels(scene, base, knob).join(" ");
    assert_eq!(of(&meshes, &fast, Knob::BuildQuality), "low high");
    assert_eq!(of(&meshes, &robust, Knob::BuildQuality), "low");
    assert_eq!(of(&meshes, &watertight, Knob::BuildQuality), "low");
    assert_eq!(of(&meshes, &fast, Knob::Compactness), "compact");
    assert_eq!(of(&meshes, &watertight, Knob::Compactness), "compact");
    // Embree has one form of these only.
    assert_eq!(of(&meshes, &robust, Knob::Compactness), "");
    for knob in [Knob::BuildQuality, Knob::Compactness] {
        assert_eq!(of(&shapes, &fast, knob), "", "{knob}");
        assert_eq!(of(&meshes, &base(HitPath::BSP), knob), "", "{knob}");
    }
}

#[test]
fn each_knob_changes_alone_and_is_recorded_in_the_settings() {
    let meshes = scene_folder::named("first_light.gltf").scene;
    let base = base(embree(Precision::Fast));
    for (knob, level, word) in [
        (Knob::BuildQuality, "low", "build_quality"),
        (Knob::Compactness, "compact", "compact"),
    ] {
        let all = turned(&meshes, &base, knob);
        let (_, configuration) = all.iter().find(|(name, _)| name == level).unwrap();
        assert_ne!(*configuration, base);
        assert_eq!(with_knob(&base, knob, configuration), *configuration, "{knob}");
        assert_eq!(with_knob(configuration, knob, &base), base, "{knob}");
        let words = configuration.words();
        assert!(
            words.contains_key(word) && !base.words().contains_key(word),
            "{words:?}"
        );
    }
    let low = HitPath {
        build_quality: BuildQuality::Low,
        compact: true,
        ..base.path
    };
    let settings = base.with_path(low).to_settings();
    assert_eq!(
        (settings.build_quality, settings.compact),
        (Some(BuildQuality::Low), Some(true))
    );
}

#[test]
fn spawn_points_are_a_knob_only_where_rays_leave_surfaces() {
    let shaded = scene_folder::named("first_light.gltf").scene;
    let mut base = base(HitPath::BSP);
    let all = turned(&shaded, &base, Knob::SpawnPoints);
    let names: Vec<&str> = all.iter().map(|(level, _)| level.as_str()).collect();
    assert_eq!(names, ["none", "fixed:0.0000001", "fixed:0.00001", "fixed:0.001"]);
    for (level, configuration) in &all {
        assert_eq!(with_knob(&base, Knob::SpawnPoints, configuration), *configuration);
        assert_eq!(configuration.words()["spawn"], *level);
        assert_eq!(
            configuration.to_settings().spawn,
            Some(configuration.settings.spawn)
        );
    }
    let points = turned(&shaded, &base, Knob::HitRefinement);
    assert_eq!(points.len(), 1);
    let (level, configuration) = &points[0];
    assert_eq!(
        with_knob(&base, Knob::HitRefinement, configuration),
        *configuration
    );
    assert_eq!(
        (level.as_str(), configuration.words()["hit_points"].as_str()),
        ("reported", "reported")
    );
    assert_eq!(configuration.to_settings().hit_points, Some(HitPoint::Reported));
    // Without lights and mirrors no ray leaves anything.
    let mut dark = shaded.clone();
    dark.lights.clear();
    for effect in [Effect::Shadow, Effect::Reflection, Effect::Refraction] {
        base.settings.effects.removed = base.settings.effects.removed.with(effect);
    }
    for knob in [Knob::SpawnPoints, Knob::HitRefinement] {
        assert!(turned(&dark, &base, knob).is_empty(), "{knob}");
    }
}

#[test]
fn bsp_in_f32_is_a_path_only_for_triangles() {
    let [meshes, shapes] =
        ["first_light.gltf", "mirror_room.toml"].map(|name| scene_folder::named(name).scene);
    let exact = base(HitPath::BSP);
    let of = |scene: &Scene, base: &Configuration| levels(scene, base, Knob::HitPath);
    assert!(of(&meshes, &exact).contains(&"bsp f32".to_owned()));
    assert!(!of(&shapes, &exact).contains(&"bsp f32".to_owned()));
    let rounded = base(HitPath {
        precision: Precision::Fast,
        ..HitPath::BSP
    });
    // From there, what asks f64 is another.
    let all = of(&meshes, &rounded);
    assert!(
        all.contains(&"bsp".to_owned()) && !all.contains(&"bsp f32".to_owned()),
        "{all:?}"
    );
}
