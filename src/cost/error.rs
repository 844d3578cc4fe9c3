//! Errors against a reference that is noisy itself.
//!
//! The reference comes in two halves A and B whose errors are independent of each other. The mean of (X - A)(X - B) over
//! all pixels has the expectation of the squared error of X against the truth: what the halves err by does not add to it,
//! where (X - (A + B) / 2)² would have it added. Over two different pictures of one configuration, (X - A)(Y - B) has the
//! expectation of the squared bias alone. Values are those displayed: clipped, from 0 for black to 1 for white.

use super::Interval;
use super::statistics::bootstrap;
use crate::image::metrics::as_displayed;
use crate::image::{LinearImage, ToneMap};

/// Sides of the blocks of pixels that intervals are drawn from, if nothing else is said: neighbours share edges and
/// textures.
const BLOCK: usize = 8;

/// So many deviations on either side of the mean hold 95 of 100 of a normal distribution.
const NORMAL: f64 = 1.96;

/// A picture as displayed.
#[derive(Clone, Debug)]
pub struct Displayed {
    width: usize,
    /// Side of the blocks that it is seen as.
    block: usize,
    /// The part that it is of what is to be told.
    share: f64,
    pixels: Vec<[f32; 3]>,
}

impl Displayed {
    /// What `tone` makes of a picture.
    pub fn new(image: &LinearImage, tone: ToneMap) -> Displayed {
        let gain = f64::from(tone.exposure_ev).exp2();
        let shown = |pixel: &[f32; 3]| pixel.map(|x| as_displayed(gain * f64::from(x)) as f32);
        Displayed {
            width: image.width as usize,
            block: BLOCK,
            share: 0.0,
            pixels: image.pixels.iter().map(shown).collect(),
        }
    }

    /// The same, in blocks of which so many are side by side: where it is put together from pieces, neighbours share one.
    pub fn in_columns(self, columns: u32) -> Displayed {
        Displayed {
            block: self.width.div_ceil(columns.max(1) as usize).max(1),
            ..self
        }
    }

    /// The same, as `share` of what is to be told, all of it 1: of that much nothing is uncertain but for noise. Without
    /// this, a picture is one of all that the scene could show.
    pub fn as_share(self, share: f64) -> Displayed {
        Displayed {
            share: share.clamp(0.0, 1.0),
            ..self
        }
    }

    /// The mean square of the difference, over all pixels and channels.
    pub fn mean_square_to(&self, other: &Displayed) -> f64 {
        let differences = self.minus(other);
        differences
            .iter()
            .map(|difference| difference * difference)
            .sum::<f64>()
            / differences.len() as f64
    }

    /// The difference of every channel of every pixel.
    pub fn minus(&self, other: &Displayed) -> Vec<f64> {
        let pairs = self.pixels.iter().zip(&other.pixels);
        pairs
            .flat_map(|(a, b)| (0..3).map(|c| f64::from(a[c] - b[c])))
            .collect()
    }

    /// Of which block a pixel is.
    fn block_of(&self, pixel: usize) -> usize {
        let (x, y) = (pixel % self.width, pixel / self.width);
        y / self.block * self.width.div_ceil(self.block) + x / self.block
    }

    fn block_count(&self) -> usize {
        let height = self.pixels.len() / self.width;
        self.width.div_ceil(self.block) * height.div_ceil(self.block)
    }
}

/// The two halves of a reference.
#[derive(Clone, Debug)]
pub struct Halves {
    /// One.
    pub a: Displayed,
    /// The other, of the same size.
    pub b: Displayed,
}

impl Halves {
    /// The mean square that the mean of the halves errs by: a quarter of that of their difference.
    pub fn noise_squared(&self) -> f64 {
        0.25 * self.a.mean_square_to(&self.b)
    }

