//! Unbiased error estimates against a reference that is noisy itself.
//!
//! The reference has two halves A and B with independent errors. The mean of (X - A)(X - B) over all pixels has the
//! squared error of X against the truth as its expectation: the errors of the halves do not add to it, as they would in
//! (X - (A + B) / 2)². Over two different images of one configuration, (X - A)(Y - B) has the squared bias alone as its
//! expectation. Values are displayed values, clipped to the range from 0 (black) to 1 (white).

use super::Interval;
use crate::image::metrics::as_displayed;
use crate::image::{LinearImage, ToneMap};
use crate::measure::bootstrap;

/// Default side of the pixel blocks that intervals are resampled from, in pixels; neighbouring pixels are correlated by
/// shared edges and textures.
const BLOCK: usize = 8;

/// Half-width of the central 95 % of a normal distribution, in standard deviations.
pub(super) const NORMAL: f64 = 1.96;

/// Image in displayed values, divided into blocks for resampling.
#[derive(Clone, Debug)]
pub struct DisplayImage {
    width: usize,
    /// Side of the resampling blocks, in pixels.
    block: usize,
    /// Fraction of the complete image that this image covers, for the finite-population correction.
    share: f64,
    pub(super) pixels: Vec<[f32; 3]>,
}

impl DisplayImage {
    /// Returns the displayed values of `image` under the tone mapping.
    pub fn new(image: &LinearImage, tone: ToneMap) -> DisplayImage {
        let gain = f64::from(tone.exposure_ev).exp2();
        let shown = |pixel: &[f32; 3]| pixel.map(|x| as_displayed(gain * f64::from(x)) as f32);
        DisplayImage {
            width: image.width as usize,
            block: BLOCK,
            share: 0.0,
            pixels: image.pixels.iter().map(shown).collect(),
        }
    }

    /// Returns this image with blocks so that `columns` are side by side: in an image of patches, the pixels of a patch
    /// share a block.
    pub fn with_block_columns(self, columns: u32) -> DisplayImage {
        DisplayImage {
            block: self.width.div_ceil(columns.max(1) as usize).max(1),
            ..self
        }
    }

    /// Returns this image as the fraction `share` of the image that the error is reported for. At 1, only noise makes
    /// the error uncertain. The default of 0 treats the image as a sample of all images of the scene.
    pub fn as_fraction(self, share: f64) -> DisplayImage {
        DisplayImage {
            share: share.clamp(0.0, 1.0),
            ..self
        }
    }

    /// Returns the mean squared difference over all pixels and channels.
    pub fn mean_square_to(&self, other: &DisplayImage) -> f64 {
        let differences = self.minus(other);
        differences
            .iter()
            .map(|difference| difference * difference)
            .sum::<f64>()
            / differences.len() as f64
    }

    /// Returns the difference of every channel of every pixel, pixels in row-major order.
    pub fn minus(&self, other: &DisplayImage) -> Vec<f64> {
        let pairs = self.pixels.iter().zip(&other.pixels);
        pairs
            .flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c])))
            .collect()
    }

    /// Returns the index of the block that contains `pixel`.
    fn block_of(&self, pixel: usize) -> usize {
        let (x, y) = (pixel % self.width, pixel / self.width);
        y / self.block * self.width.div_ceil(self.block) + x / self.block
    }

    fn block_count(&self) -> usize {
        let height = self.pixels.len() / self.width;
        self.width.div_ceil(self.block) * height.div_ceil(self.block)
    }
}

/// Two independent halves of a reference.
#[derive(Clone, Debug)]
pub struct SplitReference {
    /// First half of the reference.
    pub a: DisplayImage,
    /// Second half, of equal size.
    pub b: DisplayImage,
}

impl SplitReference {
    /// Returns the mean squared error of the mean of the halves: a quarter of their mean squared difference.
    pub fn noise_squared(&self) -> f64 {
        0.25 * self.a.mean_square_to(&self.b)
    }

