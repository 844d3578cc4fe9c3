//! Settings of a render that a study chooses and a settings file holds.

use serde::{Deserialize, Serialize};

use super::scene_change::SceneChange;
use super::tracing::HitPath;
use crate::accel::{Backend, BuildQuality, Instancing, Precision};
use crate::numeric::SpawnPolicy;
use crate::render::{HitPoint, MIN_ADAPTIVE_ERROR, Pattern, RenderSettings};
use crate::scene::image_settings::{MAX_DEPTH, MAX_SPP, MAX_WAVELENGTHS};
use crate::scene::{Caustics, Effect, Interreflection, MAX_LIGHT_SAMPLES, MAX_ROUGH_RAYS};

/// Largest factor by which march steps may be longer or shorter than the scene's.
const MAX_STEP_FACTOR: f64 = 1024.0;

/// Settings of a render that can be chosen; an absent one keeps the value that the render has without the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Samples per pixel; with `adaptive` the largest number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spp: Option<u32>,
    /// Sampling pattern within the pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pattern: Option<Pattern>,
    /// Standard error, in displayed values, that ends the sampling of a pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adaptive: Option<f64>,
    /// Maximum depth: bounces of reflected and refracted rays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth: Option<u32>,
    /// Path weight (throughput) below which a ray is not followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cutoff: Option<f32>,
    /// Wavelengths that a path splits into at dispersion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wavelengths: Option<u32>,
    /// Samples per area light and shading point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub light_samples: Option<u32>,
    /// Rays per shading point into the lobe of a rough surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rough_rays: Option<u32>,
    /// Largest number of bounces of interreflection, in scenes that request it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bounces: Option<u32>,
    /// Photons of caustics, in scenes that request them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photons: Option<u32>,
    /// Length of the march steps through volumes, relative to the scene's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub march_step: Option<f64>,
    /// Texture filtering over the ray's footprint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_filter: Option<bool>,
    /// Intersection backend that finds the hits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backend: Option<Backend>,
    /// Precision of triangle hits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<Precision>,
    /// Way in which Embree represents instanced meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instancing: Option<Instancing>,
    /// Build quality of Embree's BVHs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub build_quality: Option<BuildQuality>,
    /// Embree's compact mode, which saves memory rather than time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compact: Option<bool>,
    /// Denoising of the finished image by Open Image Denoise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub denoise: Option<bool>,
    /// Policy for the origins of rays that leave surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spawn: Option<SpawnPolicy>,
    /// Computation of hit points on surfaces.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hit_points: Option<HitPoint>,
}

impl Settings {
    /// Returns all settings of a render with hits found by `path`, in a scene with the given changes.
    pub fn of(settings: &RenderSettings, path: &HitPath, change: &SceneChange) -> Settings {
        let SceneChange {
            light_samples,
            rough_rays,
            bounces,
            photons,
            step_factor,
        } = *change;
        Settings {
            spp: Some(settings.spp),
            pattern: Some(settings.pattern),
            adaptive: settings.adaptive.map(|adaptive| adaptive.error),
            depth: Some(settings.depth),
            cutoff: Some(settings.weight_cutoff),
            wavelengths: Some(settings.wavelengths),
            light_samples,
            rough_rays,
            bounces,
            photons,
            march_step: (step_factor != 1.0).then_some(step_factor),
            texture_filter: settings
                .effects
                .removed
                .has(Effect::TextureFilter)
                .then_some(false),
            backend: Some(path.backend),
            precision: Some(path.precision),
            instancing: Some(path.instancing),
            build_quality: Some(path.build_quality),
            compact: path.compact.then_some(true),
            denoise: None,
            spawn: Some(settings.spawn),
            hit_points: Some(settings.hit_points),
        }
    }

    /// Returns the changes of the scene itself.
    pub fn change(&self) -> SceneChange {
        SceneChange {
            light_samples: self.light_samples,
            rough_rays: self.rough_rays,
            bounces: self.bounces,
            photons: self.photons,
            step_factor: self.march_step.unwrap_or(1.0),
        }
    }

    /// Returns the name of the first setting that is out of range, with the valid range.
    pub(crate) fn find_out_of_range(&self) -> Option<(&'static str, String)> {
        // List values with their valid ranges
        let counts = [
            ("spp", self.spp, 1, MAX_SPP),
            ("depth", self.depth, 0, MAX_DEPTH),
            ("wavelengths", self.wavelengths, 1, MAX_WAVELENGTHS),
            ("light_samples", self.light_samples, 1, MAX_LIGHT_SAMPLES),
            ("rough_rays", self.rough_rays, 0, MAX_ROUGH_RAYS),
            ("bounces", self.bounces, 1, Interreflection::MAX_BOUNCES),
            ("photons", self.photons, 1, Caustics::MAX_PHOTONS),
        ];
        // Continuous values have an inclusive range, too
        let sizes = [
            ("adaptive", self.adaptive, MIN_ADAPTIVE_ERROR, 1.0),
            ("cutoff", self.cutoff.map(f64::from), 0.0, 1.0),
            (
                "march_step",
                self.march_step,
                1.0 / MAX_STEP_FACTOR,
                MAX_STEP_FACTOR,
            ),
        ];
        // Find the first value out of its range; NaN is in no range, so that it is rejected
        let counts = counts.into_iter().map(|(name, value, low, high)| {
            let is_wrong = value.is_some_and(|value| !(low..=high).contains(&value));
            (is_wrong, name, format!("{low} to {high}"))
        });
        let sizes = sizes.into_iter().map(|(name, value, low, high)| {
            let is_wrong = value.is_some_and(|value| !(low..=high).contains(&value));
            (is_wrong, name, format!("{low} to {high}"))
        });
        let mut all = counts.chain(sizes);
        all.find(|(is_wrong, _, _)| *is_wrong)
            .map(|(_, name, range)| (name, range))
    }
}
