//! A way of rendering a scene: settings, what finds the hits, and what is changed of the scene itself.

use std::collections::BTreeMap;

use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, Pattern, RenderSettings};
use crate::scene::{Effect, LightKind, Scene};

/// What finds the hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct HitPath {
    /// Embree, or the BSP.
    pub backend: Backend,
    /// How far its hits of triangles may be trusted; the BSP knows fast, in f32, and else is exact.
    pub precision: Precision,
    /// How it is given placed meshes.
    pub instancing: Instancing,
    /// How much work it puts into its trees.
    pub build_quality: BuildQuality,
    /// Whether it saves memory rather than time.
    pub compact: bool,
}

impl HitPath {
    /// The path of every hit in f64.
    pub const BSP: HitPath = HitPath {
        backend: Backend::Bsp,
        precision: Precision::Watertight,
        instancing: Instancing::Auto,
        build_quality: BuildQuality::Medium,
        compact: false,
    };

    /// What reports call it.
    pub fn name(&self) -> String {
        match (self.backend, self.precision) {
            (Backend::Embree, precision) => precision.to_string(),
            (Backend::Bsp, Precision::Fast) => "bsp f32".to_owned(),
            (backend, _) => backend.to_string(),
        }
    }
}

/// What a configuration changes of the scene itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneChange {
    /// Points of each extended light, in place of the lights' own.
    pub light_samples: Option<u32>,
    /// Rays into lobes, in place of the materials' own.
    pub rough_rays: Option<u32>,
    /// Steps through volumes are so many times as long as the volumes' own.
    pub step_factor: f64,
}

impl Default for SceneChange {
    fn default() -> SceneChange {
        SceneChange {
            light_samples: None,
            rough_rays: None,
            step_factor: 1.0,
        }
    }
}

impl SceneChange {
    /// Changes the scene.
    pub fn apply(&self, scene: &mut Scene) {
        if let Some(count) = self.light_samples {
            for light in &mut scene.lights {
                if let LightKind::Area { samples, .. } = &mut light.kind {
                    *samples = count;
                }
            }
        }
        if let Some(rays) = self.rough_rays {
            scene.set_rough_rays(rays);
        }
        if self.step_factor != 1.0 {
            scene.scale_march_steps(self.step_factor);
        }
    }
}

/// A way of rendering a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Configuration {
    /// What picture is made.
    pub settings: RenderSettings,
    /// What finds the hits.
    pub path: HitPath,
    /// What is changed of the scene.
    pub change: SceneChange,
}

impl Configuration {
    /// The same with hits found by `path`.
    #[must_use]
    pub fn through(self, path: HitPath) -> Configuration {
        Configuration { path, ..self }
    }

    /// Whether hits, and the points that new rays start from, may be trusted at least as far as those of `other`.
    pub fn is_trusted_like(&self, other: &Configuration) -> bool {
        let trust = |path: &HitPath| match (path.backend, path.precision) {
            (Backend::Embree, precision) => Precision::ALL.iter().position(|&known| known == precision),
            (Backend::Bsp, Precision::Fast) => Some(0),
            (Backend::Bsp | Backend::Brute, _) => Some(Precision::ALL.len()),
        };
        let (settings, others) = (&self.settings, &other.settings);
        trust(&self.path) >= trust(&other.path)
            && [others.spawn, SpawnPolicy::Bounded].contains(&settings.spawn)
            && [others.hit_points, HitPoint::Refined].contains(&settings.hit_points)
    }

    /// The names and values of everything that knobs turn.
    pub fn words(&self) -> BTreeMap<String, String> {
        let settings = &self.settings;
        let mut words = BTreeMap::from([
            ("samples".to_owned(), settings.spp.to_string()),
            ("pattern".to_owned(), pattern_name(settings.pattern).to_owned()),
            ("depth".to_owned(), settings.depth.to_string()),
            ("cutoff".to_owned(), cutoff_name(settings.weight_cutoff)),
            ("wavelengths".to_owned(), settings.wavelengths.to_string()),
            ("path".to_owned(), self.path.name()),
        ]);
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
