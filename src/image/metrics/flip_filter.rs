//! Filters of FLIP: contrast sensitivity of the eye at a viewing distance, and detectors of edges and points.
//!
//! Andersson et al. 2020, sections 4.1.1 (contrast sensitivity) and 4.2 (features). All are Gaussians, their
//! derivatives, or sums of Gaussians, and therefore separable into a horizontal and a vertical filter. Beyond its edges
//! an image is extended by its border pixels.
//! on with the pixels there.

use std::f64::consts::PI;

use crate::parallel;

/// One channel of an image, row by row.
pub(super) struct FlipPlane {
    pub(super) width: usize,
    pub(super) values: Vec<f64>,
}

/// Weights of `2 radius + 1` neighbouring pixels, in one dimension.
pub(super) struct FlipKernel(Vec<f64>);

impl FlipKernel {
    /// Samples `weight` at the integers from -`radius` to `radius`.
    fn new(radius: i32, weight: impl Fn(f64) -> f64) -> FlipKernel {
        FlipKernel((-radius..=radius).map(|x| weight(f64::from(x))).collect())
    }

    /// Returns a Gaussian kernel whose weights sum to one.
    pub(super) fn gaussian(radius: i32, deviation: f64) -> FlipKernel {
        FlipKernel::new(radius, |x| (-x * x / (2.0 * deviation * deviation)).exp()).normalised()
    }

    /// Scales the weights so that they sum to one.
    fn normalised(mut self) -> FlipKernel {
        let sum: f64 = self.0.iter().sum();
        self.0.iter_mut().for_each(|weight| *weight /= sum);
        self
    }

    /// Scales positive weights to a sum of one, and negative weights to a sum of minus one.
    fn balanced(mut self) -> FlipKernel {
        let sum_of = |sign: f64| self.0.iter().map(|w| (sign * w).max(0.0)).sum::<f64>();
        let (above, below) = (sum_of(1.0), sum_of(-1.0));
        for weight in &mut self.0 {
            *weight /= if *weight > 0.0 { above } else { below };
        }
        self
    }
}

impl FlipPlane {
    /// Returns the plane filtered horizontally by `across` and vertically by `down`.
    pub(super) fn filtered(&self, across: &FlipKernel, down: &FlipKernel) -> FlipPlane {
        self.filtered_across(across).filtered_down(down)
    }

    /// Filters each row, extended by its border pixels.
    fn filtered_across(&self, kernel: &FlipKernel) -> FlipPlane {
        let radius = kernel.0.len() / 2;
        let filter_row = |_, row: &[f64]| -> Vec<f64> {
            let first = std::iter::repeat_n(row[0], radius);
            let last = std::iter::repeat_n(row[row.len() - 1], radius);
            let padded: Vec<f64> = first.chain(row.iter().copied()).chain(last).collect();
            let weigh = |around: &[f64]| around.iter().zip(&kernel.0).map(|(v, w)| v * w).sum();
            padded.windows(kernel.0.len()).map(weigh).collect()
        };
        FlipPlane {
            width: self.width,
            values: parallel::map_chunks(&self.values, self.width, &filter_row).concat(),
        }
    }

    /// Filters each column, extended by its border pixels.
    fn filtered_down(&self, kernel: &FlipKernel) -> FlipPlane {
        let (width, radius) = (self.width, kernel.0.len() / 2);
        let last = self.values.len() / width - 1;
        let mut values = vec![0.0; self.values.len()];
        parallel::for_each_chunk_mut(&mut values, width, &|y, row| {
            for (k, weight) in kernel.0.iter().enumerate() {
                let from = (y + k).saturating_sub(radius).min(last) * width;
                for (sum, value) in row.iter_mut().zip(&self.values[from..from + width]) {
                    *sum += weight * value;
                }
            }
        });
        FlipPlane { width, values }
    }
}

/// Gaussian term of a channel's contrast sensitivity: `a √(π/b) exp(-π² d² / b)` at a distance of d degrees.
#[derive(Clone, Copy)]
struct Sensitivity {
    a: f64,
    b: f64,
}

