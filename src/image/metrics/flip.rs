//! LDR-FLIP: perceived difference when an observer flips between two images on a screen.
//!
//! P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström and M. D. Fairchild, "FLIP: A Difference
//! Evaluator for Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
//! 2020. The metric is the distance of colours filtered by the eye's contrast sensitivity; it is amplified where edges
//! or points appear or vanish.

use glam::DVec3;

use super::flip_color::{Colors, hyab, luminance};
use super::flip_filter::{ContrastFilter, FeatureDetector, FlipPlane};
use crate::image::LinearImage;
use crate::parallel;

/// Exponent of colour distances (section 4.1.3).
const COLOR_EXPONENT: f64 = 0.7;
/// Fraction of the largest colour distance up to which errors are stretched, and the value that it is stretched to.
const STRETCH_END: f64 = 0.4;
const STRETCHED: f64 = 0.95;
/// Exponent of feature differences (section 4.2).
const FEATURE_EXPONENT: f64 = 0.5;

/// Function from a pixel of linear radiance to the displayed linear colour.
type DisplayFn<'a> = dyn Fn([f32; 3]) -> DVec3 + Sync + 'a;

/// Returns the error of each pixel, 0 to 1, of two images of one size; `shown` maps a pixel to its displayed colour,
/// linear and 0 to 1.
pub(super) fn error_map(images: [&LinearImage; 2], shown: &DisplayFn, pixels_per_degree: f64) -> Vec<f32> {
    if images[0].pixels.is_empty() {
        return Vec::new();
    }
    // Filter both images
    let colors = Colors::new();
    let contrast = ContrastFilter::new(pixels_per_degree);
    let detector = FeatureDetector::new(pixels_per_degree);
    let [reference, test] =
        images.map(|image| FilteredImage::new(image, shown, &colors, (&contrast, &detector)));
    // Combine colour distance and feature difference
    let largest = largest_distance(&colors);
    let error = |index: usize| {
        let distance = hyab(reference.colors[index], test.colors[index]).powf(COLOR_EXPONENT);
        let color = stretched(distance, largest);
        let change = |kind: usize| (reference.features[kind][index] - test.features[kind][index]).abs();
        // Edge and point strengths are lengths of two components of up to one: the maximum is sqrt(2).
        let feature = (change(0).max(change(1)) / std::f64::consts::SQRT_2).powf(FEATURE_EXPONENT);
        color.powf(1.0 - feature) as f32
    };
    parallel::generate(reference.colors.len(), error)
}

/// Image after the filters that model human vision.
struct FilteredImage {
    /// Filtered colours in a perceptually uniform space.
    colors: Vec<DVec3>,
    /// Strengths of edges and points.
    features: [Vec<f64>; 2],
}

impl FilteredImage {
    /// Filters an image: contrast sensitivity for colours, feature detection on luminance.
    fn new(
        image: &LinearImage,
        shown: &DisplayFn,
        colors: &Colors,
        (contrast, detector): (&ContrastFilter, &FeatureDetector),
    ) -> FilteredImage {
        // Convert to opponent colours
        let opponent = parallel::generate(image.pixels.len(), |index| {
            colors.opponent(shown(image.pixels[index]))
        });
        let plane = |of: &(dyn Fn(&DVec3) -> f64 + Sync)| FlipPlane {
            width: image.width as usize,
            values: parallel::generate(opponent.len(), |index| of(&opponent[index])),
        };
        // Apply contrast sensitivity filters
        let [y, cx, cz] = contrast.apply(&[plane(&|c| c.x), plane(&|c| c.y), plane(&|c| c.z)]);
        let perceived = |index: usize| {
            let blurred = DVec3::new(y.values[index], cx.values[index], cz.values[index]);
            // Kernels differ in width between channels, so that the filtered colour may leave the displayable range.
            colors.perceived(colors.linear(blurred).clamp(DVec3::ZERO, DVec3::ONE))
        };
        FilteredImage {
            colors: parallel::generate(opponent.len(), perceived),
            features: detector.detect(&plane(&|c| luminance(c.x))),
        }
    }
}

/// Returns the largest distance of two displayable colours: that of green and blue.
fn largest_distance(colors: &Colors) -> f64 {
    hyab(colors.perceived(DVec3::Y), colors.perceived(DVec3::Z)).powf(COLOR_EXPONENT)
}

/// Returns a colour distance relative to the largest, with small distances stretched over most of the range.
fn stretched(distance: f64, largest: f64) -> f64 {
    let end = STRETCH_END * largest;
    if distance < end {
        STRETCHED / end * distance
    } else {
        STRETCHED + (distance - end) / (largest - end) * (1.0 - STRETCHED)
    }
}

#[cfg(test)]
mod tests;
