//! Tests of LDR-FLIP against values of its authors' program, and against a direct implementation of its formulas.

use std::f64::consts::PI;

use super::super::clipped;
use super::*;
use crate::image::linear_from_srgb;
use crate::image::metrics::PIXELS_PER_DEGREE;
use crate::image::metrics::pairs::{self, COUNT, image, mean};

fn clipped_pixel(pixel: [f32; 3]) -> DVec3 {
    DVec3::from(pixel.map(|channel| clipped(channel.into())))
}

fn displayed(code: u32) -> f64 {
    linear_from_srgb(f64::from(code) / 255.0)
}

fn pairs() -> [(&'static str, [LinearImage; 2]); COUNT] {
    pairs::pairs(displayed)
}

fn map(pair: &[LinearImage; 2], pixels_per_degree: f64) -> Vec<f32> {
    error_map([&pair[0], &pair[1]], &clipped_pixel, pixels_per_degree)
}

/// Results of `flip-evaluator` 1.7, by FLIP's authors, for [`pairs`]: the means at 67 and at 30 pixels per degree, and
/// at 67 the errors of the pixels (0, 0), (11, 8), (12, 8) and (23, 16).
///
/// It computes in f32. An error of 2^-23 in a feature difference is 3e-4 in its root, and the observed differences are
/// no larger.
const PUBLISHED: [(f64, f64, [f64; 4]); COUNT] = [
    (0.291_920, 0.418_501, [0.059_762, 0.324_991, 0.442_9, 0.395_114]),
    (0.099_853, 0.077_810, [0.0, 0.392_042, 0.447_786, 0.0]),
    (0.011_179, 0.006_980, [0.0, 0.377_666, 0.286_362, 0.0]),
    (1.0, 1.0, [1.0, 1.0, 1.0, 1.0]),
];

#[test]
fn errors_match_the_published_program() {
    const F32_IN_A_ROOT: f64 = 3.5e-4;
    for ((name, pair), (at_67, at_30, pixels)) in pairs().iter().zip(PUBLISHED) {
        let errors = map(pair, 67.0);
        assert!(
            (mean(&errors) - at_67).abs() < F32_IN_A_ROOT,
            "{name}: {}",
            mean(&errors)
        );
        assert!(
            (mean(&map(pair, 30.0)) - at_30).abs() < F32_IN_A_ROOT,
            "{name} at 30"
        );
        for ((x, y), expected) in [(0, 0), (11, 8), (12, 8), (23, 16)].into_iter().zip(pixels) {
            let error = f64::from(errors[y * 24 + x]);
            assert!(
                (error - expected).abs() < F32_IN_A_ROOT,
                "{name} at {x}, {y}: {error}"
            );
        }
    }
}

/// Weights of a two-dimensional filter with their offsets.
struct Weights(Vec<((i32, i32), f64)>);

impl Weights {
    fn new(radius: i32, weight: impl Fn(f64, f64) -> f64) -> Weights {
        let offsets = (-radius..=radius).flat_map(|y| (-radius..=radius).map(move |x| (x, y)));
        Weights(
            offsets
                .map(|(x, y)| ((x, y), weight(f64::from(x), f64::from(y))))
                .collect(),
        )
    }

    /// Scales positive weights to a sum of one, and negative weights to a sum of minus one.
    fn scaled(mut self) -> Weights {
        let sum_of = |sign: f64| self.0.iter().map(|(_, w)| (sign * w).max(0.0)).sum::<f64>();
        let (above, below) = (sum_of(1.0), sum_of(-1.0));
        for (_, weight) in &mut self.0 {
            *weight /= if *weight > 0.0 { above } else { below };
        }
        self
    }

    /// Convolves directly, as in the paper, with the plane extended by its border pixels.
    fn convolve(&self, plane: &FlipPlane) -> Vec<f64> {
        let (width, height) = (plane.width as i32, (plane.values.len() / plane.width) as i32);
        let value = |at: i32, (x, y): (i32, i32)| {
            let column = (at % width + x).clamp(0, width - 1);
            plane.values[((at / width + y).clamp(0, height - 1) * width + column) as usize]
        };
        (0..width * height)
            .map(|at| self.0.iter().map(|&(offset, w)| w * value(at, offset)).sum())
            .collect()
    }
}

/// Returns perceived colours, edges and points of an image, directly by the paper's formulas.
fn filtered_directly(image: &LinearImage, ppd: f64) -> (Vec<DVec3>, [Vec<f64>; 2]) {
    // Convert to opponent colours
    let colors = Colors::new();
    let opponent: Vec<DVec3> = image
        .pixels
        .iter()
        .map(|pixel| colors.opponent(DVec3::from(pixel.map(f64::from))))
        .collect();
    let plane = |of: &dyn Fn(&DVec3) -> f64| FlipPlane {
        width: image.width as usize,
        values: opponent.iter().map(of).collect(),
    };
    // Filter by contrast sensitivity, with the constants of table 1
    let table = [
        [1.0, 0.0047, 0.0, 1e-5],
        [1.0, 0.0053, 0.0, 1e-5],
        [34.1, 0.04, 13.5, 0.025],
    ];
    let radius = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i32;
    let blurred: Vec<Vec<f64>> = (0..3)
        .map(|channel| {
            let [a1, b1, a2, b2] = table[channel];
            let sensitivity = |x: f64, y: f64| {
                let d2 = (x * x + y * y) / (ppd * ppd);
                let gaussian = |a: f64, b: f64| a * (PI / b).sqrt() * (-PI * PI * d2 / b).exp();
                gaussian(a1, b1) + gaussian(a2, b2)
            };
            Weights::new(radius, sensitivity)
                .scaled()
                .convolve(&plane(&|c| c[channel]))
        })
        .collect();
    // Convert to perceptually uniform colours
    let perceived = |i: usize| {
        let linear = colors.linear(DVec3::new(blurred[0][i], blurred[1][i], blurred[2][i]));
        colors.perceived(linear.clamp(DVec3::ZERO, DVec3::ONE))
    };
    // Detect edges and points
    let gray = plane(&|c| (c.x + 16.0) / 116.0);
    let sd = 0.5 * 0.082 * ppd;
    let radius = (3.0 * sd).ceil() as i32;
    let gaussian = |x: f64, y: f64| (-(x * x + y * y) / (2.0 * sd * sd)).exp();
    let edge = |x: f64, y: f64| -x * gaussian(x, y);
    let point = |x: f64, y: f64| (x * x / (sd * sd) - 1.0) * gaussian(x, y);
    let detect = |derivative: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
        let across = Weights::new(radius, derivative).scaled().convolve(&gray);
        let down = Weights::new(radius, |x, y| derivative(y, x))
            .scaled()
            .convolve(&gray);
        across.iter().zip(down).map(|(a, d)| a.hypot(d)).collect()
    };
    let features = [detect(&edge), detect(&point)];
    ((0..opponent.len()).map(perceived).collect(), features)
}

