//! What can be turned, and how far.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::configuration::{Configuration, HitPath, SceneChange, cutoff_name, pattern_name, step_name};
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{Adaptive, FilterKind, HitPoint, Pattern, Plan, RenderSettings};
use crate::scene::{Effect, Geometry, LightKind, Scene};

/// Parts of the scene's size by which rays start off surfaces, in place of a bound on the error: what is usual, and what
/// is too little and too much of it.
const FIXED_OFFSETS: [f64; 3] = [1e-7, 1e-5, 1e-3];

/// Something that trades error for seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Knob {
    /// Samples a pixel.
    Samples,
    /// How they lie in the pixel.
    Pattern,
    /// The standard error that ends the sampling of a pixel.
    Adaptive,
    /// Generations of reflected and refracted rays.
    Depth,
    /// The weight under which a ray is not followed.
    Cutoff,
    /// Wavelengths that a path splits into.
    Wavelengths,
    /// Points of each extended light that a surface asks.
    LightSamples,
    /// Rays into the lobe of a rough surface.
    RoughRays,
    /// Length of the steps through volumes.
    MarchStep,
    /// Whether textures are averaged over what a ray covers.
    TextureFilter,
    /// What finds the hits, and how far triangle hits may be trusted.
    HitPath,
    /// How Embree is given placed meshes.
    Instancing,
    /// How much work Embree puts into its trees.
    BuildQuality,
    /// Whether Embree saves memory rather than time.
    Compactness,
    /// Where rays start that leave surfaces.
    SpawnPoints,
    /// Whether hits are worked out again in f64.
    HitRefinement,
}

impl Knob {
    /// All.
    pub const ALL: [Knob; 16] = [
        Knob::Samples,
        Knob::Pattern,
        Knob::Adaptive,
        Knob::Depth,
        Knob::Cutoff,
        Knob::Wavelengths,
        Knob::LightSamples,
        Knob::RoughRays,
        Knob::MarchStep,
        Knob::TextureFilter,
        Knob::HitPath,
        Knob::Instancing,
        Knob::BuildQuality,
        Knob::Compactness,
        Knob::SpawnPoints,
        Knob::HitRefinement,
    ];

    /// What reports call it.
    pub const fn name(self) -> &'static str {
        match self {
            Knob::Samples => "samples",
            Knob::Pattern => "pattern",
            Knob::Adaptive => "adaptive",
            Knob::Depth => "depth",
            Knob::Cutoff => "cut-off",
            Knob::Wavelengths => "wavelengths",
            Knob::LightSamples => "light samples",
            Knob::RoughRays => "rough rays",
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

    /// Whether its places lie in an order along which the error falls.
    pub const fn is_graded(self) -> bool {
        matches!(
            self,
            Knob::Samples
                | Knob::Adaptive
                | Knob::Depth
                | Knob::Cutoff
                | Knob::Wavelengths
                | Knob::LightSamples
                | Knob::RoughRays
                | Knob::MarchStep
        )
    }
}

impl fmt::Display for Knob {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How far the knobs of sampling are turned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reach {
    /// The most samples of a pixel.
    pub samples: u32,
    /// The same of adaptive sampling.
    pub adaptive_samples: u32,
    /// The standard errors as displayed that end it.
    pub adaptive_errors: Vec<f64>,
}

impl Reach {
    /// Up to so many samples.
    pub fn of(samples: u32) -> Reach {
        Reach {
            samples,
            adaptive_samples: samples,
            adaptive_errors: vec![0.04, 0.02, 0.01, 0.005],
        }
    }
}

/// The places to which a scene's knobs are turned, each by itself with all others as in `base`: those that `plan` makes
/// relevant, no others.
pub fn knobs(
    scene: &Scene,
    plan: &Plan,
    base: &Configuration,
    reach: &Reach,
) -> Vec<(Knob, String, Configuration)> {
    let turns = Turns {
        scene,
        plan,
        base,
        reach,
    };
    let all = Knob::ALL.into_iter().flat_map(|knob| {
        let levels = turns.levels(knob).into_iter();
        levels.map(move |(level, configuration)| (knob, level, configuration))
    });
    // What turns to where it is already is the base.
    all.filter(|(_, _, configuration)| configuration != base)
        .collect()
}

struct Turns<'a> {
    scene: &'a Scene,
    plan: &'a Plan,
    base: &'a Configuration,
    reach: &'a Reach,
}

type Level = (String, Configuration);

impl Turns<'_> {
    fn has(&self, effect: Effect) -> bool {
        self.plan.effects().has(effect)
    }

