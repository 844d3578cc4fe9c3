//! Settings of one image as they are requested, before its scene is opened.

use super::aov::AovGroup;
use super::environment::EnvironmentRequest;
use super::error::RequestError;
use super::resolved::{
    ResolvedSettings, check_light_layers, check_memory, check_sample_counts, render_settings,
};
use super::scene_change::SceneChange;
use super::settings::Settings;
use super::tracing::{HitPath, TracingOptions};
use crate::accel::Backend;
use crate::image::{ExrEncoding, PngBits, ToneMap};
use crate::numeric::SpawnPolicy;
use crate::render::{Adaptive, EdgeContrast, Exposure, HitPoint, LightAovs, RenderSettings};
use crate::scene::{CameraPlacement, Effect, EffectOverrides};
use crate::scene_file::Output;

/// Encoding of images, for each file format.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageEncoding {
    /// Encoding of EXR files.
    pub exr: ExrEncoding,
    /// Bit depth of PNG files.
    pub png_bits: PngBits,
}

/// Settings of one image as they are requested, before its scene is opened.
#[derive(Clone, Debug)]
pub struct RenderRequest {
    /// Encoding of the image in its file.
    pub encoding: ImageEncoding,
    /// Requested image settings; the scene may give those that are absent: see [`RenderRequest::resolved`].
    pub output: Output,
    /// Target standard error of pixels for adaptive sampling; absent for a fixed number of samples.
    pub adaptive: Option<f64>,
    /// Contrast with a neighbour, as displayed, above which a pixel gets all samples and below which one; absent for all
    /// samples in every pixel.
    pub edge_contrast: Option<f64>,
    /// Effects that are added or removed.
    pub effects: EffectOverrides,
    /// Groups of channels besides the colours.
    pub aovs: Vec<AovGroup>,
    /// True if the cost of each pixel is recorded even without channels of costs, as a heat map requires.
    pub needs_costs: bool,
    /// True if rays and times by effect are recorded.
    pub needs_ledger: bool,
    /// Path by which hits are found, and threads.
    pub tracing: TracingOptions,
    /// Placement of a camera in place of the scene's own.
    pub camera: Option<CameraPlacement>,
    /// Ambient light and background in place of the scene's, linear RGB.
    pub ambient: Option<[f32; 3]>,
    /// Environment map in place of the scene's background, ambient light and default light.
    pub environment: Option<EnvironmentRequest>,
    /// Changes of every scene: glossy rays, samples of area lights, steps through volumes.
    pub change: SceneChange,
    /// Throughput below which no ray is traced; that of the render settings if absent.
    pub cutoff: Option<f32>,
    /// Policy that offsets the origins of rays that leave a surface.
    pub spawn: SpawnPolicy,
    /// Method that computes the hit points on surfaces.
    pub hit_points: HitPoint,
    /// Seed of the random numbers.
    pub seed: u32,
}

impl RenderRequest {
    /// Returns this request with the given settings in place of its own.
    #[must_use]
    pub fn with(&self, chosen: &Settings) -> RenderRequest {
        let mut request = self.clone();
        request.output.spp = chosen.spp.or(self.output.spp);
        request.output.pattern = chosen.pattern.or(self.output.pattern);
        request.output.depth = chosen.depth.or(self.output.depth);
        request.output.wavelengths = chosen.wavelengths.or(self.output.wavelengths);
        request.output.backend = chosen.backend.or(self.output.backend);
        request.adaptive = chosen.adaptive;
        request.edge_contrast = None;
        if chosen.texture_filter == Some(false) {
            request.effects.removed = self.effects.removed.with(Effect::TextureFilter);
        }
        let path = self.tracing.requested;
        request.tracing.requested = HitPath {
            backend: chosen.backend.unwrap_or(path.backend),
            precision: chosen.precision.unwrap_or(path.precision),
            instancing: chosen.instancing.unwrap_or(path.instancing),
            build_quality: chosen.build_quality.unwrap_or(path.build_quality),
            compact: chosen.compact.unwrap_or(path.compact),
        };
        // Keep the request's glossy rays where the settings have none
        request.change = SceneChange {
            rough_rays: chosen.rough_rays.or(self.change.rough_rays),
            ..chosen.change()
        };
        request.cutoff = chosen.cutoff;
        request.spawn = chosen.spawn.unwrap_or(self.spawn);
        request.hit_points = chosen.hit_points.unwrap_or(self.hit_points);
        request
    }

    /// Returns this request with the backend that the scene's file names in its image settings `output`, unless the
    /// request names one.
    #[must_use]
    pub fn for_output(&self, output: &Output) -> RenderRequest {
        let mut request = self.clone();
        request.tracing.requested.backend = self.output.or(output).backend.unwrap_or(self.backend());
        request
    }

    /// Returns the intersection backend that finds the hits.
    pub fn backend(&self) -> Backend {
        self.tracing.requested.backend
    }

    /// Returns whether any requested channels are not sums over samples.
    pub fn has_first_hit_aovs(&self) -> bool {
        self.aovs.iter().any(|aov| *aov != AovGroup::Samples)
    }

    /// Returns whether the image must be rendered in one piece: pixels depend on each other, or on the time of
    /// rendering.
    pub fn must_render_at_once(&self) -> bool {
        self.adaptive.is_some() || self.records_costs()
    }

    /// Returns whether the cost of each pixel is recorded.
    fn records_costs(&self) -> bool {
        let is_cost = |aov: &AovGroup| matches!(aov, AovGroup::Rays | AovGroup::Time);
        self.needs_costs || self.aovs.iter().any(is_cost)
    }

    /// Returns the settings for a scene whose file gives the image settings `output`.
    ///
    /// # Errors
    ///
    /// If settings conflict, or the image does not fit into memory.
    pub fn resolved(&self, output: &Output) -> Result<ResolvedSettings, RequestError> {
        // The request takes precedence over the scene
        let requested = self.output.or(output);
        let exposure_ev = requested.exposure.unwrap_or(0.0);
        let cost_aovs = self.records_costs();
        let usual = render_settings(&requested)?;
        let settings = RenderSettings {
            adaptive: self.adaptive.map(|error| Adaptive {
                error,
                gain: f64::from(exposure_ev).exp2(),
            }),
            edge_contrast: self.edge_contrast.map(|limit| EdgeContrast {
                limit,
                exposure: Exposure::Stops(exposure_ev),
            }),
            sample_aovs: self.aovs.contains(&AovGroup::Samples),
            layers: self.aovs.iter().filter_map(|aov| aov.layers()).collect(),
            light_layers: LightAovs {
                lights: self.aovs.contains(&AovGroup::Lights),
                effects: self.aovs.contains(&AovGroup::Effects),
            },
            cost_aovs,
            effects: self.effects,
            seed: self.seed,
            spawn: self.spawn,
            hit_points: self.hit_points,
            ledger: self.needs_ledger || cost_aovs,
            weight_cutoff: self.cutoff.unwrap_or(usual.weight_cutoff),
            ..usual
        };
        check_sample_counts(&settings)?;
        check_light_layers(&settings)?;
        // The number of lights is unknown here, so the check counts none.
        check_memory(&settings, 0)?;
        Ok(ResolvedSettings {
            settings,
            tone: ToneMap { exposure_ev },
            operator: requested.tone_map.unwrap_or_default(),
        })
    }
}
