//! Indices of random samples of a pixel, from which their random numbers follow.

use super::super::film::pixel_of;
use super::super::sampler::{Purpose, number_packet};
use super::super::settings::RenderSettings;
use super::super::tile::TILE;
use crate::numeric::{LANES, Lanes};

/// Index of a light sample: `number` of `of` samples for `purpose`.
#[derive(Clone, Copy)]
pub(in crate::render) struct SampleIndex {
    pub(in crate::render) purpose: Purpose,
    pub(in crate::render) number: u32,
    pub(in crate::render) of: u32,
}

impl SampleIndex {
    /// Returns the random pairs for this draw of sixteen rays: of their labels on the film and their pixel samples.
    #[inline(always)]
    pub(in crate::render) fn number_packet(
        self,
        corner: [u32; 2],
        labels: &Lanes<u32>,
        samples: &Lanes<u32>,
        settings: &RenderSettings,
    ) -> [Lanes<f64>; 2] {
        let mut pixels = [[0; LANES]; 2];
        let mut indices = [0; LANES];
        for l in 0..LANES {
            let pixel = pixel_of(labels[l]);
            pixels[0][l] = corner[0] + pixel % TILE;
            pixels[1][l] = corner[1] + pixel / TILE;
            // The draws of all samples of a pixel form one stratified set.
            indices[l] = samples[l].wrapping_mul(self.of).wrapping_add(self.number);
        }
        number_packet(&pixels, &indices, self.purpose.seeded(settings.seed))
    }
}

/// Pixel and pixel sample that a ray belongs to.
#[derive(Clone, Copy)]
pub(in crate::render) struct PixelSample {
    /// Column and row of the film's first pixel in the image.
    pub(in crate::render) corner: [u32; 2],
    /// Label of the ray on the film.
    pub(in crate::render) label: u32,
    pub(in crate::render) sample: u32,
}

impl PixelSample {
    /// Returns the random pair for one draw.
    pub(in crate::render) fn numbers(&self, settings: &RenderSettings, draw: SampleIndex) -> [f64; 2] {
        let pixel = pixel_of(self.label);
        let pixel = [self.corner[0] + pixel % TILE, self.corner[1] + pixel / TILE];
        // The draws of all samples of a pixel form one stratified set.
        let index = self.sample.wrapping_mul(draw.of).wrapping_add(draw.number);
        settings.numbers(pixel, index, draw.purpose)
    }
}
