//! Front-to-back compositing: C += (1 - A) alpha c, A += (1 - A) alpha, and opacity correction for the step length.
//!
//! The operator is Porter and Duff's "over" ("Compositing digital images", SIGGRAPH 1984), applied from the viewer on.
//! An opacity holds for the step it was measured over; over another step it is 1 - (1 - alpha)^ratio (Bruckner, thesis,
//! 2004, eq. 3.13), here through logarithms that do not cancel: the plain power loses all of an opacity of 10^-7 in
//! f32.

use super::optical_depth::{opacity, optical_depth};

/// Returns the opacity over `ratio` reference steps of a medium with opacity `alpha` in [0, 1] over one. Within 4 ulp.
#[inline(always)]
pub fn corrected_opacity(alpha: f64, ratio: f64) -> f64 {
    opacity(ratio * optical_depth(alpha))
}

/// Radiance and transmittance accumulated along a ray, from the viewer on.
///
/// Each sum carries its rounding error (D. Knuth, The Art of Computer Programming 2, 4.2.2, theorem B): the errors of a
/// million equal steps may all have one sign.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composite {
    /// Linear RGB radiance that reaches the viewer, and the transmittance.
    sums: [f64; 4],
    /// Rounding errors of the sums, to be added to them.
    compensation: [f64; 4],
}

/// Index of the transmittance in the sums.
const BEHIND: usize = 3;

impl Composite {
    /// Composite of an empty segment: no radiance, transmittance 1.
    pub(crate) const CLEAR: Composite = Composite {
        sums: [0.0, 0.0, 0.0, 1.0],
        compensation: [0.0; 4],
    };

    /// Returns the linear RGB radiance that reaches the viewer.
    pub fn color(&self) -> [f64; 3] {
        [0, 1, 2].map(|channel| self.sums[channel] + self.compensation[channel])
    }

    /// Returns the transmittance to the background, in [0, 1].
    #[inline(always)]
    pub fn transmittance(&self) -> f64 {
        self.sums[BEHIND] + self.compensation[BEHIND]
    }

    /// Composites a layer of colour `color` and opacity `alpha` behind all layers before it.
    #[inline(always)]
    pub fn push(&mut self, color: [f64; 3], alpha: f64) {
        self.add(color.map(|c| alpha * c), alpha);
    }

    /// Composites a layer whose radiance is premultiplied by its opacity, as that of flames, which have none.
    #[inline(always)]
    pub fn add(&mut self, radiance: [f64; 3], alpha: f64) {
        // Attenuate by the layers in front
        let transmittance = self.transmittance();
        let [red, green, blue] = radiance;
        let added = [red, green, blue, -alpha].map(|source| transmittance * source);
        // Add with the rounding error of each sum (two-sum)
        for i in 0..added.len() {
            let (was, added) = (self.sums[i], added[i]);
            let sum = was + added;
            let rounded = sum - was;
            self.compensation[i] += (was - (sum - rounded)) + (added - rounded);
            self.sums[i] = sum;
        }
    }

