//! Exposure chosen from a finished image, by its luminance.
//!
//! The geometric mean of the luminance of covered pixels becomes middle grey, 0.18 of white (E. Reinhard et al.,
//! "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002), unless more than a hundredth of them would then
//! be brighter than white: the 99th percentile becomes white at most. Pixels far darker than that percentile count as
//! if they were just so dark, so that deep shadows do not brighten the rest. The result does not depend on threads.

use crate::image::LinearImage;
use crate::parallel;
use crate::scene::image_settings::MAX_EXPOSURE;

/// Exposure of displayed values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// Number of stops by which radiance is brightened: the factor is 2 to this power.
    Stops(f32),
    /// Exposure that [`automatic_exposure`] chooses from the finished image.
    Automatic,
}

impl Exposure {
    /// Returns the stops of exposure of a finished image, with the coverage of its pixels if it has one.
    pub fn stops(self, image: &LinearImage, alpha: Option<&[f32]>) -> f32 {
        match self {
            Exposure::Stops(stops) => stops,
            Exposure::Automatic => automatic_exposure(image, alpha),
        }
    }
}

/// Displayed luminance of the geometric mean, relative to white: the reflectance of a photographer's grey card.
const MIDDLE_GREY: f64 = 0.18;
/// Fraction of the covered pixels that are white or darker.
const WHITE_FRACTION: f64 = 0.99;
/// Ratio of the darkest luminance that counts as it is to that of the percentile: twelve stops, the range of a good
/// camera.
const DARKEST: f64 = 1.0 / 4096.0;
/// Coverage from which a pixel counts as covered.
const MIN_ALPHA: f32 = 0.5;
/// Steps of the result per stop, so that its printed value gives the same image.
const STEPS_PER_STOP: f64 = 100.0;
/// Number of pixels of a task.
const CHUNK: usize = 1 << 12;
/// Number of explicit bits of an f64's significand, the mask for them, and the exponent field of 1.
const SIGNIFICAND_BITS: u32 = f64::MANTISSA_DIGITS - 1;
const SIGNIFICAND: u64 = (1 << SIGNIFICAND_BITS) - 1;
const EXPONENT_OF_ONE: i64 = (1f64.to_bits() >> SIGNIFICAND_BITS) as i64;
/// Powers of two below and above all luminances: the smallest subnormal f32 is 2^-149 and its blue a fourteenth of that; the
/// largest is 2^128, half covered.
const SMALLEST: f64 = f64::from_bits(((EXPONENT_OF_ONE - 160) as u64) << SIGNIFICAND_BITS);
const LARGEST: f64 = f64::from_bits(((EXPONENT_OF_ONE + 140) as u64) << SIGNIFICAND_BITS);
/// Number of bits that do not count in the interval of a luminance: all but the exponent and three of the significand.
const INTERVAL_BITS: u32 = SIGNIFICAND_BITS - 3;
/// Number of intervals of luminance.
const INTERVAL_COUNT: usize = ((LARGEST.to_bits() - SMALLEST.to_bits()) >> INTERVAL_BITS) as usize;
/// Factors of the linear channels of Rec. 709 in luminance.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Returns the stops of exposure that suit an image, in hundredths; 0 if no pixel has luminance.
///
/// Pixels without luminance, and those that `alpha` says are less than half covered, do not count.
pub fn automatic_exposure(image: &LinearImage, alpha: Option<&[f32]>) -> f32 {
    let covered = CoveredPixels { image, alpha };
    // Count the luminances of each interval, and add up the logarithms of each chunk
    let mut chunks = covered.map_chunks(&|_| true, &ChunkLuminance::new);
    let mut counts = vec![0; INTERVAL_COUNT];
    for chunk in &chunks {
        for (count, more) in counts.iter_mut().zip(&chunk.counts) {
            *count += usize::from(*more);
        }
    }
    // Find the percentile that may become white: its interval, then its place there
    let count: usize = counts.iter().sum();
    let Some(mut index) = ((WHITE_FRACTION * count as f64).ceil() as usize).checked_sub(1) else {
        return 0.0;
    };
    let mut of_white = 0;
    while index >= counts[of_white] {
        index -= counts[of_white];
        of_white += 1;
    }
    let is_near_white = |level: &&f64| interval(**level) == of_white;
    let near_white = |levels: &[f64]| -> Vec<f64> { levels.iter().filter(is_near_white).copied().collect() };
    let has_near_white = |chunk: usize| chunks[chunk].counts[of_white] > 0;
    let mut levels = covered.map_chunks(&has_near_white, &near_white).concat();
    let white = *levels.select_nth_unstable_by(index, f64::total_cmp).1;
    // Limit the luminances of chunks that have darker ones than count
    let darkest = DARKEST * white;
    let is_darker = |chunk: &ChunkLuminance| chunk.min < darkest;
    let sum_limited = |levels: &[f64]| sum_of_logarithms(levels, darkest);
    let limited = covered.map_chunks(&|chunk| is_darker(&chunks[chunk]), &sum_limited);
    let darker = chunks.iter_mut().filter(|chunk| is_darker(chunk));
    darker
        .zip(limited)
        .for_each(|(chunk, sum)| chunk.logarithms = sum);
    // Take the geometric mean, and the smaller of both gains
    let logarithms: f64 = chunks.iter().map(|chunk| chunk.logarithms).sum();
    let of_grey = MIDDLE_GREY.log2() - logarithms / count as f64;
    let stops = of_grey.min(-white.log2());
    let limit = f64::from(MAX_EXPOSURE);
    ((stops * STEPS_PER_STOP).round() / STEPS_PER_STOP).clamp(-limit, limit) as f32
}