    /// Returns the fraction of blocks in which the halves differ by more than their noise. The significance level
    /// allows one image in 100 to have any such block by chance.
    pub fn disagreeing_fraction(&self) -> f64 {
        // Accumulate the moments of the differences in each block
        let blocks = self.a.block_count();
        let mut sums = vec![[0.0; 3]; blocks];
        for (pixel, (a, b)) in self.a.pixels.iter().zip(&self.b.pixels).enumerate() {
            let difference = (0..3).map(|c| f64::from(a[c] - b[c])).sum::<f64>();
            let [count, sum, squares] = &mut sums[self.a.block_of(pixel)];
            *count += 1.0;
            *sum += difference;
            *squares += difference * difference;
        }
        // Correct the significance level for the number of blocks (Šidák)
        let level = 1.0 - 0.99f64.powf(1.0 / blocks as f64);
        let differs = |[count, sum, squares]: &[f64; 3]| {
            let mean = sum / count;
            let variance = (squares - sum * mean) / (count - 1.0);
            // Where few pixels differ, values are far from normal; the mean must be visible as well.
            variance > 0.0
                && mean.abs() > 1.0 / 255.0
                && two_sided_tail(mean.abs() / (variance / count).sqrt()) < level
        };
        let count = sums.iter().filter(|sums| sums[0] > 1.0 && differs(sums)).count();
        count as f64 / blocks as f64
    }
}

/// Returns the two-sided tail probability of a normal distribution beyond `z` standard deviations, as an upper bound
/// that is tight where the probability is small (Mills' ratio).
fn two_sided_tail(z: f64) -> f64 {
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    (2.0 * density / z.max(f64::MIN_POSITIVE)).min(1.0)
}

/// Returns the half-width of the central 95 % of Student's distribution with `freedom` degrees of freedom (M.
/// Abramowitz, I. Stegun, "Handbook of Mathematical Functions", 1964, 26.7.5), accurate to a tenth from two degrees on.
fn student(freedom: f64) -> f64 {
    let z = NORMAL;
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / freedom + second / freedom.powi(2) + third / freedom.powi(3)
}

/// Accumulated images of one configuration, from which errors are estimated.
#[derive(Clone, Debug)]
pub struct ImageSums {
    count: usize,
    /// Sum of all images, for each pixel.
    sum: Vec<[f32; 3]>,
    /// Sums of (X - A)(X - B), for each block.
    products: Vec<f64>,
    /// Sums of each image's squared contribution to the products, for each block.
    squares: Vec<f64>,
}

/// Estimated error of a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorEstimate {
    /// Mean squared error over pixels and channels.
    pub mean_square: Interval,
    /// Part of the mean squared error that remains however many images are averaged.
    pub bias_squared: Interval,
}

impl ImageSums {
    /// Returns an accumulator without images, of the size of `halves`.
    pub fn new(halves: &SplitReference) -> ImageSums {
        ImageSums {
            count: 0,
            sum: vec![[0.0; 3]; halves.a.pixels.len()],
            products: vec![0.0; halves.a.block_count()],
            squares: vec![0.0; halves.a.block_count()],
        }
    }

    /// Returns an accumulator of `count` images from the values that [`ImageSums::parts`] returns.
    pub(super) fn from_parts(
        count: usize,
        sum: Vec<[f32; 3]>,
        products: Vec<f64>,
        squares: Vec<f64>,
    ) -> ImageSums {
        ImageSums {
            count,
            sum,
            products,
            squares,
        }
    }

    /// Returns the sum of all images for each pixel, and for each block the sums of the products and of their squares.
    pub(super) fn parts(&self) -> (&[[f32; 3]], &[f64], &[f64]) {
        (&self.sum, &self.products, &self.squares)
    }

    /// Returns the number of blocks in which products are accumulated.
    pub(super) fn block_count(&self) -> usize {
        self.products.len()
    }