    /// The share of the blocks in which the halves differ by more than their noise there, at a level of significance
    /// at which one picture of 100 has any such block.
    pub fn disagreeing_share(&self) -> f64 {
        let blocks = self.a.block_count();
        let mut sums = vec![[0.0; 3]; blocks];
        for (pixel, (a, b)) in self.a.pixels.iter().zip(&self.b.pixels).enumerate() {
            let difference = (0..3).map(|c| f64::from(a[c] - b[c])).sum::<f64>();
            let [count, sum, squares] = &mut sums[self.a.block_of(pixel)];
            *count += 1.0;
            *sum += difference;
            *squares += difference * difference;
        }
        let level = 1.0 - 0.99f64.powf(1.0 / blocks as f64);
        let differs = |[count, sum, squares]: &[f64; 3]| {
            let mean = sum / count;
            let variance = (squares - sum * mean) / (count - 1.0);
            // Where hardly any pixel differs the values are not normal at all; the mean must be visible too.
            variance > 0.0
                && mean.abs() > 1.0 / 255.0
                && two_sided_tail(mean.abs() / (variance / count).sqrt()) < level
        };
        let count = sums.iter().filter(|sums| sums[0] > 1.0 && differs(sums)).count();
        count as f64 / blocks as f64
    }
}

/// How likely a normal number is at least `z` from its mean, in standard deviations: a bound that is close where it is
/// small (Mills' ratio).
fn two_sided_tail(z: f64) -> f64 {
    let density = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
    (2.0 * density / z.max(f64::MIN_POSITIVE)).min(1.0)
}

/// The same of Student's distribution of so many degrees of freedom (M. Abramowitz, I. Stegun, "Handbook of Mathematical
/// Functions", 1964, 26.7.5), to a tenth from two degrees on.
fn student(freedom: f64) -> f64 {
    let z = NORMAL;
    let first = (z.powi(3) + z) / 4.0;
    let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
    let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
    z + first / freedom + second / freedom.powi(2) + third / freedom.powi(3)
}

/// What pictures of one configuration add up to.
#[derive(Clone, Debug)]
pub struct Pictures {
    count: usize,
    /// Of all pictures, pixel by pixel.
    sum: Vec<[f32; 3]>,
    /// Of (X - A)(X - B), block by block.
    products: Vec<f64>,
    /// Of the squares of what each picture adds to these.
    squares: Vec<f64>,
}

/// What is known of a configuration's error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorEstimate {
    /// Mean square, over pixels and channels.
    pub mean_square: Interval,
    /// The part of it that stays however many pictures are averaged.
    pub bias_squared: Interval,
}

impl Pictures {
    /// None yet.
    pub fn new(halves: &Halves) -> Pictures {
        Pictures {
            count: 0,
            sum: vec![[0.0; 3]; halves.a.pixels.len()],
            products: vec![0.0; halves.a.block_count()],
            squares: vec![0.0; halves.a.block_count()],
        }
    }

    /// Those of so many pictures, from [`Pictures::parts`].
    pub(super) fn from_parts(
        count: usize,
        sum: Vec<[f32; 3]>,
        products: Vec<f64>,
        squares: Vec<f64>,
    ) -> Pictures {
        Pictures {
            count,
            sum,
            products,
            squares,
        }
    }

    /// Sums of all pictures pixel by pixel, and block by block their products and the squares of these.
    pub(super) fn parts(&self) -> (&[[f32; 3]], &[f64], &[f64]) {
        (&self.sum, &self.products, &self.squares)
    }

    /// Blocks that products are added up in.
    pub(super) fn block_count(&self) -> usize {
        self.products.len()
    }

    /// Adds a picture.
    pub fn add(&mut self, halves: &Halves, picture: &Displayed) {
        self.count += 1;
        let mut products = vec![0.0; self.products.len()];
        for (pixel, x) in picture.pixels.iter().enumerate() {
            let (a, b) = (halves.a.pixels[pixel], halves.b.pixels[pixel]);
            let product = |c: usize| f64::from(x[c] - a[c]) * f64::from(x[c] - b[c]);
            products[halves.a.block_of(pixel)] += (0..3).map(product).sum::<f64>();
            for c in 0..3 {
                self.sum[pixel][c] += x[c];
            }
        }
        for (block, product) in products.into_iter().enumerate() {
            self.products[block] += product;
            self.squares[block] += product * product;
        }
    }

