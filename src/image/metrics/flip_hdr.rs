//! HDR-FLIP: perceived difference of two images over the range of exposures at which they are likely to be viewed.
//!
//! P. Andersson, J. Nilsson, P. Shirley and T. Akenine-Möller, "Visualizing Errors in Rendered High Dynamic Range
//! Images", Eurographics 2021 (short papers). The exposures are at most one stop apart and range from the one that
//! displays the reference's brightest pixel at [`SHOWN`] to the one that displays its median there; a pixel's error is
//! the maximum of LDR-FLIP over all of them.

use glam::DVec3;

use super::clipped;
use super::flip::error_map;
use crate::image::LinearImage;

/// Displayed value, relative to white, of the pixel that an exposure is made for.
const SHOWN: f64 = 0.85;
/// Filmic tone curve: coefficients of x^2, x and 1 of numerator and denominator (K. Narkowicz's fit of the curve of the
/// Academy Color Encoding System, with radiance scaled by 0.6).
const ABOVE: [f64; 3] = [0.36 * 2.51, 0.6 * 0.03, 0.0];
const BELOW: [f64; 3] = [0.36 * 2.43, 0.6 * 0.59, 0.14];
/// Lower bound of a reference's median luminance, which limits the exposures to some dozens.
const MIN_MEDIAN: f64 = f32::EPSILON as f64;

/// Returns the error of each pixel, 0 to 1, of two images of one size and linear radiance.
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

/// Returns the exposures in stops for a reference, two or more and lowest first; none for a black one.
fn exposures(reference: &LinearImage) -> Vec<f64> {
    // Sort pixels by luminance; non-finite values count as 0
    let luminance = |[r, g, b]: &[f32; 3]| {
        let [r, g, b] = [r, g, b].map(|&x| if x.is_finite() { f64::from(x).max(0.0) } else { 0.0 });
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let mut all: Vec<f64> = reference.pixels.iter().map(luminance).collect();
    all.sort_unstable_by(f64::total_cmp);
    let Some(&brightest) = all.last().filter(|&&brightest| brightest > 0.0) else {
        return Vec::new();
    };
    // Find exposures of the brightest pixel and the median
    let stops_for = |luminance: f64| (radiance_shown_at(SHOWN) / luminance).log2();
    let first = stops_for(brightest);
    let last = stops_for(all[all.len() / 2].max(MIN_MEDIAN)).max(first);
    // Space the exposures evenly, at most one stop apart
    let count = (last - first).ceil().max(2.0);
    (0..count as u32)
        .map(|i| first + f64::from(i) * (last - first) / (count - 1.0))
        .collect()
}

/// Evaluates a quadratic polynomial.
fn polynomial([a, b, c]: [f64; 3], x: f64) -> f64 {
    (a * x + b) * x + c
}

/// Returns the displayed value of a radiance, 0 to 1; NaN is black.
fn curve(radiance: f64) -> f64 {
    // The curve is white beyond this bound, which keeps products finite.
    let x = if radiance > 0.0 { radiance.min(1e6) } else { 0.0 };
    clipped(polynomial(ABOVE, x) / polynomial(BELOW, x))
}

/// Returns the radiance that the curve maps to `shown`: the larger root.
fn radiance_shown_at(shown: f64) -> f64 {
    let [a, b, c] = [0, 1, 2].map(|i| ABOVE[i] - shown * BELOW[i]);
    (-b + (b * b - 4.0 * a * c).sqrt()) / (2.0 * a)
}

#[cfg(test)]
mod tests {
    use super::super::pairs::{COUNT, mean, pairs};
    use super::*;

    /// Results of `flip-evaluator` 1.7, by FLIP's authors, for the pairs of LDR-FLIP's tests with radiance 2^(c/32 - 4)
    /// for the code c: first and last exposure, their number, the mean at 67 pixels per degree, and the errors of the
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
    fn errors_match_the_published_program() {
        // Tolerance as for LDR-FLIP: the program computes in f32, and uses 67.02 pixels per degree.
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
    fn tone_curve_inverts_and_clamps() {
        assert!((curve(radiance_shown_at(SHOWN)) - SHOWN).abs() < 1e-12);
        assert_eq!(curve(f64::INFINITY), 1.0);
        assert_eq!(curve(f64::NAN), 0.0);
        assert_eq!(curve(-1.0), 0.0);
    }

    #[test]
    fn dark_reference_has_few_exposures() {
        let mut image = LinearImage::black(3, 3);
        assert!(exposures(&image).is_empty());
        assert_eq!(hdr_error_map(&image, &image, 67.0), [0.0; 9]);
        image.pixels[4] = [5.0; 3];
        assert_eq!(exposures(&image).len(), 26);
        image.pixels[4] = [f32::NAN, f32::INFINITY, 1.0];
        assert!(exposures(&image).len() < 40);
    }
}
