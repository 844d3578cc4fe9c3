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
const CHUNK: usize = 1 << 14;
/// Factors of the linear channels of Rec. 709 in luminance.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Returns the stops of exposure that suit an image, in hundredths; 0 if no pixel has luminance.
///
/// Pixels without luminance, and those that `alpha` says are less than half covered, do not count.
pub fn automatic_exposure(image: &LinearImage, alpha: Option<&[f32]>) -> f32 {
    // Compute the luminances of covered pixels
    let of_chunk = |chunk: usize, pixels: &[[f32; 3]]| -> Vec<f64> {
        let level = |(index, pixel): (usize, &[f32; 3])| {
            let alpha = alpha.map_or(1.0, |alpha| alpha[index]);
            let sum: f64 = (0..3).map(|c| LUMINANCE[c] * f64::from(pixel[c])).sum();
            let level = sum / f64::from(alpha);
            (alpha >= MIN_ALPHA && level > 0.0 && level.is_finite()).then_some(level)
        };
        (chunk * CHUNK..).zip(pixels).filter_map(level).collect()
    };
    let mut levels = parallel::map_chunks(&image.pixels, CHUNK, &of_chunk).concat();
    // Find the percentile that may become white
    let rank = (WHITE_FRACTION * levels.len() as f64).ceil() as usize;
    let Some(index) = rank.checked_sub(1) else {
        return 0.0;
    };
    let white = *levels.select_nth_unstable_by(index, f64::total_cmp).1;
    // Take the geometric mean, and the smaller of both gains
    let darkest = DARKEST * white;
    let logarithms = |_, levels: &[f64]| -> f64 {
        // One logarithm for four, which lie between 2^-165 and 2^130: their product is a normal f64
        let product = |four: &[f64]| -> f64 { four.iter().map(|level| level.max(darkest)).product() };
        levels.chunks(4).map(|four| product(four).log2()).sum()
    };
    let sum: f64 = parallel::map_chunks(&levels, CHUNK, &logarithms)
        .into_iter()
        .sum();
    let of_grey = MIDDLE_GREY.log2() - sum / levels.len() as f64;
    let stops = of_grey.min(-white.log2());
    let limit = f64::from(MAX_EXPOSURE);
    ((stops * STEPS_PER_STOP).round() / STEPS_PER_STOP).clamp(-limit, limit) as f32
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
