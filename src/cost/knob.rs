//! Tunable parameters (knobs) of a render and the levels that a study measures.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::configuration::{Configuration, cutoff_name, pattern_name, step_name};
use super::{HitPath, SceneChange};
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{Adaptive, FilterKind, HitPoint, Pattern, Plan, RenderSettings};
use crate::scene::{Caustics, Effect, Geometry, LightKind, Scene};

/// Fixed ray-origin offsets as fractions of the scene size, in place of an error bound: too small, usual, too large.
const FIXED_OFFSETS: [f64; 3] = [1e-7, 1e-5, 1e-3];

/// Tunable parameter that trades error for render time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Knob {
    /// Number of samples per pixel (spp).
    Samples,
    /// Number of samples per pixel of images that are denoised.
    DenoisedSamples,
    /// Sampling pattern within the pixel.
    Pattern,
    /// Standard error that ends the adaptive sampling of a pixel.
    Adaptive,
    /// Maximum depth: bounces of reflected and refracted rays.
    Depth,
    /// Path weight (throughput) below which a ray is not followed.
    Cutoff,
    /// Wavelengths that a path splits into at dispersion.
    Wavelengths,
    /// Samples per area light and shading point.
    LightSamples,
    /// Rays per shading point into the lobe of a rough surface.
    RoughRays,
    /// Largest number of bounces of diffuse light between surfaces.
    Bounces,
    /// Number of photons of caustics.
    Photons,
    /// Length of the ray-marching steps through volumes.
    MarchStep,
    /// Texture filtering over the ray's footprint, on or off.
    TextureFilter,
    /// Intersection backend and the precision of its triangle hits.
    HitPath,
    /// Way in which Embree represents instanced meshes.
    Instancing,
    /// Build quality of Embree's BVHs.
    BuildQuality,
    /// Embree's compact mode, which saves memory rather than time.
    Compactness,
    /// Policy for the origins of rays that leave surfaces.
    SpawnPoints,
    /// Recomputation of hit points in f64, on or off.
    HitRefinement,
}

impl Knob {
    /// All knobs, in the order of reports.
    pub const ALL: [Knob; 19] = [
        Knob::Samples,
        Knob::DenoisedSamples,
        Knob::Pattern,
        Knob::Adaptive,
        Knob::Depth,
        Knob::Cutoff,
        Knob::Wavelengths,
        Knob::LightSamples,
        Knob::RoughRays,
        Knob::Bounces,
        Knob::Photons,
        Knob::MarchStep,
        Knob::TextureFilter,
        Knob::HitPath,
        Knob::Instancing,
        Knob::BuildQuality,
        Knob::Compactness,
        Knob::SpawnPoints,
        Knob::HitRefinement,
    ];

    /// Returns the knob's name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Knob::Samples => "samples",
            Knob::DenoisedSamples => "samples, denoised",
            Knob::Pattern => "pattern",
            Knob::Adaptive => "adaptive",
            Knob::Depth => "depth",
            Knob::Cutoff => "cut-off",
            Knob::Wavelengths => "wavelengths",
            Knob::LightSamples => "light samples",
            Knob::RoughRays => "rough rays",
            Knob::Bounces => "bounces",
            Knob::Photons => "photons",
            Knob::MarchStep => "march step",
            Knob::TextureFilter => "texture filter",
            Knob::HitPath => "hit path",
            Knob::Instancing => "instancing",
            Knob::BuildQuality => "build quality",
            Knob::Compactness => "compactness",
            Knob::SpawnPoints => "spawn points",
            Knob::HitRefinement => "hit refinement",
        }
    }

    /// Returns whether the levels are ordered so that the error falls along them.
    pub const fn is_graded(self) -> bool {
        matches!(
            self,
            Knob::Samples
                | Knob::DenoisedSamples
                | Knob::Adaptive
                | Knob::Depth
                | Knob::Cutoff
                | Knob::Wavelengths
                | Knob::LightSamples
                | Knob::RoughRays
                | Knob::Bounces
                | Knob::Photons
                | Knob::MarchStep
        )
    }
}

impl fmt::Display for Knob {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Upper limits of the sampling knobs' levels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelRange {
    /// Largest number of samples per pixel.
    pub samples: u32,
    /// Largest number of samples per pixel under adaptive sampling.
    pub adaptive_samples: u32,
    /// Standard errors, in displayed values, that end adaptive sampling.
    pub adaptive_errors: Vec<f64>,
    /// True if denoised images are measured, too.
    #[serde(default)]
    pub denoises: bool,
}

