//! What follows from a picture's settings alone.

use super::adaptive::{self, Adaptive, ROUND};
use super::estimate::Estimate;
use super::sampler::{Purpose, sample_2d};
use super::{LightLayers, PixelCosts, RenderSettings};
use crate::scene::CameraView;
use crate::shading::ray_cone::Cone;

impl RenderSettings {
    /// Bytes that filters, adaptive sampling and AOVs take for each pixel of a scene with so many lights, beyond the
    /// picture itself.
    pub fn sampling_bytes_per_pixel(&self, light_count: usize) -> u64 {
        let estimates = if self.target().is_some() || self.sample_aovs {
            // The tiles' and the picture's.
            2 * size_of::<Estimate>() + adaptive::LOOK_BYTES
        } else {
            0
        };
        let aovs = if self.sample_aovs {
            // As rendered and on their way into a file, with the colours' planes.
            2 * 2 * size_of::<f32>() + 3 * size_of::<f32>()
        } else {
            0
        };
        let costs = if self.cost_aovs {
            // As counted, and every channel on its way into a file.
            3 * PixelCosts::BYTES
        } else {
            0
        };
        // Put together, and on their way into a file.
        let layers = 2 * self.layers.layer_count() * size_of::<f32>();
        let light = 2 * 3 * self.wanted_light().most_planes(light_count) * size_of::<f32>();
        (estimates + aovs + layers + light + costs) as u64 + self.filter.bytes_per_pixel()
    }

    /// The pair of numbers that sample `sample` of `pixel` (column and row) has for `purpose`.
    pub(super) fn numbers(&self, pixel: [u32; 2], sample: u32, purpose: Purpose) -> [f64; 2] {
        sample_2d(self.pattern, pixel, sample, self.spp, purpose.seeded(self.seed))
    }

    /// The cone of one of `count` even samples: a pixel's, by the root of their number narrower each way.
    pub(super) fn camera_cone(&self, view: &CameraView, count: u32) -> Cone {
        let pixel = Cone::of_pixel(view, [0.5, 0.5], [self.width, self.height]);
        let part = f64::from(count).sqrt().recip();
        Cone {
            width: pixel.width * part,
            spread: pixel.spread * part,
        }
    }

    /// The layers of light that can be had.
    pub(super) fn wanted_light(&self) -> LightLayers {
        if self.target().is_some() || !self.filter.is_box() {
            return LightLayers::NONE;
        }
        self.light_layers
    }

    /// The target of adaptive sampling, where there is anything to adapt.
    pub(super) fn target(&self) -> Option<Adaptive> {
        self.adaptive.filter(|_| self.spp > ROUND)
    }
}
