//! A pilot for adaptive sampling: to how many even samples a pixel its samples will come up.
//!
//! Textures are blurred over what a sample stands for, so rays must be as wide as for the number of samples before the
//! first is taken. Narrower rays leave gaps between samples, wider ones blur beyond the pixel, and rounds that each have
//! a width of their own do both. Adaptive sampling is to give what so many even samples give, for less; so its rays are
//! as wide as theirs. One pixel of every block of 8 x 8 has its first round before all others. By its error it tells in
//! which round the target will be reached, and all of them together how many even samples have the same error; how much
//! of it is noise they tell together as well. Rays as wide as for those may see more detail, so these pixels have their
//! first round again until the number settles.

use super::super::estimate::Estimate;
use super::forecast::Forecast;
use super::look::{Kinds, Look};
use super::{Adaptive, ROUND};

/// Pixels of a block each way.
const BLOCK: usize = 8;

/// A number of even samples has settled if it changes by less than this factor: rays then are as wide to a tenth.
const SETTLED: f64 = 1.2;

/// Rounds until it is taken as it is: each is a quarter of a sample for every pixel of the picture.
pub(super) const MAX_ROUNDS: usize = 4;

/// Whether a pixel is asked: the middle one of its block, or the last there is.
pub(super) fn is_asked([column, row]: [usize; 2], [width, height]: [usize; 2]) -> bool {
    let is_middle = |at: usize, size: usize| at == (at / BLOCK * BLOCK + BLOCK / 2).min(size - 1);
    is_middle(column, width) && is_middle(row, height)
}

/// Whether the number of even samples is known well enough.
pub(super) fn has_settled(before: u32, now: u32) -> bool {
    let change = f64::from(now) / f64::from(before);
    (SETTLED.recip()..=SETTLED).contains(&change)
}

/// How many even samples, up to `spp`, have the error that pixels with these first rounds will have at the target.
pub(super) fn even_count(first_rounds: &[Estimate], target: Adaptive, spp: u32) -> u32 {
    let mut forecast = Forecast::default();
    let mut kinds = Kinds::default();
    first_rounds.iter().for_each(|estimate| kinds.add(estimate));
    let noise = kinds.noise();
    for estimate in first_rounds {
        let look = Look::of(estimate, noise, target.gain);
        if look.error.is_finite() {
            let square = look.error * look.error;
            let next = reached(&look, square / (target.error * target.error), spp);
            forecast.add(square, look.noise, estimate.count, next);
        }
    }
    forecast.even_count(spp).clamp(ROUND, spp)
}

/// The samples of a pixel, doubled until a squared error that is now so many times the target's is reached.
fn reached(look: &Look, square: f64, spp: u32) -> u32 {
    let mut count = look.count;
    let (mut noise, mut edges) = (look.noise * square, (1.0 - look.noise) * square);
    while noise + edges > 1.0 && count < spp {
        count = count.saturating_mul(2).min(spp);
        noise *= 0.5;
        // 2^-1.5.
        edges *= 0.353_553_390_593_273_8;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::super::super::estimate::estimate;
    use super::*;

    const TARGET: Adaptive = Adaptive {
        error: 0.01,
        gain: 1.0,
    };

    #[test]
    fn one_pixel_of_every_block_is_asked_also_where_blocks_are_cut() {
        for size @ [width, height] in [[24, 20], [1, 1], [8, 3], [13, 17]] {
            let asked = |block: usize| {
                (0..width * height).filter(move |index| {
                    let (column, row) = (index % width, index / width);
                    let own = row / BLOCK * width.div_ceil(BLOCK) + column / BLOCK;
                    is_asked([column, row], size) && own == block
                })
            };
            for block in 0..width.div_ceil(BLOCK) * height.div_ceil(BLOCK) {
                assert_eq!(asked(block).count(), 1, "{width} x {height}, block {block}");
            }
        }
    }

    /// Sixteen samples, half of them black and half of luminance 1, whose error is `error` times the target.
    fn half(error: f64) -> (Estimate, Adaptive) {
        let half: Vec<f64> = (0..16).map(|sample| f64::from(sample % 2)).collect();
        let estimate = estimate(&half);
        let target = Adaptive {
            error: Look::of(&estimate, 0.0, 1.0).error / error,
            gain: 1.0,
        };
        (estimate, target)
    }

    #[test]
    fn rounds_double_until_the_target_is_reached() {
        // Eight times less takes 16 times as many, by σ / n^¾.
        for (error, count) in [(0.5, 16), (1.5, 32), (7.9, 256), (8.1, 512)] {
            assert_eq!(
                reached(&Look::of(&half(1.0).0, 0.0, 1.0), error * error, 4096),
                count,
                "{error}"
            );
            let (half, target) = half(error);
            assert_eq!(even_count(&[half; 5], target, 4096), count, "{error}");
        }
        assert_eq!(reached(&Look::of(&half(1.0).0, 0.0, 1.0), 1e18, 100), 100);
    }

    #[test]
    fn even_pixels_count_by_their_errors_not_by_their_number() {
        let (half, target) = half(7.9);
        let gray = estimate(&[0.5; 16]);
        // Those without an error are certain after any number of samples.
        assert_eq!(even_count(&[half, gray, gray, gray], target, 4096), 256);
        // One that has the target after the first round keeps its error, 1/7.9 of the other's: of (7.9² + 1) / n^1.5 is
        // left 7.9² / 16^1.5 + 1, so n is 16 · (63.41 / 1.975)^(2/3) = 161.6: 162.
        let mut calm = [0.0; 16];
        calm.iter_mut()
            .enumerate()
            .for_each(|(i, value)| *value = 0.5 + (i % 2) as f64 * 1e-9);
        assert_eq!(even_count(&[estimate(&calm)], TARGET, 4096), 16);
        let mut forecast = Forecast::default();
        forecast.add(62.41, 0.0, 16, 256);
        forecast.add(1.0, 0.0, 16, 16);
        assert_eq!(forecast.even_count(4096), 162);
        assert_eq!(forecast.even_count(100), 100);
    }

    #[test]
    fn a_picture_without_errors_gets_rays_as_for_its_first_round() {
        assert_eq!(even_count(&[], TARGET, 4096), 16);
        assert_eq!(even_count(&[estimate(&[0.5; 16]); 3], TARGET, 4096), 16);
        assert_eq!(even_count(&[estimate(&[f64::NAN; 16])], TARGET, 4096), 16);
    }

    #[test]
    fn a_number_has_settled_when_it_hardly_changes() {
        assert!(has_settled(100, 119) && has_settled(100, 84));
        assert!(!has_settled(100, 121) && !has_settled(100, 83));
    }
}
