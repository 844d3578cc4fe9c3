//! Strata of a reference's pixels by their noise: often a few pixels, such as those of highlights in mirrors, have most of
//! it, and take more images than the others (J. Neyman, "On the Two Different Aspects of the Representative Method", Journal
//! of the Royal Statistical Society, 1934).

use super::SplitReference;

/// Fractions of all pixels, those with most noise first, at which strata end.
const ENDS: [f64; 5] = [0.01, 0.03, 0.1, 0.3, 1.0];

/// Pixels of a reference that have the same number of images.
pub(super) struct NoiseStratum {
    /// True for the pixels of the stratum, row by row.
    pub(super) is_member: Vec<bool>,
    /// Number of images of these pixels in each half.
    pub(super) count: u32,
    /// Seconds to render one more image of these pixels for each half.
    pub(super) seconds: f64,
}

impl NoiseStratum {
    /// Returns the stratum of all pixels of an image, of which each half has one image.
    pub(super) fn whole(pixel_count: usize, seconds: f64) -> NoiseStratum {
        NoiseStratum {
            is_member: vec![true; pixel_count],
            count: 1,
            seconds,
        }
    }

    /// Returns strata by the differences between the halves, those with most noise first, for a reference with one image in
    /// each half; `seconds` is the time to render one more for each.
    ///
    /// The reference must not contain the images that the strata are chosen by: pixels with little difference are also
    /// those in which both halves missed what is rare.
    pub(super) fn by_noise(halves: &SplitReference, seconds: f64) -> Vec<NoiseStratum> {
        let differences = squared_differences(halves);
        let mut order: Vec<usize> = (0..differences.len()).collect();
        order.sort_by(|&i, &j| differences[j].total_cmp(&differences[i]));
        // Cut the order at the fractions
        let mut first = 0;
        let mut strata = Vec::new();
        for end in ENDS {
            let last = (end * order.len() as f64).ceil() as usize;
            let mut is_member = vec![false; order.len()];
            for &pixel in &order[first..last] {
                is_member[pixel] = true;
            }
            strata.push(NoiseStratum {
                is_member,
                count: 1,
                seconds: seconds * (last - first) as f64 / order.len() as f64,
            });
            first = last;
        }
        strata
    }

    /// Returns the expected decrease of the halves' squared noise, summed over pixels and channels, per second of one more
    /// image for each half.
    pub(super) fn gain(&self, halves: &SplitReference) -> f64 {
        let differences = squared_differences(halves);
        let members = differences.iter().zip(&self.is_member);
        let noise: f64 = members.filter(|(_, is_member)| **is_member).map(|(d, _)| d).sum();
        // The noise of n images falls to n / (n + 1).
        noise / f64::from(self.count + 1) / self.seconds
    }
}

/// Returns the squared difference of the halves in each pixel, summed over channels.
fn squared_differences(halves: &SplitReference) -> Vec<f64> {
    let differences = halves.a.minus(&halves.b);
    let pixels = differences.chunks_exact(3);
    pixels
        .map(|channels| channels.iter().map(|difference| difference * difference).sum())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::DisplayImage;
    use crate::image::{LinearImage, ToneMap};

    /// Returns halves of 100 pixels: all are dark, but for the first of A, which differ by ever more.
    fn halves() -> SplitReference {
        let half = |value: fn(usize) -> f32| {
            let pixels = (0..100).map(|pixel| [value(pixel); 3]).collect();
            let image = LinearImage {
                width: 10,
                height: 10,
                pixels,
            };
            DisplayImage::new(&image, ToneMap::default())
        };
        SplitReference {
            a: half(|pixel| if pixel < 5 { 0.1 * (pixel + 1) as f32 } else { 0.0 }),
            b: half(|_| 0.0),
        }
    }

    #[test]
    fn each_pixel_is_in_one_stratum() {
        let strata = NoiseStratum::by_noise(&halves(), 2.0);
        for pixel in 0..100 {
            let count = strata.iter().filter(|stratum| stratum.is_member[pixel]).count();
            assert_eq!(count, 1, "pixel {pixel}");
        }
        let seconds: f64 = strata.iter().map(|stratum| stratum.seconds).sum();
        assert!((seconds - 2.0).abs() < 1e-12, "{seconds}");
        // The noisiest of 100 pixels, then the next 2
        let members = |stratum: usize| -> Vec<usize> {
            (0..100)
                .filter(|&pixel| strata[stratum].is_member[pixel])
                .collect()
        };
        assert_eq!([members(0), members(1)], [vec![4], vec![2, 3]]);
    }

    #[test]
    fn noisiest_pixels_gain_most_until_they_have_many_images() {
        let halves = halves();
        let mut strata = NoiseStratum::by_noise(&halves, 1.0);
        let gains = |strata: &[NoiseStratum]| -> Vec<f64> {
            strata.iter().map(|stratum| stratum.gain(&halves)).collect()
        };
        let once = gains(&strata);
        assert!(once[0] > once[1] && once[1] > once[2] && once[2] > 0.0);
        assert_eq!(once[3..], [0.0; 2]);
        // Twice the images: 2 of the noise's 3 parts are left to gain
        strata[0].count = 2;
        assert!((gains(&strata)[0] / once[0] - 2.0 / 3.0).abs() < 1e-12);
    }
}
