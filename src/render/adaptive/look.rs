//! A pixel as the display shows it, by which adaptive sampling decides.
//! The display value is a curve close to sRGB's, but made of a square root, which is rounded alike on every machine:
//! decisions must not depend on anybody's `pow`. It goes on above white, so highlights of linear pictures count too.

use super::super::estimate::Estimate;

/// A pixel as the display shows it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Look {
    /// Display value of one standard error of the mean.
    pub(super) error: f64,
    /// How much of its square is noise, which falls with the number of samples n as 1 / n; the rest is that of edges,
    /// which falls as 1 / n^1.5.
    pub(super) noise: f64,
    /// Display values of the darkest and the brightest sample.
    pub(super) extremes: [f64; 2],
    /// If the darkest, or the brightest, differs from all other samples: the step in display value if one sample in n +
    /// 1 does so. Else 0.
    pub(super) single_steps: [f64; 2],
    /// Of samples.
    pub(super) count: u32,
}

impl Look {
    /// Of a pixel whose radiance is multiplied by `gain`, and whose variance is noise for so great a part.
    pub(super) fn of(estimate: &Estimate, noise: f64, gain: f64) -> Look {
        let count = f64::from(estimate.count);
        let mean = gain * estimate.luminance();
        let of_edges = (1.0 - noise) / count.sqrt();
        let error = gain * (estimate.variance() * (noise + of_edges) / count).sqrt();
        Look {
            error: display_value(mean + error) - display_value(mean),
            noise: noise / (noise + of_edges),
            extremes: estimate.extremes.map(|l| display_value(gain * f64::from(l))),
            single_steps: [0, 1].map(|end| single_step(estimate, end, gain)),
            count: estimate.count,
        }
    }

    /// By how many samples, doubled until then, its error is likely to be at most `target`; at most so many.
    pub(super) fn likely_count(&self, target: f64, most: u32) -> u32 {
        let (mut noise, mut edges) = (self.noise, 1.0 - self.noise);
        let mut count = self.count.min(most);
        while count < most && self.error * self.error * (noise + edges) > target * target {
            count = count.saturating_mul(2).min(most);
            noise /= 2.0;
            edges /= 8f64.sqrt();
        }
        count
    }

    /// How much more a neighbour has seen: the larger step beyond this pixel's own extremes.
    pub(super) fn unseen(&self, neighbour: &Look) -> f64 {
        let brighter = neighbour.extremes[1] - self.extremes[1];
        let darker = self.extremes[0] - neighbour.extremes[0];
        brighter.max(darker)
    }
}

/// Of which kind the variance of some pixels' samples is.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Kinds {
    variance: f64,
    noise: f64,
}

impl Kinds {
    /// Counts a pixel.
    pub(super) fn add(&mut self, estimate: &Estimate) {
        self.variance += estimate.variance();
        self.noise += estimate.noise_variance();
    }

    /// Both together.
    pub(super) fn merged(self, other: &Kinds) -> Kinds {
        Kinds {
            variance: self.variance + other.variance,
            noise: self.noise + other.noise,
        }
    }

    /// How much of the variance is noise, from 0 to 1; the rest is that of edges.
    pub(super) fn noise(&self) -> f64 {
        if self.variance > 0.0 {
            (self.noise / self.variance).clamp(0.0, 1.0)
        } else {
            0.0
        }
    }
}

/// [`Look::single_steps`], at the dark `end` 0 or the bright one 1.
fn single_step(estimate: &Estimate, end: usize, gain: f64) -> f64 {
    let count = f64::from(estimate.count);
    let [own, others] = [end, 1 - end].map(|end| f64::from(estimate.extremes[end]));
    // A single one moves the mean of n by 1/n of the way, two by 2/n. Of samples that are all alike this is no number.
    let is_single = (estimate.luminance() - others) / (own - others) < 1.5 / count;
    if !is_single {
        return 0.0;
    }
    let moved = others + (own - others) / (count + 1.0);
    (display_value(gain * moved) - display_value(gain * others)).abs()
}