/// Pixels of an image that are covered at least by half and have luminance.
struct CoveredPixels<'a> {
    image: &'a LinearImage,
    alpha: Option<&'a [f32]>,
}

impl CoveredPixels<'_> {
    /// Returns the results of `work` for the luminances of each chunk of pixels that `is_wanted` by its number, in order.
    fn map_chunks<T: Send>(
        &self,
        is_wanted: &dyn Fn(usize) -> bool,
        work: &(dyn Fn(&[f64]) -> T + Sync),
    ) -> Vec<T> {
        // List the chunks
        let pixels = &self.image.pixels;
        let all = 0..pixels.len().div_ceil(CHUNK);
        let wanted: Vec<usize> = all.filter(|&chunk| is_wanted(chunk)).collect();
        parallel::map(wanted.len(), &|task| {
            let first = CHUNK * wanted[task];
            let pixels = &pixels[first..pixels.len().min(first + CHUNK)];
            // Compute the luminances of those pixels that count
            let (mut levels, mut count) = ([0.0; CHUNK], 0);
            let mut add = |pixel: &[f32; 3], alpha: f32| {
                let sum: f64 = (0..3).map(|c| LUMINANCE[c] * f64::from(pixel[c])).sum();
                let level = sum / f64::from(alpha);
                // One that does not count is overwritten by the next
                levels[count] = level;
                count += usize::from(alpha >= MIN_ALPHA && level > 0.0 && level.is_finite());
            };
            match self.alpha {
                None => pixels.iter().for_each(|pixel| add(pixel, 1.0)),
                Some(alpha) => {
                    let covered = pixels.iter().zip(&alpha[first..]);
                    covered.for_each(|(pixel, &alpha)| add(pixel, alpha));
                }
            }
            work(&levels[..count])
        })
    }
}

/// Luminances of a chunk of pixels.
struct ChunkLuminance {
    /// Number of luminances in each interval.
    counts: Vec<u16>,
    /// Sum of their binary logarithms.
    logarithms: f64,
    /// Smallest luminance of the chunk.
    min: f64,
}

impl ChunkLuminance {
    fn new(levels: &[f64]) -> ChunkLuminance {
        let mut counts = vec![0; INTERVAL_COUNT];
        let mut min = f64::INFINITY;
        for &level in levels {
            counts[interval(level)] += 1;
            min = level.min(min);
        }
        ChunkLuminance {
            counts,
            logarithms: sum_of_logarithms(levels, 0.0),
            min,
        }
    }
}

/// Returns the index of the interval of a luminance: an eighth of a power of two. The first also has what is left of negative
/// channels, which filters make, where they cancel the others.
fn interval(level: f64) -> usize {
    ((level.max(SMALLEST).to_bits() - SMALLEST.to_bits()) >> INTERVAL_BITS) as usize
}