    /// Adds an image to the sums.
    pub fn add(&mut self, halves: &SplitReference, image: &DisplayImage) {
        self.count += 1;
        // Add the products of each pixel to its block, and the values to the image sum
        let mut products = vec![0.0; self.products.len()];
        for (pixel, x) in image.pixels.iter().enumerate() {
            let (a, b) = (halves.a.pixels[pixel], halves.b.pixels[pixel]);
            let product = |c: usize| f64::from(x[c] - a[c]) * f64::from(x[c] - b[c]);
            products[halves.a.block_of(pixel)] += (0..3).map(product).sum::<f64>();
            for c in 0..3 {
                self.sum[pixel][c] += x[c];
            }
        }
        // Add the block sums and their squares
        for (block, product) in products.into_iter().enumerate() {
            self.products[block] += product;
            self.squares[block] += product * product;
        }
    }

    /// Returns the mean squared error of one image over pixels and channels; noise can make it negative.
    pub fn mean_square(&self) -> f64 {
        self.products.iter().sum::<f64>() / (self.count * 3 * self.sum.len()) as f64
    }

    /// Returns the variance of the images' mean product, summed over blocks, due to different random numbers. With one
    /// image it is unknown; the error of that image itself is then the estimated quantity, and the variance is 0.
    fn variance_between_images(&self) -> f64 {
        let count = self.count as f64;
        if self.count < 2 {
            return 0.0;
        }
        let blocks = self.products.iter().zip(&self.squares);
        let variances = blocks.map(|(sum, squares)| (squares - sum * sum / count).max(0.0) / (count - 1.0));
        let variances: Vec<f64> = variances.collect();
        let sum = variances.iter().sum::<f64>();
        // Effective degrees of freedom of a sum of independently estimated variances (F. E. Satterthwaite, "An
        // Approximate Distribution of Estimates of Variance Components", Biometrics Bulletin 2, 1946).
        let squares = variances.iter().map(|variance| variance * variance).sum::<f64>();
        let freedom = (count - 1.0) * sum * sum / squares;
        // Without any variance the degrees of freedom are NaN.
        let widening = if freedom > 0.0 {
            student(freedom) / NORMAL
        } else {
            1.0
        };
        sum / count * widening * widening
    }

    /// Returns the variance of the sum of products due to the noise of the reference.
    ///
    /// With the mean M of the halves and half of their difference D, the product of a pixel is (X - M)² - D². The error
    /// of M is distributed like D and independent of D, so that the variance is about that of 2 (X - M) D.
    fn variance_by_reference(&self, halves: &SplitReference) -> f64 {
        let pixels = self.sum.iter().zip(halves.a.pixels.iter().zip(&halves.b.pixels));
        let variance = pixels.map(|(sum, (a, b))| {
            let product = |c: usize| {
                let (a, b) = (f64::from(a[c]), f64::from(b[c]));
                (f64::from(sum[c]) / self.count as f64 - 0.5 * (a + b)) * (a - b)
            };
            (0..3).map(product).sum::<f64>().powi(2)
        });
        variance.sum()
    }

    /// Returns the squared error of one image in each block, summed over its pixels and channels.
    pub fn block_squares(&self) -> Vec<f64> {
        self.products
            .iter()
            .map(|product| product / self.count as f64)
            .collect()
    }

