//! HDR-FLIP: what an observer may see of two pictures at any of the exposures at which they are likely to be looked at.
//!
//! P. Andersson, J. Nilsson, P. Shirley and T. Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range
//! Images", Eurographics 2021 (short papers). The exposures are one stop or less apart and go from where the reference's
//! brightest pixel is shown at [`SHOWN`] to where its median is; a pixel's error is the largest that LDR-FLIP sees at any
//! of them.

use glam::DVec3;

use super::clipped;
use super::flip::error_map;
use crate::image::LinearImage;

/// What a screen shows, as a part of white, of the pixel that an exposure is made for.
const SHOWN: f64 = 0.85;
/// The film-like curve that pictures are shown by: coefficients of x^2, x and 1 above and below the line (K. Narkowicz's
/// fit of the curve of the Academy Color Encoding System, for radiances of a 0.6th).
const ABOVE: [f64; 3] = [0.36 * 2.51, 0.6 * 0.03, 0.0];
const BELOW: [f64; 3] = [0.36 * 2.43, 0.6 * 0.59, 0.14];
/// The least that a reference's median luminance is taken for, so that there are no more than some dozens of exposures.
const MIN_MEDIAN: f64 = f32::EPSILON as f64;

/// The error of each pixel, 0 to 1, of two pictures of one size and linear radiance.
pub(super) fn hdr_error_map(reference: &LinearImage, test: &LinearImage, pixels_per_degree: f64) -> Vec<f32> {
    let mut worst = vec![0.0f32; reference.pixels.len()];
    for exposure in exposures(reference) {
        let gain = exposure.exp2();
        let shown = |pixel: [f32; 3]| DVec3::from(pixel.map(|channel| curve(gain * f64::from(channel))));
        for (worst, error) in worst
            .iter_mut()
            .zip(error_map([reference, test], &shown, pixels_per_degree))
        {
            *worst = worst.max(error);
        }
    }
    worst
}

/// Stops at which a reference is looked at, two or more and lowest first; none for one without light.
fn exposures(reference: &LinearImage) -> Vec<f64> {
    let luminance = |[r, g, b]: &[f32; 3]| {
        let [r, g, b] = [r, g, b].map(|&x| if x.is_finite() { f64::from(x).max(0.0) } else { 0.0 });
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let mut all: Vec<f64> = reference.pixels.iter().map(luminance).collect();
    all.sort_unstable_by(f64::total_cmp);
    let Some(&brightest) = all.last().filter(|&&brightest| brightest > 0.0) else {
        return Vec::new();
    };
    let stops_for = |luminance: f64| (radiance_shown_at(SHOWN) / luminance).log2();
    let first = stops_for(brightest);
    let last = stops_for(all[all.len() / 2].max(MIN_MEDIAN)).max(first);
    let count = (last - first).ceil().max(2.0);
    (0..count as u32)
        .map(|i| first + f64::from(i) * (last - first) / (count - 1.0))
        .collect()
}

fn polynomial([a, b, c]: [f64; 3], x: f64) -> f64 {
    (a * x + b) * x + c
}

/// What a screen shows of a radiance, 0 to 1; what is no number is black.
fn curve(radiance: f64) -> f64 {
    // Beyond, the curve is white; products with it stay finite.
    let x = if radiance > 0.0 { radiance.min(1e6) } else { 0.0 };
    clipped(polynomial(ABOVE, x) / polynomial(BELOW, x))
}

/// The radiance of which the curve makes `shown`: the larger root.
fn radiance_shown_at(shown: f64) -> f64 {
    let [a, b, c] = [0, 1, 2].map(|i| ABOVE[i] - shown * BELOW[i]);
    (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
}

#[cfg(test)]
mod tests {
    use super::super::pairs::{COUNT, mean, pairs};
    use super::*;

    /// What `flip-evaluator` 1.7, of FLIP's authors, gives for the pairs of LDR-FLIP's tests with radiance 2^(c/32 - 4)
    /// for the code c: first and last exposure, how many there are, the mean at 67 pixels a degree, and the errors of the
    /// pixels (0, 0), (11, 8), (12, 8) and (23, 16).
    const PUBLISHED: [(f64, f64, usize, f64, [f64; 4]); COUNT] = [
        (
            -2.433_073,
            0.129_427,
            3,
            0.321_406,
            [0.043_031, 0.349_744, 0.448_245, 0.407_794],
        ),
        (
            -1.166_703,
            -1.166_703,
            2,
            0.117_142,
            [0.0, 0.454_440, 0.492_426, 0.0],
        ),
        (
            -0.022_001,
            1.009_249,
            2,
            0.004_703,
            [0.0, 0.144_975, 0.105_838, 0.0],
        ),
        (-2.404_163, -2.404_163, 2, 0.995_932, [0.995_926; 4]),
    ];

    #[test]
    fn errors_are_those_of_the_authors_program() {
        // As for LDR-FLIP: it computes in f32, and takes 67.02 pixels for a degree.
        const F32_IN_A_ROOT: f64 = 3.5e-4;
        let pairs = pairs(|code| (f64::from(code) / 32.0 - 4.0).exp2());
        for ((name, [reference, test]), published) in pairs.iter().zip(PUBLISHED) {
            let (first, last, count, expected, pixels) = published;
            let stops = exposures(reference);
            assert_eq!(stops.len(), count, "{name}");
            for (stop, expected) in [(stops[0], first), (stops[count - 1], last)] {
                assert!((stop - expected).abs() < 1e-5, "{name}: {stop}");
            }
            let errors = hdr_error_map(reference, test, 67.0);
            assert!(
                (mean(&errors) - expected).abs() < F32_IN_A_ROOT,
                "{name}: {}",
                mean(&errors)
            );
            for ((x, y), expected) in [(0, 0), (11, 8), (12, 8), (23, 16)].into_iter().zip(pixels) {
                let error = f64::from(errors[y * 24 + x]);
                assert!(
                    (error - expected).abs() < F32_IN_A_ROOT,
                    "{name} at ({x}, {y}): {error}"
                );
            }
        }
    }

    #[test]
    fn the_curve_shows_what_exposures_are_made_for() {
        assert!((curve(radiance_shown_at(SHOWN)) - SHOWN).abs() < 1e-12);
        assert_eq!(curve(f64::INFINITY), 1.0);
        assert_eq!(curve(f64::NAN), 0.0);
        assert_eq!(curve(-1.0), 0.0);
    }

    #[test]
    fn a_dark_reference_has_few_exposures() {
        let mut image = LinearImage::black(3, 3);
        assert!(exposures(&image).is_empty());
        assert_eq!(hdr_error_map(&image, &image, 67.0), [0.0; 9]);
        image.pixels[4] = [5.0; 3];
        assert_eq!(exposures(&image).len(), 26);
        image.pixels[4] = [f32::NAN, f32::INFINITY, 1.0];
        assert!(exposures(&image).len() < 40);
    }
}