/// Sensitivities of lightness, red-green and blue-yellow (table 1); the last is a sum of two Gaussians.
const LIGHTNESS: Sensitivity = Sensitivity { a: 1.0, b: 0.0047 };
const RED_GREEN: Sensitivity = Sensitivity { a: 1.0, b: 0.0053 };
const BLUE_YELLOW: [Sensitivity; 2] = [
    Sensitivity { a: 34.1, b: 0.04 },
    Sensitivity { a: 13.5, b: 0.025 },
];

/// Contrast sensitivity filters of the channels of YCxCz.
pub(super) struct ContrastFilter {
    lightness: FlipKernel,
    red_green: FlipKernel,
    /// Two Gaussians with their shares of the sum.
    blue_yellow: [(FlipKernel, f64); 2],
}

impl ContrastFilter {
    pub(super) fn new(pixels_per_degree: f64) -> ContrastFilter {
        // Truncate at three standard deviations of the widest Gaussian.
        let widest = BLUE_YELLOW[0].b / (2.0 * PI * PI);
        let radius = (3.0 * widest.sqrt() * pixels_per_degree).ceil() as i32;
        let kernel =
            |s: Sensitivity| FlipKernel::new(radius, |x| (-(PI * x / pixels_per_degree).powi(2) / s.b).exp());
        // In two dimensions the sum of a separable Gaussian is the square of its sum along one axis.
        let parts = BLUE_YELLOW.map(|s| s.a * (PI / s.b).sqrt() * kernel(s).0.iter().sum::<f64>().powi(2));
        let sum: f64 = parts.iter().sum();
        ContrastFilter {
            lightness: kernel(LIGHTNESS).normalised(),
            red_green: kernel(RED_GREEN).normalised(),
            blue_yellow: [0, 1].map(|i| (kernel(BLUE_YELLOW[i]).normalised(), parts[i] / sum)),
        }
    }

    pub(super) fn apply(&self, channels: &[FlipPlane; 3]) -> [FlipPlane; 3] {
        let [y, cx, cz] = channels;
        let [(wide, wide_part), (narrow, narrow_part)] = &self.blue_yellow;
        let mut blue_yellow = cz.filtered(wide, wide);
        let second = cz.filtered(narrow, narrow);
        for (value, other) in blue_yellow.values.iter_mut().zip(second.values) {
            *value = wide_part * *value + narrow_part * other;
        }
        [
            y.filtered(&self.lightness, &self.lightness),
            cx.filtered(&self.red_green, &self.red_green),
            blue_yellow,
        ]
    }
}

/// Width of the features that the eye detects, in degrees.
const FEATURE_WIDTH: f64 = 0.082;

/// Filters for the strength of edges and points at each pixel.
pub(super) struct FeatureDetector {
    smooth: FlipKernel,
    edge: FlipKernel,
    point: FlipKernel,
}

impl FeatureDetector {
    pub(super) fn new(pixels_per_degree: f64) -> FeatureDetector {
        let sd = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let radius = (3.0 * sd).ceil() as i32;
        let gaussian = |x: f64| (-0.5 * (x / sd).powi(2)).exp();
        FeatureDetector {
            smooth: FlipKernel::new(radius, gaussian).normalised(),
            edge: FlipKernel::new(radius, |x| -x * gaussian(x)).balanced(),
            point: FlipKernel::new(radius, |x| ((x / sd).powi(2) - 1.0) * gaussian(x)).balanced(),
        }
    }

    /// Returns the edge and point strengths of a luminance plane.
    pub(super) fn detect(&self, luminance: &FlipPlane) -> [Vec<f64>; 2] {
        [&self.edge, &self.point].map(|derivative| {
            let across = luminance.filtered(derivative, &self.smooth).values;
            let down = luminance.filtered(&self.smooth, derivative).values;
            across.iter().zip(down).map(|(a, d)| a.hypot(d)).collect()
        })
    }
}