impl LevelRange {
    /// Returns limits of `samples` spp, with the default adaptive errors.
    pub fn of(samples: u32) -> LevelRange {
        LevelRange {
            samples,
            adaptive_samples: samples,
            adaptive_errors: vec![0.04, 0.02, 0.01, 0.005],
            denoises: false,
        }
    }
}

/// Returns every knob's levels with their configurations: one knob differs from `base`, and only knobs that `plan`
/// makes relevant are listed.
pub fn knobs(
    scene: &Scene,
    plan: &Plan,
    base: &Configuration,
    reach: &LevelRange,
) -> Vec<(Knob, String, Configuration)> {
    // Collect the levels of every knob
    let turns = KnobLevels {
        scene,
        plan,
        base,
        reach,
    };
    let all = Knob::ALL.into_iter().flat_map(|knob| {
        let levels = turns.levels(knob).into_iter();
        levels.map(move |(level, configuration)| (knob, level, configuration))
    });
    // A level that the base already has is the base itself, not a further configuration.
    all.filter(|(_, _, configuration)| configuration != base)
        .collect()
}

struct KnobLevels<'a> {
    scene: &'a Scene,
    plan: &'a Plan,
    base: &'a Configuration,
    reach: &'a LevelRange,
}

type Level = (String, Configuration);

