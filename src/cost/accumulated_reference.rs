//! Reference image in two halves, each the mean of several images.

use super::SplitReference;
use crate::image::LinearImage;

/// Reference in two halves, with linear means and displayed values.
pub(super) struct AccumulatedReference {
    /// Number of images per half, all of equal spp.
    pub(super) count: u32,
    /// Mean linear image of each half.
    pub(super) means: [LinearImage; 2],
    /// Means of both halves in displayed values.
    pub(super) halves: SplitReference,
    /// Seconds to render one image for each half.
    pub(super) seconds: f64,
}

impl AccumulatedReference {
    /// Returns a reference from the halves' means over `count` images each.
    pub(super) fn new(count: u32, means: [LinearImage; 2], halves: SplitReference) -> AccumulatedReference {
        AccumulatedReference {
            count,
            means,
            halves,
            seconds: 0.0,
        }
    }

    /// Returns the linear mean images of both halves.
    pub(super) fn means(&self) -> &[LinearImage; 2] {
        &self.means
    }

    /// Returns the linear mean image of both halves.
    pub(super) fn mean(&self) -> LinearImage {
        let mut mean = self.means[0].clone();
        blend(&mut mean, &self.means[1], 0.5);
        mean
    }
}

/// Interpolates `image` linearly towards `other`; `part` = 1 replaces it.
pub(super) fn blend(image: &mut LinearImage, other: &LinearImage, part: f32) {
    for (pixel, other) in image.pixels.iter_mut().zip(&other.pixels) {
        for (channel, other) in pixel.iter_mut().zip(other) {
            *channel += part * (other - *channel);
        }
    }
}
