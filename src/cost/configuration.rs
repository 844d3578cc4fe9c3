//! Configuration of a render: settings, intersection backend, and changes of the scene itself.

use std::collections::BTreeMap;

use super::{HitPath, SceneChange, Settings};
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, Pattern, RenderSettings};
use crate::scene::Effect;

/// Complete description of a render: settings, backend, scene changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Configuration {
    /// Render settings that determine the image.
    pub settings: RenderSettings,
    /// Intersection backend and its options.
    pub path: HitPath,
    /// Changes of the scene before rendering.
    pub change: SceneChange,
    /// True if the finished image is denoised.
    pub denoises: bool,
}

impl Configuration {
    /// Returns all settings, as a settings file holds them.
    pub fn to_settings(&self) -> Settings {
        Settings {
            denoise: self.denoises.then_some(true),
            ..Settings::of(&self.settings, &self.path, &self.change)
        }
    }

    /// Returns this configuration with hits found by `path`.
    #[must_use]
    pub fn with_path(self, path: HitPath) -> Configuration {
        Configuration { path, ..self }
    }

    /// Returns whether hits and spawn points are at least as accurate as those of `other`.
    pub fn is_as_accurate_as(&self, other: &Configuration) -> bool {
        // Rank backends by accuracy; a position in `Precision::ALL` rises with it.
        let trust = |path: &HitPath| match (path.backend, path.precision) {
            (Backend::Embree | Backend::Auto, precision) => {
                Precision::ALL.iter().position(|&known| known == precision)
            }
            (Backend::Bsp, Precision::Fast) => Some(0),
            (Backend::Native | Backend::Bsp | Backend::Brute, _) => Some(Precision::ALL.len()),
        };
        // Spawn policy and hit points may equal those of `other` or be the most accurate ones
        let (settings, others) = (&self.settings, &other.settings);
        !self.denoises
            && trust(&self.path) >= trust(&other.path)
            && [others.spawn, SpawnPolicy::Bounded].contains(&settings.spawn)
            && [others.hit_points, HitPoint::Refined].contains(&settings.hit_points)
    }

    /// Returns the names and values of all settings that knobs change.
    pub fn words(&self) -> BTreeMap<String, String> {
        let settings = &self.settings;
        // List settings that always have a value
        let mut words = BTreeMap::from([
            ("samples".to_owned(), settings.spp.to_string()),
            ("pattern".to_owned(), pattern_name(settings.pattern).to_owned()),
            ("depth".to_owned(), settings.depth.to_string()),
            ("cutoff".to_owned(), cutoff_name(settings.weight_cutoff)),
            ("wavelengths".to_owned(), settings.wavelengths.to_string()),
            ("path".to_owned(), self.path.name()),
        ]);
        // Add settings that differ from the default
        let mut add = |name: &str, value: Option<String>| {
            words.extend(value.map(|value| (name.to_owned(), value)));
        };
        add(
            "adaptive",
            settings.adaptive.map(|adaptive| adaptive.error.to_string()),
        );
        add(
            "light_samples",
            self.change.light_samples.map(|count| count.to_string()),
        );
        add(
            "rough_rays",
            self.change.rough_rays.map(|count| count.to_string()),
        );
        add("bounces", self.change.bounces.map(|count| count.to_string()));
        add("photons", self.change.photons.map(|count| count.to_string()));
        // Add changes of the scene and of the backend's options
        let factor = self.change.step_factor;
        add("march_step", (factor != 1.0).then(|| step_name(factor)));
        let unfiltered = settings.effects.removed.has(Effect::TextureFilter);
        add("texture_filter", unfiltered.then(|| "off".to_owned()));
        let instancing = self.path.instancing;
        add(
            "instancing",
            (instancing != Instancing::Auto).then(|| instancing.to_string()),
        );
        let quality = self.path.build_quality;
        add(
            "build_quality",
            (quality != BuildQuality::default()).then(|| quality.to_string()),
        );
        let is_reported = settings.hit_points == HitPoint::Reported;
        add("hit_points", is_reported.then(|| "reported".to_owned()));
        let spawn = settings.spawn;
        add(
            "spawn",
            (spawn != SpawnPolicy::default()).then(|| spawn.to_string()),
        );
        add("compact", self.path.compact.then(|| "yes".to_owned()));
        add("denoise", self.denoises.then(|| "yes".to_owned()));
        words
    }
}

pub(super) fn pattern_name(pattern: Pattern) -> &'static str {
    match pattern {
        Pattern::Regular => "regular",
        Pattern::Jittered => "jittered",
        Pattern::Sobol => "sobol",
        Pattern::R2 => "r2",
    }
}

pub(super) fn cutoff_name(cutoff: f32) -> String {
    if cutoff > 0.0 {
        format!("1/{}", (1.0 / cutoff).round())
    } else {
        "none".to_owned()
    }
}

pub(super) fn step_name(factor: f64) -> String {
    if factor < 1.0 {
        format!("1/{} of the scene's", 1.0 / factor)
    } else {
        format!("{factor} times the scene's")
    }
}