impl KnobLevels<'_> {
    fn has(&self, effect: Effect) -> bool {
        self.plan.effects().has(effect)
    }

    /// Returns the base configuration with changed render settings.
    fn set(&self, change: impl Fn(&mut RenderSettings)) -> Configuration {
        let mut configuration = *self.base;
        change(&mut configuration.settings);
        configuration
    }

    fn levels(&self, knob: Knob) -> Vec<Level> {
        // Levels that need an effect are empty when the plan lacks it.
        let bounces = self.has(Effect::Reflection) || self.has(Effect::Refraction);
        match knob {
            Knob::Samples => self.samples(),
            Knob::DenoisedSamples if self.reach.denoises => self.denoised_samples(),
            Knob::Pattern => self.patterns(),
            Knob::Adaptive => self.adaptive(),
            Knob::Depth if bounces => self.depths(),
            Knob::Cutoff if bounces => self.cutoffs(),
            Knob::Wavelengths if self.has(Effect::Dispersion) => self.wavelengths(),
            Knob::LightSamples if self.has_extended_lights() => self.light_samples(),
            Knob::RoughRays if self.has(Effect::RoughReflection) => self.rough_rays(),
            Knob::Bounces if self.has(Effect::Interreflection) => self.bounces(),
            Knob::Photons if self.has(Effect::Caustics) => self.photons(),
            Knob::MarchStep if self.has(Effect::Volume) => self.march_steps(),
            Knob::TextureFilter if self.has(Effect::TextureFilter) => self.texture_filter(),
            Knob::HitPath => self.hit_paths(),
            Knob::Instancing => self.instancings(),
            Knob::BuildQuality => self.build_qualities(),
            Knob::Compactness => self.compactness(),
            Knob::SpawnPoints if self.has_rays_from_surfaces() => self.spawn_points(),
            Knob::HitRefinement if self.has_rays_from_surfaces() => self.hit_points(),
            _ => Vec::new(),
        }
    }

    fn samples(&self) -> Vec<Level> {
        // Double the samples up to the limit.
        let powers = (0..32).map(|power| 1u32 << power);
        powers
            .take_while(|&spp| spp <= self.reach.samples)
            .map(|spp| (spp.to_string(), self.set(|settings| settings.spp = spp)))
            .collect()
    }

    /// Returns the levels of the samples, each denoised.
    fn denoised_samples(&self) -> Vec<Level> {
        let mut levels = self.samples();
        for (_, configuration) in &mut levels {
            configuration.denoises = true;
        }
        levels
    }

    fn patterns(&self) -> Vec<Level> {
        let all = [Pattern::Regular, Pattern::Jittered, Pattern::Sobol, Pattern::R2];
        all.into_iter()
            .map(|pattern| {
                (
                    pattern_name(pattern).to_owned(),
                    self.set(|settings| settings.pattern = pattern),
                )
            })
            .collect()
    }

    /// Returns adaptive levels up to the largest number of samples; these need a box filter, a progressive pattern, and
    /// no AOVs.
    fn adaptive(&self) -> Vec<Level> {
        let settings = &self.base.settings;
        let fits = settings.filter.kind == FilterKind::Box
            && settings.pattern != Pattern::Regular
            && settings.layers.is_empty()
            && settings.light_layers.is_empty();
        // Adaptive sampling takes at least 16 samples of every pixel.
        if !fits || self.reach.adaptive_samples <= 16 {
            return Vec::new();
        }
        let errors = self.reach.adaptive_errors.iter();
        errors
            .map(|&error| {
                let adaptive = Adaptive { error, gain: 1.0 };
                let configuration = self.set(|settings| {
                    settings.spp = self.reach.adaptive_samples;
                    settings.adaptive = Some(adaptive);
                });
                (error.to_string(), configuration)
            })
            .collect()
    }

    fn depths(&self) -> Vec<Level> {
        // Keep depths up to three times the base's, and at least 6.
        let mut depths: Vec<u32> = (0..=4).chain([6, 8, 12]).collect();
        depths.retain(|&depth| depth <= self.base.settings.depth.max(2) * 3);
        depths
            .into_iter()
            .map(|depth| (depth.to_string(), self.set(|settings| settings.depth = depth)))
            .collect()
    }

    fn cutoffs(&self) -> Vec<Level> {
        // Zero follows every ray up to the maximum depth.
        [1.0 / 8.0, 1.0 / 32.0, 1.0 / 128.0, 1.0 / 512.0, 1.0 / 4096.0, 0.0]
            .into_iter()
            .map(|cutoff| {
                (
                    cutoff_name(cutoff),
                    self.set(|settings| settings.weight_cutoff = cutoff),
                )
            })
            .collect()
    }

    fn wavelengths(&self) -> Vec<Level> {
        [1, 2, 4, 8, 16, 32]
            .into_iter()
            .map(|count| {
                (
                    count.to_string(),
                    self.set(|settings| settings.wavelengths = count),
                )
            })
            .collect()
    }

    fn has_extended_lights(&self) -> bool {
        let mut lights = self.scene.lights.iter();
        lights.any(|light| matches!(light.kind, LightKind::Area { .. }))
    }

    fn light_samples(&self) -> Vec<Level> {
        self.changed(&[1, 2, 4, 8], |change, count| change.light_samples = Some(count))
    }

    fn rough_rays(&self) -> Vec<Level> {
        self.changed(&[1, 2, 4, 8], |change, count| change.rough_rays = Some(count))
    }

    fn bounces(&self) -> Vec<Level> {
        self.changed(&[1, 2, 4, 8, 16], |change, count| change.bounces = Some(count))
    }

    fn photons(&self) -> Vec<Level> {
        let base = self
            .base
            .change
            .photons
            .or(self.scene.caustics.map(|caustics| caustics.photons));
        let base = base.unwrap_or(Caustics::default().photons);
        // With four times as many photons, the radii of their discs are halved
        let mut counts = vec![base / 4, base, base.saturating_mul(4), base.saturating_mul(16)];
        counts.retain(|count| (1..=Caustics::MAX_PHOTONS).contains(count));
        self.changed(&counts, |change, count| change.photons = Some(count))
    }

    fn changed(&self, counts: &[u32], change: impl Fn(&mut SceneChange, u32)) -> Vec<Level> {
        counts
            .iter()
            .map(|&count| {
                let mut configuration = *self.base;
                change(&mut configuration.change, count);
                (count.to_string(), configuration)
            })
            .collect()
    }

    fn march_steps(&self) -> Vec<Level> {
        [4.0, 2.0, 1.0, 0.5]
            .into_iter()
            .map(|step_factor| {
                let mut configuration = *self.base;
                configuration.change.step_factor = step_factor;
                (step_name(step_factor), configuration)
            })
            .collect()
    }

    fn texture_filter(&self) -> Vec<Level> {
        // The base filters textures, so that the only other level is without.
        let mut removed = self.base.settings.effects.removed;
        removed = removed.with(Effect::TextureFilter);
        let off = self.set(|settings| settings.effects.removed = removed);
        vec![("off".to_owned(), off)]
    }

    fn hit_paths(&self) -> Vec<Level> {
        let mut paths = Vec::new();
        if cfg!(feature = "embree") {
            // Precisions differ in triangles alone: a scene without triangles has one path through Embree.
            let own = match self.base.path.backend {
                Backend::Embree | Backend::Auto => self.base.path.precision,
                Backend::Native | Backend::Bsp | Backend::Brute => Precision::default(),
            };
            let precisions: &[Precision] = if self.has_meshes() {
                &Precision::ALL
            } else {
                &[own]
            };
            paths.extend(precisions.iter().map(|&precision| HitPath {
                backend: Backend::Embree,
                precision,
                instancing: Instancing::Auto,
                ..self.base.path
            }));
        }
        // The native tree holds triangles alone, and the fast BSP differs only for them
        if self.has_meshes() {
            paths.push(HitPath {
                backend: Backend::Native,
                ..HitPath::BSP
            });
            paths.push(HitPath {
                precision: Precision::Fast,
                ..HitPath::BSP
            });
        }
        paths.push(HitPath::BSP);
        self.through(paths.into_iter().map(|path| (path.name(), path)))
    }

    fn through(&self, paths: impl Iterator<Item = (String, HitPath)>) -> Vec<Level> {
        paths
            .map(|(level, path)| (level, Configuration { path, ..*self.base }))
            .collect()
    }

    fn has_meshes(&self) -> bool {
        let mut geometries = self.scene.geometries.iter();
        geometries.any(|geometry| matches!(geometry, Geometry::Mesh(_)))
    }

    fn has_rays_from_surfaces(&self) -> bool {
        let sending = [Effect::Shadow, Effect::Reflection, Effect::Refraction];
        sending.into_iter().any(|effect| self.has(effect))
    }

    fn spawn_points(&self) -> Vec<Level> {
        let fixed = FIXED_OFFSETS.map(SpawnPolicy::Fixed).into_iter();
        [SpawnPolicy::Bounded, SpawnPolicy::None]
            .into_iter()
            .chain(fixed)
            .map(|spawn| (spawn.to_string(), self.set(|settings| settings.spawn = spawn)))
            .collect()
    }

    fn hit_points(&self) -> Vec<Level> {
        [(HitPoint::Refined, "refined"), (HitPoint::Reported, "reported")]
            .into_iter()
            .map(|(point, level)| (level.to_owned(), self.set(|settings| settings.hit_points = point)))
            .collect()
    }

    /// Returns build qualities of Embree's triangle BVHs; the highest only where Embree builds it differently from the
    /// next lower.
    fn build_qualities(&self) -> Vec<Level> {
        let path = self.base.path;
        if path.backend != Backend::Embree || !self.has_meshes() {
            return Vec::new();
        }
        // Embree's high quality differs from medium by spatial splits, which it makes at fast precision only.
        let cuts = path.precision == Precision::Fast;
        let qualities = BuildQuality::ALL.into_iter();
        let apart = qualities.filter(|&quality| cuts || quality != BuildQuality::High);
        self.through(apart.map(|build_quality| {
            let path = HitPath {
                build_quality,
                ..path
            };
            (build_quality.to_string(), path)
        }))
    }

    /// Returns compact and non-compact levels of Embree's triangle BVHs; at [`Precision::Robust`] Embree 3.13.5 has one
    /// layout only.
    fn compactness(&self) -> Vec<Level> {
        let path = self.base.path;
        let has_both = path.precision != Precision::Robust;
        if path.backend != Backend::Embree || !has_both || !self.has_meshes() {
            return Vec::new();
        }
        let levels = [(false, "loose"), (true, "compact")].into_iter();
        self.through(levels.map(|(compact, level)| (level.to_owned(), HitPath { compact, ..path })))
    }

    fn instancings(&self) -> Vec<Level> {
        let is_placed = |geometry: &Geometry| matches!(geometry, Geometry::Mesh(_));
        let mut seen = vec![false; self.scene.geometries.len()];
        // A mesh with a single instance can be given already transformed, so that only a second instance counts.
        let has_placed = self.scene.instances.iter().any(|instance| {
            let geometry = instance.geometry as usize;
            is_placed(&self.scene.geometries[geometry]) && std::mem::replace(&mut seen[geometry], true)
        });
        let path = self.base.path;
        if path.backend != Backend::Embree || path.precision == Precision::Watertight || !has_placed {
            return Vec::new();
        }
        let other = path.instancing.resolved(path.precision).other();
        let path = HitPath {
            instancing: other,
            ..path
        };
        self.through(std::iter::once((other.to_string(), path)))
    }
}