    /// Returns the error of one image. With a single image all of the error may be bias.
    pub fn estimate(&self, halves: &SplitReference, seed: u64) -> ErrorEstimate {
        let count = self.count as f64;
        let values = (3 * self.sum.len()) as f64;
        // Take the mean product of each block
        let mean_square: Vec<f64> = self
            .products
            .iter()
            .map(|product| product / count / values)
            .collect();
        // Sum over all ordered pairs of different images: the pairs of all images minus the pairs of an image with
        // itself.
        let mut pairs: Vec<f64> = self.products.iter().map(|product| -product).collect();
        for (pixel, sum) in self.sum.iter().enumerate() {
            let (a, b) = (halves.a.pixels[pixel], halves.b.pixels[pixel]);
            let product = |c: usize| {
                let sum = f64::from(sum[c]);
                (sum - count * f64::from(a[c])) * (sum - count * f64::from(b[c]))
            };
            pairs[halves.a.block_of(pixel)] += (0..3).map(product).sum::<f64>();
        }
        let pair_count = count * (count - 1.0);
        let bias: Vec<f64> = pairs.iter().map(|pair| pair / pair_count / values).collect();
        let blocks = mean_square.len();
        // Compare the variance between blocks with the variance by noise
        let total = |of: &[f64], chosen: &[usize]| chosen.iter().map(|&block| of[block]).sum::<f64>();
        let between = {
            let mean = mean_square.iter().sum::<f64>() / blocks as f64;
            mean_square
                .iter()
                .map(|square| (square - mean).powi(2))
                .sum::<f64>()
        };
        let noise = (self.variance_between_images() + self.variance_by_reference(halves)) / (values * values);
        // Resample blocks for the intervals
        let mean_square = bootstrap(blocks, seed, |chosen| total(&mean_square, chosen));
        let mean_square = correct_for_population(mean_square, halves.a.share, noise / between);
        let bias_squared = if self.count > 1 {
            bootstrap(blocks, seed, |chosen| total(&bias, chosen))
        } else {
            Interval {
                low: 0.0,
                ..mean_square
            }
        };
        ErrorEstimate {
            mean_square,
            bias_squared,
        }
    }
}

/// Returns an interval that was resampled from a `share` of the population, corrected for the finite population;
/// `noise` is the part of its squared width that is not due to the choice of the sample (W. Cochran, "Sampling
/// Techniques", 1977, sections 2.6 and 11.5).
fn correct_for_population(interval: Interval, share: f64, noise: f64) -> Interval {
    let part = 1.0 - share + share * noise.clamp(0.0, 1.0);
    // Without any variance the quotient is NaN.
    let part = if part.is_nan() { 1.0 } else { part.sqrt() };
    let toward = |end: f64| interval.value + part * (end - interval.value);
    Interval {
        value: interval.value,
        low: toward(interval.low),
        high: toward(interval.high),
    }
}

impl ErrorEstimate {
    /// Returns the root mean squared error; 0 where noise makes the square negative.
    pub fn rmse(&self) -> Interval {
        self.mean_square.map(|square| square.max(0.0).sqrt())
    }