    /// The mean squared error of one picture, over pixels and channels; below 0 where noise takes it there.
    pub fn mean_square(&self) -> f64 {
        self.products.iter().sum::<f64>() / (self.count * 3 * self.sum.len()) as f64
    }

    /// Variance of the mean of the products of a picture, all blocks added up, as pictures of other random numbers have
    /// it; of a single one nothing is known, and it is taken for what is to be told.
    fn noise_of_pictures(&self) -> f64 {
        let count = self.count as f64;
        if self.count < 2 {
            return 0.0;
        }
        let blocks = self.products.iter().zip(&self.squares);
        let variances = blocks.map(|(sum, squares)| (squares - sum * sum / count).max(0.0) / (count - 1.0));
        let variances: Vec<f64> = variances.collect();
        let sum = variances.iter().sum::<f64>();
        // So many degrees of freedom has a sum of variances that are estimated each by itself (F. E. Satterthwaite, "An
        // Approximate Distribution of Estimates of Variance Components", Biometrics Bulletin 2, 1946).
        let squares = variances.iter().map(|variance| variance * variance).sum::<f64>();
        let freedom = (count - 1.0) * sum * sum / squares;
        // Where nothing varies it is no number.
        let widening = if freedom > 0.0 {
            student(freedom) / NORMAL
        } else {
            1.0
        };
        sum / count * widening * widening
    }

