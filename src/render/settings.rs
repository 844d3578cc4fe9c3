//! Settings of a render, and quantities that depend on them alone.

use serde::{Deserialize, Serialize};

use super::adaptive::{Adaptive, ROUND};
use super::aov::{AovSet, LightAovs};
use super::automatic_exposure::Exposure;
use super::edge_contrast::EdgeContrast;
use super::film::PixelFilter;
use super::sampler::{Purpose, sample_2d};
use crate::numeric::SpawnPolicy;
use crate::scene::image_settings::{
    DEFAULT_DEPTH, DEFAULT_SIZE, DEFAULT_WAVELENGTHS, Pattern, VisibleBackground,
};
use crate::scene::{CameraView, EffectOverrides};
use crate::shading::ray_cone::RayCone;
use crate::volume::SkipEmpty;

/// Image size, sampling, effects and outputs of one render.
///
/// Construct it with `..RenderSettings::default()`: further fields may be added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels per row; at least 1.
    pub width: u32,
    /// Number of rows; at least 1.
    pub height: u32,
    /// Samples per pixel; at least 1. With `adaptive` or `edge_contrast` this is the maximum.
    pub spp: u32,
    /// Pattern of the sample positions in the pixel.
    pub pattern: Pattern,
    /// Seed of the random numbers. The errors of two images with different seeds are independent, except for the
    /// positions in the pixel of patterns that use no random numbers.
    pub seed: u32,
    /// Reconstruction filter that weighs the samples into pixels.
    pub filter: PixelFilter,
    /// Stopping criterion of adaptive sampling; `None` gives every pixel `spp` samples.
    ///
    /// Treats the filter as a box, because unequal numbers of samples would weigh the neighbours of a pixel
    /// unequally. Has no effect up to 16 samples per pixel, the minimum that every pixel gets; needs a pattern that
    /// can be continued, so not a regular one.
    pub adaptive: Option<Adaptive>,
    /// Contrast above which a pixel gets `spp` samples, and one otherwise; `None` gives `spp` to every pixel.
    ///
    /// Treats the filter as a box, as `adaptive` does. Has no effect with `adaptive`, or with one sample per pixel.
    pub edge_contrast: Option<EdgeContrast>,
    /// True if [`Rendering::aovs`](super::Rendering::aovs) are computed. They change no bit of the image.
    pub sample_aovs: bool,
    /// Layers (AOVs) that [`Rendering::layers`](super::Rendering::layers) holds. They change no bit of the image.
    /// They are ignored with `adaptive` and `edge_contrast`.
    pub layers: AovSet,
    /// Layers of light (per light or per effect), appended to [`Rendering::layers`](super::Rendering::layers). They
    /// change no bit of the image. They need samples that count equally and for their own pixel only: with `adaptive`,
    /// `edge_contrast` or a `filter` other than a box they are ignored.
    pub light_layers: LightAovs,
    /// Background at the end of camera rays that go straight into the distance. With a transparent one,
    /// [`Rendering::alpha`](super::Rendering::alpha) is computed, except with `adaptive` or `edge_contrast`.
    pub background: VisibleBackground,
    /// Largest number of reflections and refractions along a path; 0 for none.
    pub depth: u32,
    /// Number of wavelengths that a path splits into at a dispersive dielectric; at least 1.
    pub wavelengths: u32,
    /// Smallest throughput of a secondary ray: the ray is not traced if all channels are below this.
    pub weight_cutoff: f32,
    /// Rule for the origins of rays that leave surfaces.
    pub spawn: SpawnPolicy,
    /// Rule for the positions of hit points on surfaces.
    pub hit_points: HitPoint,
    /// Skipping of empty space in ray marching. It changes no bit of the image.
    pub skip_empty: SkipEmpty,
    /// Effects that are switched on or off against the needs of the scene.
    pub effects: EffectOverrides,
    /// True if [`Rendering::ledger`](super::Rendering::ledger) records times per account. When off, the clock is
    /// read only at both ends of the render and before the first sample; rays are counted either way. It changes no
    /// bit of the image.
    pub ledger: bool,
    /// Exposure before display if [`Rendering::error`](super::Rendering::error) is to be estimated, which
    /// takes about 2 % of the time in addition; `None` for no estimate. It changes no bit of the image.
    pub error_exposure: Option<Exposure>,
    /// True if [`Rendering::costs`](super::Rendering::costs) are computed, for which `ledger` must be on. They change
    /// no bit of the image, but make rendering slower.
    pub cost_aovs: bool,
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings {
            width: DEFAULT_SIZE[0],
            height: DEFAULT_SIZE[1],
            spp: 1,
            pattern: Pattern::default(),
            seed: 0,
            filter: PixelFilter::default(),
            adaptive: None,
            edge_contrast: None,
            sample_aovs: false,
            layers: AovSet::NONE,
            light_layers: LightAovs::NONE,
            background: VisibleBackground::default(),
            depth: DEFAULT_DEPTH,
            wavelengths: DEFAULT_WAVELENGTHS,
            weight_cutoff: 1.0 / 512.0,
            spawn: SpawnPolicy::default(),
            hit_points: HitPoint::default(),
            skip_empty: SkipEmpty::default(),
            effects: EffectOverrides::default(),
            ledger: false,
            error_exposure: None,
            cost_aovs: false,
        }
    }
}

