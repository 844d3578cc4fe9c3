//! Display-referred error of pixels, the basis of decisions in adaptive sampling.
//!
//! The display value is a curve close to that of sRGB, but based on a square root, which is rounded identically on
//! every machine: decisions must not depend on the implementation of `pow`. It continues above white, so that
//! highlights of linear images count too.

use super::super::film::PixelStatistics;

/// Offset r of the display curve, (√(x + r²) - r) (√(1 + r²) + r), that makes its slope at zero 12.92, as in
/// IEC 61966-2-1: (√(1 + r²) + r) / (2 r) = 12.92.
pub(in crate::render) const DISPLAY_ROOT: f64 = 0.0403;

/// Statistics of a pixel in display values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DisplayError {
    /// Display value of one standard error of the mean.
    pub(super) error: f64,
    /// Fraction of the squared error that is noise, which decreases with the number of samples n as 1 / n; the rest
    /// is due to edges and decreases as 1 / n^1.5.
    pub(super) noise: f64,
    /// Display values of the darkest and the brightest sample.
    pub(super) extremes: [f64; 2],
    /// Steps in display value if one of n + 1 samples has the darkest, or the brightest, value; 0 if more than one
    /// sample has such a value.
    pub(super) single_steps: [f64; 2],
    /// Number of samples of the pixel.
    pub(super) count: u32,
}

impl DisplayError {
    /// Returns the statistics of a pixel whose radiance is multiplied by `gain`, with the fraction `noise` of its
    /// variance.
    pub(super) fn of(estimate: &PixelStatistics, noise: f64, gain: f64) -> DisplayError {
        let count = f64::from(estimate.count);
        let mean = gain * estimate.luminance();
        // The error of edges decreases faster with the number of samples than that of noise.
        let of_edges = (1.0 - noise) / count.sqrt();
        let error = gain * (estimate.variance() * (noise + of_edges) / count).sqrt();
        DisplayError {
            error: display_value(mean + error) - display_value(mean),
            noise: noise / (noise + of_edges),
            extremes: estimate.extremes.map(|l| display_value(gain * f64::from(l))),
            single_steps: [0, 1].map(|end| single_step(estimate, end, gain)),
            count: estimate.count,
        }
    }

    /// Returns the number of samples, by doubling, at which the error is expected to be at most `target`, limited to
    /// `limit`.
    pub(super) fn likely_count(&self, target: f64, limit: u32) -> u32 {
        let (mut noise, mut edges) = (self.noise, 1.0 - self.noise);
        let mut count = self.count.min(limit);
        while count < limit && self.error * self.error * (noise + edges) > target * target {
            // Doubling the samples divides noise by 2 and edges by 2^1.5
            count = count.saturating_mul(2).min(limit);
            noise /= 2.0;
            edges /= 8f64.sqrt();
        }
        count
    }

    /// Returns the larger of the steps in display value by which a neighbour exceeds this pixel's extremes.
    pub(super) fn unseen_step(&self, neighbour: &DisplayError) -> f64 {
        let brighter = neighbour.extremes[1] - self.extremes[1];
        let darker = self.extremes[0] - neighbour.extremes[0];
        brighter.max(darker)
    }
}

/// Sums of variance and of its noise part over several pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NoiseModel {
    variance: f64,
    noise: f64,
}

impl NoiseModel {
    /// Adds the variance of a pixel.
    pub(super) fn add(&mut self, estimate: &PixelStatistics) {
        self.variance += estimate.variance();
        self.noise += estimate.noise_variance();
    }

    /// Returns the sums over both sets of pixels.
    pub(super) fn merged(self, other: &NoiseModel) -> NoiseModel {
        NoiseModel {
            variance: self.variance + other.variance,
            noise: self.noise + other.noise,
        }
    }