#[test]
fn separable_filters_match_the_single_pass_of_the_paper() {
    for (name, [image, _]) in pairs() {
        let contrast = ContrastFilter::new(PIXELS_PER_DEGREE);
        let detector = FeatureDetector::new(PIXELS_PER_DEGREE);
        let seen = FilteredImage::new(&image, &clipped_pixel, &Colors::new(), (&contrast, &detector));
        let (colors, features) = filtered_directly(&image, PIXELS_PER_DEGREE);
        // Sums of some 441 products of values up to 500: 441 · 500 · 2^-53 = 2.4e-11, and as much from a cube root near
        // black.
        for (a, b) in seen.colors.iter().zip(&colors) {
            assert!(a.abs_diff_eq(*b, 1e-9), "{name}: {a} {b}");
        }
        for (a, b) in seen.features.iter().flatten().zip(features.iter().flatten()) {
            assert!((a - b).abs() < 1e-12, "{name}: {a} {b}");
        }
    }
}

#[test]
fn flip_error_is_symmetric() {
    for (name, [a, b]) in pairs() {
        assert_eq!(map(&[a.clone(), b.clone()], 67.0), map(&[b, a], 67.0), "{name}");
    }
}

#[test]
fn image_has_no_error_against_itself() {
    for (name, [a, _]) in pairs() {
        assert!(
            map(&[a.clone(), a], 67.0).iter().all(|&error| error == 0.0),
            "{name}"
        );
    }
}

#[test]
fn greater_difference_gives_greater_error() {
    let gray = |code| image(move |_, _, _| code, displayed);
    let errors: Vec<f64> = [100, 101, 110, 150, 255]
        .map(|code| mean(&map(&[gray(100), gray(code)], 67.0)))
        .to_vec();
    assert!(
        errors.is_sorted() && errors[0] == 0.0 && errors[1] > 0.0,
        "{errors:?}"
    );
}

#[test]
fn images_of_one_or_no_pixels_have_an_error() {
    let one = LinearImage {
        width: 1,
        height: 1,
        pixels: vec![[1.0; 3]],
    };
    assert!(error_map([&one, &LinearImage::black(1, 1)], &clipped_pixel, 67.0)[0] > 0.9);
    assert!(
        error_map(
            [&LinearImage::default(), &LinearImage::default()],
            &clipped_pixel,
            67.0
        )
        .is_empty()
    );
}
