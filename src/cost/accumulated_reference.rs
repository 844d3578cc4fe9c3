//! Reference image in two halves, each the mean of several images.

use super::SplitReference;
use super::noise_stratum::NoiseStratum;
use crate::image::LinearImage;

/// Reference in two halves, with linear means and displayed values.
pub(super) struct AccumulatedReference {
    /// Mean linear image of each half.
    pub(super) means: [LinearImage; 2],
    /// Means of both halves in displayed values.
    pub(super) halves: SplitReference,
    /// Parts of the pixels with equal numbers of images, all of equal spp.
    pub(super) strata: Vec<NoiseStratum>,
    /// Number of images that were rendered for each half, which selects the random numbers of the next.
    pub(super) rendered: u32,
}

impl AccumulatedReference {
    /// Returns a reference from the halves' means, with at least `count` images of each pixel, to which none is added.
    pub(super) fn finished(
        count: u32,
        means: [LinearImage; 2],
        halves: SplitReference,
    ) -> AccumulatedReference {
        let all = NoiseStratum::whole(halves.a.pixels.len(), f64::INFINITY);
        AccumulatedReference {
            means,
            halves,
            strata: vec![NoiseStratum { count, ..all }],
            rendered: count,
        }
    }

    /// Returns the smallest number of images of a pixel in each half.
    pub(super) fn count(&self) -> u32 {
        let counts = self.strata.iter().map(|stratum| stratum.count);
        counts.min().unwrap_or(0)
    }

    /// Returns the seconds that the first image of each half took, if no other was added.
    pub(super) fn seconds_of_first(&self) -> Option<f64> {
        match self.strata[..] {
            [
                NoiseStratum {
                    count: 1, seconds, ..
                },
            ] => Some(seconds),
            _ => None,
        }
    }

    /// Returns the index of the stratum whose next images reduce the noise most for their time; `None` if none of them is
    /// expected to take less than `left` seconds.
    pub(super) fn next_stratum(&self, left: f64) -> Option<usize> {
        let affordable = (0..self.strata.len()).filter(|&index| self.strata[index].seconds < left);
        let gain = |index: usize| self.strata[index].gain(&self.halves);
        affordable.max_by(|&i, &j| gain(i).total_cmp(&gain(j)))
    }

    /// Adds one image of the pixels of a stratum to each half's mean; displayed values are not updated.
    pub(super) fn add(&mut self, stratum: usize, images: &[LinearImage; 2]) {
        let NoiseStratum { is_member, count, .. } = &mut self.strata[stratum];
        *count += 1;
        let part = 1.0 / *count as f32;
        for (mean, image) in self.means.iter_mut().zip(images) {
            let pixels = mean.pixels.iter_mut().zip(&image.pixels);
            for ((mean, pixel), _) in pixels.zip(&*is_member).filter(|(_, is_member)| **is_member) {
                blend_pixel(mean, pixel, part);
            }
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
fn blend(image: &mut LinearImage, other: &LinearImage, part: f32) {
    for (pixel, other) in image.pixels.iter_mut().zip(&other.pixels) {
        blend_pixel(pixel, other, part);
    }
}

/// Interpolates a pixel linearly towards `other`.
fn blend_pixel(pixel: &mut [f32; 3], other: &[f32; 3], part: f32) {
    for (channel, other) in pixel.iter_mut().zip(other) {
        *channel += part * (other - *channel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::DisplayImage;
    use crate::image::ToneMap;

    #[test]
    fn means_are_those_of_the_images_of_each_stratum() {
        let image = |values: [f32; 2]| LinearImage {
            width: 2,
            height: 1,
            pixels: values.map(|value| [value; 3]).to_vec(),
        };
        let means = [[1.0, 2.0], [3.0, 4.0]].map(image);
        let [a, b] = [&means[0], &means[1]].map(|mean| DisplayImage::new(mean, ToneMap::default()));
        let stratum = |is_member: [bool; 2]| NoiseStratum {
            is_member: is_member.to_vec(),
            count: 1,
            seconds: 1.0,
        };
        let mut reference = AccumulatedReference {
            halves: SplitReference { a, b },
            means,
            strata: vec![stratum([true, false]), stratum([false, true])],
            rendered: 1,
        };
        reference.add(0, &[[4.0, 0.0], [6.0, 0.0]].map(image));
        reference.add(0, &[[1.0, 0.0], [0.0, 0.0]].map(image));
        // (1 + 4 + 1) / 3 and (3 + 6 + 0) / 3; the second pixels have one image
        assert_eq!(reference.means, [[2.0, 2.0], [3.0, 4.0]].map(image));
        assert_eq!(reference.count(), 1);
        reference.add(1, &[[0.0, 4.0], [0.0, 4.0]].map(image));
        assert_eq!(reference.means, [[2.0, 3.0], [3.0, 4.0]].map(image));
        assert_eq!(reference.count(), 2);
    }
}