    /// The same as the noise of the reference has it.
    ///
    /// With the mean M of the halves and half of their difference D, the product of a pixel is (X - M)² - D². What M errs
    /// by is distributed like D and independent of it, so that the variance is about that of 2 (X - M) D.
    fn noise_of(&self, halves: &Halves) -> f64 {
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

    /// The error of one picture. Of a single picture all of it may be bias.
    pub fn estimate(&self, halves: &Halves, seed: u64) -> ErrorEstimate {
        let count = self.count as f64;
        let values = (3 * self.sum.len()) as f64;
        let mean_square: Vec<f64> = self
            .products
            .iter()
            .map(|product| product / count / values)
            .collect();
        // Of all pairs of two pictures: those of all pictures less those of one with itself.
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
        let total = |of: &[f64], chosen: &[usize]| chosen.iter().map(|&block| of[block]).sum::<f64>();
        let between = {
            let mean = mean_square.iter().sum::<f64>() / blocks as f64;
            mean_square
                .iter()
                .map(|square| (square - mean).powi(2))
                .sum::<f64>()
        };
        let noise = (self.noise_of_pictures() + self.noise_of(halves)) / (values * values);
        let mean_square = bootstrap(blocks, seed, |chosen| total(&mean_square, chosen));
        let mean_square = narrowed(mean_square, halves.a.share, noise / between);
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

/// An interval drawn from the `share` of everything that was seen, where `noise` is the part of its squared width that is
/// not due to the choice of what was seen (W. Cochran, "Sampling Techniques", 1977, sections 2.6 and 11.5).
fn narrowed(interval: Interval, share: f64, noise: f64) -> Interval {
    let part = 1.0 - share + share * noise.clamp(0.0, 1.0);
    // Where nothing varies at all the quotient is no number.
    let part = if part.is_nan() { 1.0 } else { part.sqrt() };
    let toward = |end: f64| interval.value + part * (end - interval.value);
    Interval {
        value: interval.value,
        low: toward(interval.low),
        high: toward(interval.high),
    }
}

impl ErrorEstimate {
    /// Root of the mean square, 0 where noise takes the square below.
    pub fn rmse(&self) -> Interval {
        self.mean_square.map(|square| square.max(0.0).sqrt())
    }

    /// The part of the mean square that differs from picture to picture.
    pub fn variance(&self) -> f64 {
        (self.mean_square.value - self.bias_squared.value).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::SplitMix64;

    /// A noisy picture of a ramp: the value displayed is known, and what is added has no mean.
    fn noisy(random: &mut SplitMix64, noise: f64, bias: f64) -> Displayed {
        let side = 64;
        let pixels = (0..side * side).map(|pixel| {
            let truth = 0.3 + 0.4 * (pixel % side) as f64 / side as f64;
            [0; 3].map(|_| (truth + bias + noise * random.within(-1.0, 1.0)) as f32)
        });
        Displayed {
            width: side,
            block: BLOCK,
            share: 0.0,
            pixels: pixels.collect(),
        }
    }

    #[test]
    fn a_planted_bias_of_a_thousandth_is_found_under_noise_of_the_reference_and_of_the_pictures() {
        let (mut held, mut bias_held, runs) = (0, 0, 200);
        for run in 0..runs {
            let mut random = SplitMix64::new(11, run);
            let halves = Halves {
                a: noisy(&mut random, 0.01, 0.0),
                b: noisy(&mut random, 0.01, 0.0),
            };
            let mut pictures = Pictures::new(&halves);
            for _ in 0..8 {
                pictures.add(&halves, &noisy(&mut random, 0.005, 1e-3));
            }
            let estimate = pictures.estimate(&halves, run);
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
    fn the_noise_of_the_reference_does_not_count() {
        let mut random = SplitMix64::new(12, 0);
        let halves = Halves {
            a: noisy(&mut random, 0.1, 0.0),
            b: noisy(&mut random, 0.1, 0.0),
        };
        let noise = halves.noise_squared();
        assert!((noise / (0.01 / 3.0 / 2.0) - 1.0).abs() < 0.05, "{noise}");
        let mut pictures = Pictures::new(&halves);
        pictures.add(&halves, &noisy(&mut random, 0.0, 0.0));
        let estimate = pictures.estimate(&halves, 0);
        assert!(estimate.mean_square.holds(0.0), "{estimate:?}");
        assert!(estimate.mean_square.value.abs() < 0.05 * noise, "{estimate:?}");
    }

    /// Table 26.10 of the handbook.
    #[test]
    fn students_distribution_is_as_wide_as_its_table_says() {
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

    /// A picture that is far off in few places only, seen whole: its error is known but for noise.
    #[test]
    fn of_a_whole_picture_nothing_but_noise_is_uncertain() {
        let (runs, noise) = (200, 0.02);
        let far_off = |pixel: usize| if pixel.is_multiple_of(173) { 0.3 } else { 0.0 };
        let (mut held, mut width, mut width_of_a_part) = (0, 0.0, 0.0);
        for run in 0..runs {
            let mut random = SplitMix64::new(14, run);
            let halves = Halves {
                a: noisy(&mut random, 0.01, 0.0).as_share(1.0),
                b: noisy(&mut random, 0.01, 0.0).as_share(1.0),
            };
            let mut pictures = Pictures::new(&halves);
            for _ in 0..2 {
                let mut picture = noisy(&mut random, noise, 0.0);
                for (pixel, value) in picture.pixels.iter_mut().enumerate() {
                    *value = value.map(|x| x + far_off(pixel) as f32);
                }
                pictures.add(&halves, &picture);
            }
            let pixels = 64 * 64;
            let off = (0..pixels).map(|pixel| f64::powi(far_off(pixel), 2)).sum::<f64>() / pixels as f64;
            let interval = pictures.estimate(&halves, run).mean_square;
            held += usize::from(interval.holds(noise * noise / 3.0 + off));
            width += interval.high - interval.low;
            let [a, b] = [&halves.a, &halves.b].map(|half| half.clone().as_share(0.0));
            let interval = pictures.estimate(&Halves { a, b }, run).mean_square;
            width_of_a_part += interval.high - interval.low;
        }
        assert!((184..=199).contains(&held), "{held} of {runs}");
        assert!(width < 0.5 * width_of_a_part, "{width} of {width_of_a_part}");
    }

    #[test]
    fn halves_that_differ_in_one_corner_are_found_out_and_noisy_ones_are_not() {
        let mut random = SplitMix64::new(13, 0);
        let mut halves = Halves {
            a: noisy(&mut random, 0.05, 0.0),
            b: noisy(&mut random, 0.05, 0.0),
        };
        assert_eq!(halves.disagreeing_share(), 0.0);
        for y in 0..8 {
            for x in 0..8 {
                halves.b.pixels[64 * y + x] = halves.b.pixels[64 * y + x].map(|value| value + 0.05);
            }
        }
        assert_eq!(halves.disagreeing_share(), 1.0 / 64.0);
    }
}