    /// Returns the accumulated radiance in front of the opaque `background`.
    #[inline(always)]
    pub fn over(&self, background: [f64; 3]) -> [f64; 3] {
        let (color, transmittance) = (self.color(), self.transmittance());
        [0, 1, 2].map(|channel| color[channel] + transmittance * background[channel])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Composites `layers` from front to back over `background`.
    fn layers(layers: &[([f64; 3], f64)], background: [f64; 3]) -> [f64; 3] {
        let mut composite = Composite::CLEAR;
        for &(color, alpha) in layers {
            composite.push(color, alpha);
        }
        composite.over(background)
    }

    const GREEN: [f64; 3] = [0.0, 1.0, 0.0];

    #[test]
    fn compositing_example_is_reproduced_exactly() {
        // A = 0.2 + 0.8 · 0.1 = 0.28: 0.28 (1, 0.5, 0.5) + 0.72 (0, 1, 0).
        let pink = [1.0, 0.5, 0.5];
        assert_eq!(layers(&[(pink, 0.2), (pink, 0.1)], GREEN), [0.28, 0.86, 0.14]);
    }

    #[test]
    fn order_matters_for_different_colours() {
        let (red, blue) = (([1.0, 0.0, 0.0], 0.2), ([0.0, 0.0, 1.0], 0.1));
        // 0.2, 0.8 · 0.9 and 0.8 · 0.1; swapped 0.9 · 0.2 and 0.1. In f64 0.8 · 0.1 is not 0.08.
        let single = |colors: [f64; 3]| colors.map(|c| c as f32);
        assert_eq!(single(layers(&[red, blue], GREEN)), [0.2, 0.72, 0.08]);
        assert_eq!(single(layers(&[blue, red], GREEN)), [0.18, 0.72, 0.1]);
    }

    #[test]
    fn opaque_layer_hides_everything_behind_it() {
        let mut composite = Composite::CLEAR;
        composite.push([0.25, 0.5, 0.75], 1.0);
        composite.push([9.0; 3], 0.5);
        assert_eq!(composite.over([7.0; 3]), [0.25, 0.5, 0.75]);
    }

    /// Reference values of 1 - (1 - alpha)^ratio, computed with 80 digits for the f64 alpha and the f64 ratios 10^-6,
    /// 10^-5, ... 10^6.
    #[rustfmt::skip]
    const CORRECTED: [(f64, [f64; 13]); 6] = [
        (1e-09, [1.0000000004999994e-15, 1.0000000004999952e-14, 1.0000000004999502e-13, 1.0000000004995001e-12,
            1.000000000495e-11, 1.0000000004500001e-10, 1e-09, 9.999999955e-09, 9.999999505000017e-08,
            9.999995005001662e-07, 9.999950005166617e-06, 9.999500021665751e-05, 0.0009995001671245086]),
        (1e-05, [1.0000050000283336e-11, 1.0000049999833333e-10, 1.0000049995333287e-09, 1.0000049950332836e-08,
            1.0000049500328354e-07, 1.0000045000285003e-06, 1e-05, 9.999550011999791e-05, 0.0009995051616607954,
            0.009950215753652417, 0.09516303438565249, 0.6321223982334278, 0.9999546023401924]),
        (0.1, [1.0536051010740737e-07, 1.0536046015365452e-06, 1.0535996061786264e-05, 0.000105354965433623,
            0.0010530503095456183, 0.010480741793785608, 0.1, 0.6513215599000001, 0.9999734386011124,
            1.0, 1.0, 1.0, 1.0]),
        (0.5, [6.931469403334938e-07, 6.931447783004262e-06, 6.931231584642809e-05, 0.0006929070095474781,
            0.006907504562964099, 0.06696700846319259, 0.5, 0.9990234375, 1.0, 1.0, 1.0, 1.0, 1.0]),
        (0.999, [6.907731420495575e-06, 6.907516699060702e-05, 0.0006905369974100783, 0.006883951579066227,
            0.06674569920300895, 0.4988127663727277, 0.999, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
        // 1 - 2^-24
        (0.9999999403953552, [1.6635393963737964e-05, 0.00016634148705484293, 0.0016621702956335822,
            0.01649792597375167, 0.15325468763747285, 0.8105354291862003, 0.9999999403953552,
            1.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
    ];

    #[test]
    fn opacity_correction_is_within_4_ulp_over_twelve_decades() {
        let mut worst = 0.0f64;
        for (alpha, row) in CORRECTED {
            for (i, expected) in row.into_iter().enumerate() {
                // Parse literals: powf need not round as the parser does.
                let ratio: f64 = format!("1e{}", i as i32 - 6).parse().unwrap();
                let got = corrected_opacity(alpha, ratio);
                worst = worst.max((got - expected).abs() / (expected.next_up() - expected));
            }
        }
        assert!(worst <= 4.0, "{worst}");
    }

    #[test]
    fn many_short_steps_equal_one_long_step() {
        for (alpha, count) in [(0.3, 7), (1e-9, 1000), (0.999, 64)] {
            let short = corrected_opacity(alpha, 1.0 / f64::from(count));
            let mut composite = Composite::CLEAR;
            for _ in 0..count {
                composite.push([1.0; 3], short);
            }
            // An opacity is off by 4 ulp, products by half an ulp: steps share these, and the rest is rounded once.
            let bound = 6.0 * f64::EPSILON;
            assert!((composite.color()[0] - alpha).abs() <= bound, "{alpha} {count}");
            assert!((composite.transmittance() - (1.0 - alpha)).abs() <= bound);
        }
    }
}
