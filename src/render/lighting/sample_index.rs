//! Indices of random samples of a pixel, from which their random numbers follow.

use super::super::film::pixel_of;
use super::super::sampler::Purpose;
use super::super::settings::RenderSettings;
use super::super::tile::TILE;

/// Index of a light sample: `number` of `of` samples for `purpose`.
#[derive(Clone, Copy)]
pub(in crate::render) struct SampleIndex {
    pub(in crate::render) purpose: Purpose,
    pub(in crate::render) number: u32,
    pub(in crate::render) of: u32,
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
