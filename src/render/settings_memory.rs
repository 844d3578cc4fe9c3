//! Memory per pixel that a render needs, by its settings.

use super::adaptive;
use super::aov::PixelCosts;
use super::film::PixelStatistics;
use super::settings::RenderSettings;

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
        // The transparency has a film of its own, and a channel that is counted twice, too.
        let film = size_of::<[f32; 3]>() as u64 + self.filter.bytes_per_pixel();
        let alpha = match self.has_alpha() {
            true => film + 2 * size_of::<f32>() as u64,
            false => 0,
        };
        // Pixels at edges are kept beside the image of first samples
        let edges = self.contrast().map_or(0, |_| size_of::<[f32; 3]>());
        (estimates + aovs + layers + light + costs + edges) as u64 + self.filter.bytes_per_pixel() + alpha
    }
}
