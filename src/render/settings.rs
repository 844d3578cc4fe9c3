//! Quantities that depend on the settings of an image alone.

use super::adaptive::{self, Adaptive, ROUND};
use super::estimate::PixelStatistics;
use super::sampler::{Purpose, sample_2d};
use super::{LightAovs, PixelCosts, RenderSettings};
use crate::scene::CameraView;
use crate::shading::ray_cone::Cone;

impl RenderSettings {
    /// Returns the bytes per pixel that filters, adaptive sampling and AOVs need in addition to the image itself, for
    /// a scene with `light_count` lights.
    pub fn sampling_bytes_per_pixel(&self, light_count: usize) -> u64 {
        // Add statistics of single samples
        let estimates = if self.target().is_some() || self.sample_aovs {
            // Counted twice: for the tiles and for the image.
            2 * size_of::<PixelStatistics>() + adaptive::LOOK_BYTES
        } else {
            0
        };
        let aovs = if self.sample_aovs {
            // Two values per pixel, as rendered and when written to a file, with the three colour channels of the
            // file.
            2 * 2 * size_of::<f32>() + 3 * size_of::<f32>()
        } else {
            0
        };
        let costs = if self.cost_aovs {
            // Counted three times: as recorded, and every channel when written to a file.
            3 * PixelCosts::BYTES
        } else {
            0
        };
        // Layers are counted twice: as rendered and when written to a file.
        let layers = 2 * self.layers.layer_count() * size_of::<f32>();
        let light = 2 * 3 * self.wanted_light().max_planes(light_count) * size_of::<f32>();
        (estimates + aovs + layers + light + costs) as u64 + self.filter.bytes_per_pixel()
    }

    /// Returns the random pair of sample `sample` of `pixel` (column and row) for `purpose`.
    pub(super) fn numbers(&self, pixel: [u32; 2], sample: u32, purpose: Purpose) -> [f64; 2] {
        sample_2d(self.pattern, pixel, sample, self.spp, purpose.seeded(self.seed))
    }

    /// Returns the ray cone of one of `count` evenly distributed samples: that of the pixel, divided by the root of
    /// their number.
    pub(super) fn camera_cone(&self, view: &CameraView, count: u32) -> Cone {
        let pixel = Cone::of_pixel(view, [0.5, 0.5], [self.width, self.height]);
        let part = f64::from(count).sqrt().recip();
        Cone {
            width: pixel.width * part,
            spread: pixel.spread * part,
        }
    }

    /// Returns the layers of light that can be computed with these settings.
    pub(super) fn wanted_light(&self) -> LightAovs {
        if self.target().is_some() || !self.filter.is_box() {
            return LightAovs::NONE;
        }
        self.light_layers
    }

    /// Returns the target of adaptive sampling, if `spp` allows more than the first round.
    pub(super) fn target(&self) -> Option<Adaptive> {
        self.adaptive.filter(|_| self.spp > ROUND)
    }
}