/// Returns the sum of the binary logarithms of luminances, of which none counts as less than `darkest`.
fn sum_of_logarithms(levels: &[f64], darkest: f64) -> f64 {
    // Add exponents, and multiply significands, which are below 2: the products are below 2^512
    let (mut exponents, mut logarithms) = (0, 0.0);
    for levels in levels.chunks(512) {
        let mut products = [1.0; 8];
        for levels in levels.chunks(products.len()) {
            for (product, level) in products.iter_mut().zip(levels) {
                let bits = level.max(darkest).to_bits();
                exponents += (bits >> SIGNIFICAND_BITS) as i64 - EXPONENT_OF_ONE;
                *product *= f64::from_bits(bits & SIGNIFICAND | 1f64.to_bits());
            }
        }
        logarithms += products.iter().product::<f64>().log2();
    }
    exponents as f64 + logarithms
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(pixels: Vec<[f32; 3]>) -> LinearImage {
        LinearImage {
            width: pixels.len() as u32,
            height: 1,
            pixels,
        }
    }

    #[test]
    fn grey_image_becomes_middle_grey() {
        // log2(0.18 / 720) = -11.9658
        assert_eq!(automatic_exposure(&image(vec![[720.0; 3]; 50]), None), -11.97);
        // The geometric mean of 0.09 and 0.36 is 0.18
        let two = [[0.09; 3], [0.36; 3]].repeat(50);
        assert_eq!(automatic_exposure(&image(two), None), 0.0);
    }

    #[test]
    fn very_bright_and_very_dark_images_become_middle_grey() {
        // Products of four, and one pixel more; a product of all would overflow. log2(0.18) = -2.4739
        for (stops, expected) in [(90, -92.47), (-90, 87.53)] {
            let pixels = vec![[2f32.powi(stops); 3]; 65];
            assert_eq!(automatic_exposure(&image(pixels), None), expected);
        }
    }

    #[test]
    fn logarithms_add_up() {
        let mut random = crate::numeric::SplitMix64::new(5, 0);
        let levels: Vec<f64> = (0..1500).map(|_| random.within(-150.0, 130.0).exp2()).collect();
        let expected: f64 = levels.iter().map(|level| level.max(1e-9).log2()).sum();
        let sum = sum_of_logarithms(&levels, 1e-9);
        // 1500 partial sums of less than 2^15, each rounded by at most 2^-39
        assert!(
            (sum - expected).abs() < 1500.0 * 2f64.powi(-39),
            "{sum} and {expected}"
        );
    }

    #[test]
    fn extreme_luminances_have_an_interval() {
        let smallest = LUMINANCE[2] * f64::from(f32::from_bits(1));
        let largest = f64::from(f32::MAX) / f64::from(MIN_ALPHA);
        assert!(interval(smallest) < interval(largest) && interval(largest) < INTERVAL_COUNT);
        assert!(smallest > SMALLEST && largest < LARGEST);
        assert_eq!(interval(1e-60), 0, "negative channels may leave less");
        // 1 and 1.125 begin intervals; 1.12 lies between
        assert_eq!(
            [interval(1.12), interval(1.125)],
            [interval(1.0), interval(1.0) + 1]
        );
        let pixels = vec![[0.0, 0.0, f32::from_bits(1)], [f32::MAX; 3]];
        assert_eq!(automatic_exposure(&image(pixels), Some(&[1.0, 0.5])), -100.0);
    }

    #[test]
    fn highlights_of_more_than_a_hundredth_are_not_clipped() {
        let with_highlights = |count: usize| {
            let mut pixels = vec![[0.09; 3]; 1000 - count];
            pixels.extend(vec![[4.0; 3]; count]);
            automatic_exposure(&image(pixels), None)
        };
        // Ten highlights may clip: log2(0.18 / 0.09) less 10 log2(4 / 0.09) / 1000 = 1 - 0.0547
        assert_eq!(with_highlights(10), 0.95);
        // Eleven become white: log2(1 / 4)
        assert_eq!(with_highlights(11), -2.0);
    }

    #[test]
    fn uncovered_black_and_invalid_pixels_do_not_count() {
        let pixels = vec![[0.18; 3], [0.0; 3], [f32::NAN; 3], [f32::INFINITY; 3], [-1.0; 3]];
        assert_eq!(automatic_exposure(&image(pixels), None), 0.0);
        // A pixel of 0.09 that is half covered shows a surface of 0.18
        let pixels = vec![[0.09; 3], [9.0; 3]];
        assert_eq!(automatic_exposure(&image(pixels), Some(&[0.5, 0.49])), 0.0);
        for nothing in [vec![], vec![[0.0; 3]; 4]] {
            assert_eq!(automatic_exposure(&image(nothing), None), 0.0);
        }
        assert_eq!(automatic_exposure(&image(vec![[1e-38; 3]; 4]), None), 100.0);
    }

    #[test]
    fn deep_shadows_count_as_twelve_stops_below_white() {
        let pixels = [[1.0; 3], [1e-30; 3]].repeat(50);
        // The mean of 0 and -12 stops is -6: log2(0.18) + 6 = 3.526, but the bright half becomes white
        assert_eq!(automatic_exposure(&image(pixels), None), 0.0);
        let mut pixels = vec![[0.25; 3]; 50];
        pixels.extend(vec![[1e-30; 3]; 2]);
        // (50 (-2) + 2 (-14)) / 52 = -2.4615: log2(0.18) + 2.4615 = -0.0124
        assert_eq!(automatic_exposure(&image(pixels), None), -0.01);
    }
}
