//! Pilot rounds of adaptive sampling, which estimate the equivalent number of evenly distributed samples per pixel.
//!
//! Textures are filtered over the footprint of a sample, so ray cones must fit the final number of samples before the
//! first one is taken. Narrower cones leave gaps between samples, wider ones blur beyond the pixel, and rounds with
//! different widths do both. Adaptive sampling should give the same result as a number of evenly distributed samples
//! at a lower cost, so its rays have the width of theirs.
//!
//! One pixel of every block of 8 x 8 has its first round before all others. Its error predicts the round in which it
//! will reach the target, and all these pixels together predict how many evenly distributed samples have the same
//! error; the fraction of noise is estimated from all of them together as well. Rays of that width may resolve more
//! detail, so these pixels repeat their first round until the number settles.

use super::super::film::PixelStatistics;
use super::display_error::{DisplayError, NoiseModel};
use super::forecast::PassForecast;
use super::target::{Adaptive, ROUND};

/// Side of a block in pixels.
const BLOCK: usize = 8;

/// Factor of change below which the number of evenly distributed samples has settled: ray widths are then accurate to
/// a tenth.
const SETTLED: f64 = 1.2;

/// Largest number of pilot rounds, after which the number is used as it is: each takes a quarter of a sample per
/// pixel of the image.
pub(super) const MAX_ROUNDS: usize = 4;

/// Returns whether a pixel belongs to the pilot: the middle one of its block, or the last one of a cut block.
pub(super) fn is_pilot_pixel([column, row]: [usize; 2], [width, height]: [usize; 2]) -> bool {
    let is_middle = |at: usize, size: usize| at == (at / BLOCK * BLOCK + BLOCK / 2).min(size - 1);
    is_middle(column, width) && is_middle(row, height)
}

/// Returns whether the number of evenly distributed samples has settled.
pub(super) fn has_settled(before: u32, now: u32) -> bool {
    let change = f64::from(now) / f64::from(before);
    (SETTLED.recip()..=SETTLED).contains(&change)
}

/// Returns the number of evenly distributed samples per pixel, up to `spp`, that has the error of pixels with these
/// first rounds when they reach the target.
pub(super) fn even_count(first_rounds: &[PixelStatistics], target: Adaptive, spp: u32) -> u32 {
    let mut forecast = PassForecast::default();
    let mut noise_model = NoiseModel::default();
    first_rounds.iter().for_each(|estimate| noise_model.add(estimate));
    let noise = noise_model.noise();
    for estimate in first_rounds {
        let look = DisplayError::of(estimate, noise, target.gain);
        if look.error.is_finite() {
            let square = look.error * look.error;
            let next = reached(&look, square / (target.error * target.error), spp);
            forecast.add(square, look.noise, estimate.count, next);
        }
    }
    forecast.even_count(spp).clamp(ROUND, spp)
}

/// Returns the number of samples of a pixel, by doubling, that reduces a squared error of `square` times the target's
/// to the target.
fn reached(look: &DisplayError, square: f64, spp: u32) -> u32 {
    let mut count = look.count;
    let (mut noise, mut edges) = (look.noise * square, (1.0 - look.noise) * square);
    while noise + edges > 1.0 && count < spp {
        count = count.saturating_mul(2).min(spp);
        noise *= 0.5;
        // Factor 2^-1.5.
        edges *= 0.353_553_390_593_273_8;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::super::film::estimate;
    use super::*;

    const TARGET: Adaptive = Adaptive {
        error: 0.01,
        gain: 1.0,
    };

    #[test]
    fn pilot_samples_one_pixel_per_block() {
        for size @ [width, height] in [[24, 20], [1, 1], [8, 3], [13, 17]] {
            let pilot_pixels = |block: usize| {
                (0..width * height).filter(move |index| {
                    let (column, row) = (index % width, index / width);
                    let own = row / BLOCK * width.div_ceil(BLOCK) + column / BLOCK;
                    is_pilot_pixel([column, row], size) && own == block
                })
            };
            for block in 0..width.div_ceil(BLOCK) * height.div_ceil(BLOCK) {
                assert_eq!(
                    pilot_pixels(block).count(),
                    1,
                    "{width} x {height}, block {block}"
                );
            }
        }
    }

    /// Returns sixteen samples, half of them black and half of luminance 1, and a target such that their error is
    /// `error` times the target.
    fn half(error: f64) -> (PixelStatistics, Adaptive) {
        let half: Vec<f64> = (0..16).map(|sample| f64::from(sample % 2)).collect();
        let estimate = estimate(&half);
        let target = Adaptive {
            error: DisplayError::of(&estimate, 0.0, 1.0).error / error,
            gain: 1.0,
        };
        (estimate, target)
    }

    #[test]
    fn rounds_double_until_the_target_is_reached() {
        // An error eight times smaller needs 16 times as many samples, by σ / n^¾.
        for (error, count) in [(0.5, 16), (1.5, 32), (7.9, 256), (8.1, 512)] {
            assert_eq!(
                reached(&DisplayError::of(&half(1.0).0, 0.0, 1.0), error * error, 4096),
                count,
                "{error}"
            );
            let (half, target) = half(error);
            assert_eq!(even_count(&[half; 5], target, 4096), count, "{error}");
        }
        assert_eq!(reached(&DisplayError::of(&half(1.0).0, 0.0, 1.0), 1e18, 100), 100);
    }

    #[test]
    fn uniform_pixels_are_weighted_by_error() {
        let (half, target) = half(7.9);
        let gray = estimate(&[0.5; 16]);
        // Pixels without error are certain after any number of samples.
        assert_eq!(even_count(&[half, gray, gray, gray], target, 4096), 256);
        // A pixel that reaches the target in the first round keeps its error, 1/7.9 of the other's: of (7.9² + 1) /
        // n^1.5 remains 7.9² / 16^1.5 + 1, so n is 16 · (63.41 / 1.975)^(2/3) = 161.6: 162.
        let mut calm = [0.0; 16];
        calm.iter_mut()
            .enumerate()
            .for_each(|(i, value)| *value = 0.5 + (i % 2) as f64 * 1e-9);
        assert_eq!(even_count(&[estimate(&calm)], TARGET, 4096), 16);
        let mut forecast = PassForecast::default();
        forecast.add(62.41, 0.0, 16, 256);
        forecast.add(1.0, 0.0, 16, 16);
        assert_eq!(forecast.even_count(4096), 162);
        assert_eq!(forecast.even_count(100), 100);
    }

    #[test]
    fn image_without_error_gets_first_round_samples() {
        assert_eq!(even_count(&[], TARGET, 4096), 16);
        assert_eq!(even_count(&[estimate(&[0.5; 16]); 3], TARGET, 4096), 16);
        assert_eq!(even_count(&[estimate(&[f64::NAN; 16])], TARGET, 4096), 16);
    }

    #[test]
    fn value_has_converged_if_it_hardly_changes() {
        assert!(has_settled(100, 119) && has_settled(100, 84));
        assert!(!has_settled(100, 121) && !has_settled(100, 83));
    }
}