    /// Returns the fraction of the variance that is noise, from 0 to 1; the rest is due to edges.
    pub(super) fn noise(&self) -> f64 {
        if self.variance > 0.0 {
            (self.noise / self.variance).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}

/// Returns one of [`DisplayError::single_steps`], for the dark `end` 0 or the bright end 1.
fn single_step(estimate: &PixelStatistics, end: usize, gain: f64) -> f64 {
    let count = f64::from(estimate.count);
    let [own, others] = [end, 1 - end].map(|end| f64::from(estimate.extremes[end]));
    // A single sample moves the mean of n by 1/n of the range, two by 2/n. For equal samples the quotient is NaN.
    let is_single = (estimate.luminance() - others) / (own - others) < 1.5 / count;
    if !is_single {
        return 0.0;
    }
    let moved = others + (own - others) / (count + 1.0);
    (display_value(gain * moved) - display_value(gain * others)).abs()
}

/// Returns approximately the sRGB value of a luminance, from 0 for black to 1 for white and beyond: within 0.07 of
/// it, and with the same slope at black.
pub(super) fn display_value(luminance: f64) -> f64 {
    const ROOT: f64 = DISPLAY_ROOT;
    let shifted = |x: f64| (x + ROOT * ROOT).sqrt();
    (shifted(luminance.clamp(0.0, f64::INFINITY)) - ROOT) * (shifted(1.0) + ROOT)
}

#[cfg(test)]
mod tests {
    use super::super::super::film::estimate;
    use super::super::super::sampler::{Purpose, sample_2d};
    use super::*;
    use crate::scene::image_settings::Pattern;

    #[test]
    fn display_value_approximates_srgb_within_its_range() {
        assert_eq!(display_value(0.0), 0.0);
        assert_eq!(display_value(-1.0), 0.0);
        assert!((display_value(1.0) - 1.0).abs() < 1e-15);
        assert!((display_value(1e-7) / 1e-7 / 12.92 - 1.0).abs() < 1e-3);
        for step in 0..=1000 {
            let luminance = f64::from(step) / 1000.0;
            let srgb = if luminance <= 0.003_130_8 {
                12.92 * luminance
            } else {
                1.055 * luminance.powf(1.0 / 2.4) - 0.055
            };
            assert!((display_value(luminance) - srgb).abs() < 0.07, "{luminance}");
        }
    }

    /// Returns the noise fraction of 500 pixels that see `seen` at `count` stratified positions, and at random
    /// positions.
    fn noise_at(count: u32, seen: impl Fn([u32; 2], [f64; 2]) -> f64) -> [f64; 2] {
        [Purpose::FILM, Purpose(7)].map(|purpose| {
            let mut noise_model = NoiseModel::default();
            for number in 0..500 {
                let pixel = [number, 3];
                let samples = (0..count).map(|sample| {
                    // Take one sample from each of many pixels, which are random.
                    let (pixel_of_place, sample) = match purpose {
                        Purpose::FILM => (pixel, sample),
                        _ => ([sample, 1000 + number], 0),
                    };
                    let place = sample_2d(Pattern::Sobol, pixel_of_place, sample, 1024, purpose);
                    seen(pixel, place)
                });
                noise_model.add(&estimate(&samples.collect::<Vec<f64>>()));
            }
            noise_model.noise()
        })
    }

    #[test]
    fn evenly_spread_samples_distinguish_edges_from_noise() {
        // An edge across each pixel, with an angle and a distance from the centre that depend on the pixel.
        let edge = |pixel: [u32; 2], place: [f64; 2]| {
            let (angle, distance) = (f64::from(pixel[0]) * 2.4, f64::from(pixel[0] % 7) / 14.0 - 0.2);
            let (sin, cos) = angle.sin_cos();
            f64::from(u8::from(
                (place[0] - 0.5) * cos + (place[1] - 0.5) * sin > distance,
            ))
        };
        for (count, limit) in [(16, 0.3), (32, 0.15), (256, 0.15)] {
            let [even, random] = noise_at(count, edge);
            assert!(even < limit, "{count} samples: {even}");
            assert!(random > 0.75, "{count} samples: {random}");
        }
    }

    #[test]
    fn noise_has_larger_error_that_is_mostly_noise() {
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let estimate = estimate(&half);
        // Half of the variance, 4/15, over 16, and half of it over 64: four fifths of the square is noise.
        let look = DisplayError::of(&estimate, 0.5, 1.0);
        let square: f64 = 0.5 * 4.0 / 15.0 * (1.0 / 16.0 + 1.0 / 64.0);
        let expected = display_value(0.5 + square.sqrt()) - display_value(0.5);
        assert!((look.error - expected).abs() < 1e-12, "{}", look.error);
        assert!((look.noise - 0.8).abs() < 1e-15);
    }

    #[test]
    fn error_is_measured_in_display_values() {
        // Eight samples of 0 and eight of 1: variance 16/15 · 1/4; over 16^1.5 = 64, its root is 0.064550.
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let look = DisplayError::of(&estimate(&half), 0.0, 1.0);
        let expected = display_value(0.5 + (16.0 / 15.0 / 4.0 / 64.0f64).sqrt()) - display_value(0.5);
        assert!((look.error - expected).abs() < 1e-12, "{}", look.error);
        assert_eq!(look.extremes[0], 0.0);
    }
}