/// Rule for the position of a hit on its surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum HitPoint {
    /// Computed in f64 from the primitive: from the vertices of a triangle, from the equation of an analytic shape.
    #[default]
    Refined,
    /// Computed in f32 along the ray, at the f32 parameter that the backend reports.
    Reported,
}

impl RenderSettings {
    /// Returns the settings of an image without AOVs of any kind.
    pub(crate) fn without_aovs(self) -> RenderSettings {
        RenderSettings {
            sample_aovs: false,
            layers: AovSet::NONE,
            light_layers: LightAovs::NONE,
            cost_aovs: false,
            ..self
        }
    }

    /// Returns the random pair of sample `sample` of `pixel` (column and row) for `purpose`.
    pub(super) fn numbers(&self, pixel: [u32; 2], sample: u32, purpose: Purpose) -> [f64; 2] {
        sample_2d(self.pattern, pixel, sample, self.spp, purpose.seeded(self.seed))
    }

    /// Returns the ray cone of one of `count` evenly distributed samples: that of the pixel, divided by the root of
    /// their number.
    pub(super) fn camera_cone(&self, view: &CameraView, count: u32) -> RayCone {
        let pixel = RayCone::of_pixel(view, [0.5, 0.5], [self.width, self.height]);
        let part = f64::from(count).sqrt().recip();
        RayCone {
            width: pixel.width * part,
            spread: pixel.spread * part,
        }
    }

    /// Returns the layers of light that can be computed with these settings.
    pub(super) fn wanted_light(&self) -> LightAovs {
        if !(self.has_equal_counts() && self.filter.is_box()) {
            return LightAovs::NONE;
        }
        self.light_layers
    }

    /// Returns whether the image gets an alpha channel.
    pub(super) fn has_alpha(&self) -> bool {
        self.background == VisibleBackground::Transparent && self.has_equal_counts()
    }

    /// Returns the target of adaptive sampling, if `spp` allows more than the first round.
    pub(super) fn target(&self) -> Option<Adaptive> {
        self.adaptive.filter(|_| self.spp > ROUND)
    }

    /// Returns the contrast above which pixels get all samples, if some may get fewer.
    pub(super) fn contrast(&self) -> Option<EdgeContrast> {
        self.edge_contrast
            .filter(|_| self.adaptive.is_none() && self.spp > 1)
    }

    /// Returns whether every pixel gets the same number of samples.
    pub(super) fn has_equal_counts(&self) -> bool {
        self.target().is_none() && self.contrast().is_none()
    }

    /// Returns the distance in pixels that a sample affects beyond its own pixel; where pixels get different numbers of
    /// samples, every filter is treated as a box.
    pub(super) fn reach(&self) -> u32 {
        if self.filter.is_box() || !self.has_equal_counts() {
            0
        } else {
            self.filter.reach() as u32
        }
    }
}
