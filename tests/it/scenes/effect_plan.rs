//! Tests of the effect plan: the effects that it disables change no bit of an image, and every trigger is necessary.

use crate::support::images;
use crate::support::{random_scenes, scene_folder};
use rayon::prelude::*;
use whit::accel::{self, AccelOptions, Backend};
use whit::render::plan::{Facts, TRIGGERS, Trigger};
use whit::render::{Category, Plan, RenderSettings, Rendering};
use whit::scene::{Effect, EffectOverrides, EffectSet, Model, Scene};

/// Number of random scenes.
const SCENES: u64 = 1000;

fn settings() -> RenderSettings {
    RenderSettings {
        width: 12,
        height: 9,
        wavelengths: 4,
        ..RenderSettings::default()
    }
}

fn rendered(scene: &Scene, backend: Backend, settings: &RenderSettings) -> Rendering {
    let accel = accel::build(scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
    images::rendered_with(scene, &*accel, settings)
}

fn bits(rendering: &Rendering) -> Vec<u32> {
    let values = rendering.image.pixels.as_flattened().iter();
    values.map(|value| value.to_bits()).collect()
}

fn with(effects: EffectOverrides, settings: RenderSettings) -> RenderSettings {
    RenderSettings { effects, ..settings }
}

fn backend_of(seed: u64) -> Backend {
    if seed.is_multiple_of(2) {
        Backend::default()
    } else {
        Backend::Bsp
    }
}

/// Returns the effects that the plan would disable in the scene if this trigger did not exist.
fn missing_without(trigger: &Trigger, scene: &Scene) -> EffectSet {
    let facts = Facts::of(scene, &scene.cameras[0]);
    let called_for = |effect: Effect| {
        TRIGGERS
            .iter()
            .filter(|other| !std::ptr::eq(*other, trigger) && other.effect == effect)
            .any(|other| (other.fires)(&facts).is_some())
    };
    let fired = (trigger.fires)(&facts).is_some();
    if fired && !called_for(trigger.effect) {
        EffectSet::NONE.with(trigger.effect)
    } else {
        EffectSet::NONE
    }
}

#[test]
fn random_scenes_look_the_same_with_all_effects_on() {
    let plans: Vec<Plan> = (0..SCENES)
        .into_par_iter()
        .map(|seed| {
            let scene = random_scenes::scene(seed);
            let backend = backend_of(seed);
            let planned = rendered(&scene, backend, &settings());
            let all = rendered(&scene, backend, &with(EffectOverrides::ALL, settings()));
            assert!(
                bits(&planned) == bits(&all),
                "scene {seed} through {backend}:\n{}",
                planned.plan
            );
            planned.plan
        })
        .collect();
    // Check that every effect was on in some scene and off in another
    for effect in Effect::ALL {
        let on = plans.iter().filter(|plan| plan.effects().has(effect)).count();
        println!("{effect}: on in {on} of {SCENES} scenes");
        assert!((20..=980).contains(&on), "{effect} is on in {on} scenes");
    }
}

#[test]
fn repository_scenes_look_the_same_with_all_effects_on() {
    for file in scene_folder::files() {
        let filed = scene_folder::load(&file);
        let settings = RenderSettings {
            wavelengths: 4,
            ..filed.settings(32, 1)
        };
        let planned = rendered(&filed.scene, Backend::default(), &settings);
        let all = rendered(
            &filed.scene,
            Backend::default(),
            &with(EffectOverrides::ALL, settings),
        );
        assert!(bits(&planned) == bits(&all), "{}:\n{}", filed.name, planned.plan);
    }
}

#[test]
fn diffuse_surfaces_without_lobes_lose_no_energy() {
    let mut off = 0;
    for seed in 0..200 {
        // Take the lobes of all surfaces away, but those of layers and films
        let mut scene = random_scenes::scene(seed);
        for material in &mut scene.materials {
            if let Model::MetallicRoughness(model) = &mut material.model {
                (model.metallic, model.specular) = (0.0, 0.0);
            }
        }
        let planned = rendered(&scene, backend_of(seed), &settings());
        let all = rendered(&scene, backend_of(seed), &with(EffectOverrides::ALL, settings()));
        assert!(bits(&planned) == bits(&all), "scene {seed}:\n{}", planned.plan);
        off += u32::from(!planned.plan.effects().has(Effect::EnergyConservation));
    }
    assert!((20..180).contains(&off), "off in {off} scenes");
}

#[test]
fn removing_any_trigger_changes_some_image() {
    let spared: Vec<&str> = TRIGGERS
        .par_iter()
        .filter(|trigger| {
            !(0..SCENES).any(|seed| {
                let scene = random_scenes::scene(seed);
                let removed = missing_without(trigger, &scene);
                if removed == EffectSet::NONE {
                    return false;
                }
                let overrides = EffectOverrides {
                    removed,
                    ..EffectOverrides::default()
                };
                let whole = rendered(&scene, backend_of(seed), &settings());
                let mutant = rendered(&scene, backend_of(seed), &with(overrides, settings()));
                bits(&whole) != bits(&mutant)
            })
        })
        .map(|trigger| trigger.name)
        .collect();
    assert!(spared.is_empty(), "nothing shows what these are for: {spared:?}");
}

#[test]
fn disabled_effects_trace_no_rays() {
    for seed in 0..200 {
        let scene = random_scenes::scene(seed);
        let Rendering {
            plan,
            ledger,
            subsurface,
            ..
        } = rendered(&scene, backend_of(seed), &settings());
        let on = plan.effects();
        assert!(
            on.has(Effect::Shadow) || ledger.shadow_rays() == 0,
            "scene {seed}"
        );
        assert!(
            on.has(Effect::Reflection) || ledger.reflection_rays() == 0,
            "scene {seed}"
        );
        assert!(
            on.has_transmission() || ledger.refraction_rays() == 0,
            "scene {seed}"
        );
        assert!(on.has_lobes() || ledger.rough_rays() == 0, "scene {seed}");
        assert!(on.has(Effect::Subsurface) == subsurface.is_some(), "scene {seed}");
        for effect in Effect::ALL {
            // Rays through alpha-tested and blended surfaces count as refracted rays.
            let may = on.has(effect) || (effect == Effect::Refraction && on.has_transmission());
            let rays = Category::of(effect).map_or(0, |account| ledger.of(account).rays);
            assert!(may || rays == 0, "scene {seed}: {rays} rays of {effect}");
        }
    }
}

#[test]
fn disabled_effects_disable_their_dependents() {
    let scene = random_scenes::scene(1);
    let overrides: EffectOverrides = "all,-shadow,-refraction".parse().unwrap();
    let plan = Plan::new(&scene, &scene.cameras[0], &overrides);
    for effect in [
        Effect::Shadow,
        Effect::TransparentShadow,
        Effect::Refraction,
        Effect::NestedMedia,
        Effect::Dispersion,
        Effect::Absorption,
        Effect::RoughRefraction,
    ] {
        assert!(!plan.effects().has(effect), "{effect}");
    }
    assert!(plan.effects().has(Effect::AlphaTest));
}