/// Nearly the sRGB value of a luminance, from 0 for black to 1 for white and on: within 0.07 of it, and as steep at
/// black.
pub(super) fn display_value(luminance: f64) -> f64 {
    /// Makes the slope at zero 12.92, as in IEC 61966-2-1: (√(1 + r²) + r) / (2 r) = 12.92.
    const ROOT: f64 = 0.0403;
    let shifted = |x: f64| (x + ROOT * ROOT).sqrt();
    (shifted(luminance.clamp(0.0, f64::INFINITY)) - ROOT) * (shifted(1.0) + ROOT)
}

#[cfg(test)]
mod tests {
    use super::super::super::estimate::estimate;
    use super::super::super::sampler::{Purpose, sample_2d};
    use super::*;
    use crate::scene::image_settings::Pattern;

    #[test]
    fn the_display_value_keeps_close_to_srgb_and_ends_where_it_ends() {
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

    /// The noise of 500 pixels that see this at so many evenly spread places, and at random.
    fn noise_at(count: u32, seen: impl Fn([u32; 2], [f64; 2]) -> f64) -> [f64; 2] {
        [Purpose::FILM, Purpose(7)].map(|purpose| {
            let mut kinds = Kinds::default();
            for number in 0..500 {
                let pixel = [number, 3];
                let samples = (0..count).map(|sample| {
                    // Of every pixel one sample is random.
                    let (pixel_of_place, sample) = match purpose {
                        Purpose::FILM => (pixel, sample),
                        _ => ([sample, 1000 + number], 0),
                    };
                    let place = sample_2d(Pattern::Sobol, pixel_of_place, sample, 1024, purpose);
                    seen(pixel, place)
                });
                kinds.add(&estimate(&samples.collect::<Vec<f64>>()));
            }
            kinds.noise()
        })
    }

    #[test]
    fn edges_and_noise_are_told_apart_by_evenly_spread_samples() {
        // An edge across each pixel, at an angle and a distance from its middle that are its own.
        let edge = |pixel: [u32; 2], place: [f64; 2]| {
            let (angle, distance) = (f64::from(pixel[0]) * 2.4, f64::from(pixel[0] % 7) / 14.0 - 0.2);
            let (sin, cos) = angle.sin_cos();
            f64::from(u8::from(
                (place[0] - 0.5) * cos + (place[1] - 0.5) * sin > distance,
            ))
        };
        for (count, most) in [(16, 0.3), (32, 0.15), (256, 0.15)] {
            let [even, random] = noise_at(count, edge);
            assert!(even < most, "{count} samples: {even}");
            assert!(random > 0.75, "{count} samples: {random}");
        }
    }

    #[test]
    fn noise_has_a_greater_error_which_is_noise_for_the_most_part() {
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let estimate = estimate(&half);
        // Half of the variance, 4/15, over 16, and half of it over 64: four fifths of the square.
        let look = Look::of(&estimate, 0.5, 1.0);
        let square: f64 = 0.5 * 4.0 / 15.0 * (1.0 / 16.0 + 1.0 / 64.0);
        let expected = display_value(0.5 + square.sqrt()) - display_value(0.5);
        assert!((look.error - expected).abs() < 1e-12, "{}", look.error);
        assert!((look.noise - 0.8).abs() < 1e-15);
    }

    #[test]
    fn the_error_is_that_of_evenly_spread_samples_on_the_display() {
        // Eight samples of 0 and eight of 1: variance 16/15 · 1/4; over 16^1.5 = 64, its root is 0.064550.
        let mut half = vec![0.0; 16];
        half[..8].fill(1.0);
        let look = Look::of(&estimate(&half), 0.0, 1.0);
        let expected = display_value(0.5 + (16.0 / 15.0 / 4.0 / 64.0f64).sqrt()) - display_value(0.5);
        assert!((look.error - expected).abs() < 1e-12, "{}", look.error);
        assert_eq!(look.extremes[0], 0.0);
    }
}