    /// Returns the part of the mean squared error that differs between images.
    pub fn variance(&self) -> f64 {
        (self.mean_square.value - self.bias_squared.value).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// Returns a noisy image of a ramp with a known displayed value; the added noise has zero mean.
    fn noisy(random: &mut SplitMix64, noise: f64, bias: f64) -> DisplayImage {
        let side = 64;
        let pixels = (0..side * side).map(|pixel| {
            let truth = 0.3 + 0.4 * (pixel % side) as f64 / side as f64;
            [0; 3].map(|_| (truth + bias + noise * random.within(-1.0, 1.0)) as f32)
        });
        DisplayImage {
            width: side,
            block: BLOCK,
            share: 0.0,
            pixels: pixels.collect(),
        }
    }

    #[test]
    fn bias_of_a_thousandth_is_found_under_noise() {
        let (mut held, mut bias_held, runs) = (0, 0, 200);
        for run in 0..runs {
            let mut random = SplitMix64::new(11, run);
            let halves = SplitReference {
                a: noisy(&mut random, 0.01, 0.0),
                b: noisy(&mut random, 0.01, 0.0),
            };
            let mut sums = ImageSums::new(&halves);
            for _ in 0..8 {
                sums.add(&halves, &noisy(&mut random, 0.005, 1e-3));
            }
            let estimate = sums.estimate(&halves, run);
            let truth = 1e-6 + 0.005f64.powi(2) / 3.0;
            held += usize::from(estimate.mean_square.holds(truth));
            bias_held += usize::from(estimate.bias_squared.holds(1e-6));
        }
        assert!(
            held >= 180 && bias_held >= 180,
            "{held} and {bias_held} of {runs}"
        );
    }

    #[test]
    fn reference_noise_does_not_increase_the_error() {
        let mut random = SplitMix64::new(12, 0);
        let halves = SplitReference {
            a: noisy(&mut random, 0.1, 0.0),
            b: noisy(&mut random, 0.1, 0.0),
        };
        let noise = halves.noise_squared();
        assert!((noise / (0.01 / 3.0 / 2.0) - 1.0).abs() < 0.05, "{noise}");
        let mut sums = ImageSums::new(&halves);
        sums.add(&halves, &noisy(&mut random, 0.0, 0.0));
        let estimate = sums.estimate(&halves, 0);
        assert!(estimate.mean_square.holds(0.0), "{estimate:?}");
        assert!(estimate.mean_square.value.abs() < 0.05 * noise, "{estimate:?}");
    }

    /// Compares with table 26.10 of the handbook.
    #[test]
    fn student_quantiles_match_published_tables() {
        for (freedom, width) in [
            (2.0, 4.303),
            (3.0, 3.182),
            (5.0, 2.571),
            (10.0, 2.228),
            (30.0, 2.042),
            (120.0, 1.98),
        ] {
            let share = student(freedom) / width;
            assert!(
                (share - 1.0).abs() < if freedom < 3.0 { 0.1 } else { 0.02 },
                "{freedom}: {share}"
            );
        }
    }

    /// Checks a complete image with large errors in a few pixels only: the error is known except for noise.
    #[test]
    fn interval_of_a_whole_image_covers_only_noise() {
        let (runs, noise) = (200, 0.02);
        // Plant an error in every 173rd pixel
        let far_off = |pixel: usize| if pixel.is_multiple_of(173) { 0.3 } else { 0.0 };
        let (mut held, mut width, mut width_of_a_part) = (0, 0.0, 0.0);
        for run in 0..runs {
            let mut random = SplitMix64::new(14, run);
            let halves = SplitReference {
                a: noisy(&mut random, 0.01, 0.0).as_fraction(1.0),
                b: noisy(&mut random, 0.01, 0.0).as_fraction(1.0),
            };
            let mut sums = ImageSums::new(&halves);
            for _ in 0..2 {
                let mut image = noisy(&mut random, noise, 0.0);
                for (pixel, value) in image.pixels.iter_mut().enumerate() {
                    *value = value.map(|x| x + far_off(pixel) as f32);
                }
                sums.add(&halves, &image);
            }
            // Count intervals that hold the true error
            let pixels = 64 * 64;
            let off = (0..pixels).map(|pixel| f64::powi(far_off(pixel), 2)).sum::<f64>() / pixels as f64;
            let interval = sums.estimate(&halves, run).mean_square;
            held += usize::from(interval.holds(noise * noise / 3.0 + off));
            width += interval.high - interval.low;
            // Measure the width of the interval without the correction
            let [a, b] = [&halves.a, &halves.b].map(|half| half.clone().as_fraction(0.0));
            let interval = sums.estimate(&SplitReference { a, b }, run).mean_square;
            width_of_a_part += interval.high - interval.low;
        }
        assert!((184..=199).contains(&held), "{held} of {runs}");
        assert!(width < 0.5 * width_of_a_part, "{width} of {width_of_a_part}");
    }

    #[test]
    fn local_differences_of_halves_are_detected_and_noise_is_not() {
        let mut random = SplitMix64::new(13, 0);
        let mut halves = SplitReference {
            a: noisy(&mut random, 0.05, 0.0),
            b: noisy(&mut random, 0.05, 0.0),
        };
        assert_eq!(halves.disagreeing_fraction(), 0.0);
        for y in 0..8 {
            for x in 0..8 {
                halves.b.pixels[64 * y + x] = halves.b.pixels[64 * y + x].map(|value| value + 0.05);
            }
        }
        assert_eq!(halves.disagreeing_fraction(), 1.0 / 64.0);
    }
}