    /// With other settings.
    fn set(&self, change: impl Fn(&mut RenderSettings)) -> Configuration {
        let mut configuration = *self.base;
        change(&mut configuration.settings);
        configuration
    }

    fn levels(&self, knob: Knob) -> Vec<Level> {
        let bounces = self.has(Effect::Reflection) || self.has(Effect::Refraction);
        match knob {
            Knob::Samples => self.samples(),
            Knob::Pattern => self.patterns(),
            Knob::Adaptive => self.adaptive(),
            Knob::Depth if bounces => self.depths(),
            Knob::Cutoff if bounces => self.cutoffs(),
            Knob::Wavelengths if self.has(Effect::Dispersion) => self.wavelengths(),
            Knob::LightSamples if self.has_extended_lights() => self.light_samples(),
            Knob::RoughRays if self.has(Effect::RoughReflection) => self.rough_rays(),
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
        let powers = (0..32).map(|power| 1u32 << power);
        powers
            .take_while(|&spp| spp <= self.reach.samples)
            .map(|spp| (spp.to_string(), self.set(|settings| settings.spp = spp)))
            .collect()
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

    /// Up to the most samples; needs a box, a pattern whose samples go on, and nobody who wants layers.
    fn adaptive(&self) -> Vec<Level> {
        let settings = &self.base.settings;
        let fits = settings.filter.kind == FilterKind::Box
            && settings.pattern != Pattern::Regular
            && settings.layers.is_empty()
            && settings.light_layers.is_empty();
        // Every pixel takes sixteen.
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
        let mut depths: Vec<u32> = (0..=4).chain([6, 8, 12]).collect();
        depths.retain(|&depth| depth <= self.base.settings.depth.max(2) * 3);
        depths
            .into_iter()
            .map(|depth| (depth.to_string(), self.set(|settings| settings.depth = depth)))
            .collect()
    }

    fn cutoffs(&self) -> Vec<Level> {
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
        self.changed([1, 2, 4, 8], |change, count| change.light_samples = Some(count))
    }

    fn rough_rays(&self) -> Vec<Level> {
        self.changed([1, 2, 4, 8], |change, count| change.rough_rays = Some(count))
    }

    fn changed(&self, counts: [u32; 4], change: impl Fn(&mut SceneChange, u32)) -> Vec<Level> {
        counts
            .into_iter()
            .map(|count| {
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
        let mut removed = self.base.settings.effects.removed;
        removed = removed.with(Effect::TextureFilter);
        let off = self.set(|settings| settings.effects.removed = removed);
        vec![("off".to_owned(), off)]
    }

    fn hit_paths(&self) -> Vec<Level> {
        let mut paths = Vec::new();
        if cfg!(feature = "embree") {
            // Precisions differ in triangles alone: without any, there is one path through Embree.
            let own = match self.base.path.backend {
                Backend::Embree => self.base.path.precision,
                Backend::Bsp | Backend::Brute => Precision::default(),
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
        if self.has_meshes() {
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

    /// Of Embree's trees over triangles; the highest where Embree makes a difference between it and the next.
    fn build_qualities(&self) -> Vec<Level> {
        let path = self.base.path;
        if path.backend != Backend::Embree || !self.has_meshes() {
            return Vec::new();
        }
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

    /// Of Embree's trees over triangles; at [`Precision::Robust`] Embree 3.13.5 has one form of them only.
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
        // A mesh that stands once may be given where it stands.
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
