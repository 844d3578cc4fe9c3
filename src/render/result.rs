//! Finished image with its statistics.

use super::aov::{Layer, PixelCosts};
use super::context::RenderContext;
use super::film::{SampleAovs, SampleCounts};
use super::plan::Plan;
use super::profile::{Memory, RenderProfile};
use super::subset::ImageError;
use super::subsurface::SubsurfaceStats;
use crate::image::LinearImage;

/// Finished image with its statistics.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Rendering {
    /// Linear RGB radiance of the pixels.
    pub image: LinearImage,
    /// Coverage (alpha) of each pixel, row by row, if the [`background`](super::RenderSettings::background) is
    /// transparent: the colours are premultiplied by it.
    pub alpha: Option<Vec<f32>>,
    /// Number of samples that each pixel took.
    pub samples: SampleCounts,
    /// Sample statistics per pixel, if [`sample_aovs`](super::RenderSettings::sample_aovs) is on.
    pub aovs: Option<SampleAovs>,
    /// AOVs of the first hits of camera rays, and layers of light, if [`layers`](super::RenderSettings::layers) or
    /// [`light_layers`](super::RenderSettings::light_layers) request any.
    pub layers: Vec<Layer>,
    /// Cost of each pixel, if [`cost_aovs`](super::RenderSettings::cost_aovs) is on.
    pub costs: Option<PixelCosts>,
    /// Estimated error, if [`error_exposure`](super::RenderSettings::error_exposure) requests it. Its rays and seconds are in no
    /// account.
    pub error: Option<ImageError>,
    /// Numbers of rays and seconds, by account.
    pub ledger: RenderProfile,
    /// Seconds before the first sample: mip levels, light tables, subsurface irradiance. Mostly independent of the
    /// image size.
    pub ready_seconds: f64,
    /// Memory use in bytes; empty with the ledger off.
    pub memory: Memory,
    /// Effects that were simulated, with the reason for each.
    pub plan: Plan,
    /// Statistics of subsurface scattering, if any object has it.
    pub subsurface: Option<SubsurfaceStats>,
}

impl Rendering {
    /// Returns a rendering without its optional outputs.
    pub(super) fn new(
        image: LinearImage,
        samples: SampleCounts,
        ledger: RenderProfile,
        frame: &RenderContext,
    ) -> Rendering {
        Rendering {
            image,
            alpha: None,
            samples,
            aovs: None,
            layers: Vec::new(),
            costs: None,
            error: None,
            ledger,
            ready_seconds: 0.0,
            memory: Memory::default(),
            plan: frame.plan.clone(),
            subsurface: None,
        }
    }
}
