//! Spectral sampling: wavelengths of visible light, and the weights that convert them to red, green and blue.
//!
//! Colour matching functions: the multi-lobe fit of the CIE 1931 2° observer by Wyman, Sloan and Shirley, "Simple
//! Analytic Approximations to the CIE XYZ Color Matching Functions", JCGT 2(2), 2013, equation 4. Their products with
//! the sRGB matrix have negative lobes, which are kept: only sums over wavelengths are colours.

/// Lower end of the visible spectrum, nanometres.
pub const MIN_WAVELENGTH: f64 = 380.0;
/// Upper end of the visible spectrum, nanometres.
pub const MAX_WAVELENGTH: f64 = 780.0;

/// Matrix from CIE XYZ to linear sRGB, row by row (IEC 61966-2-1).
pub const LINEAR_SRGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.2406, -1.5372, -0.4986],
    [-0.9689, 1.8758, 0.0415],
    [0.0557, -0.2040, 1.0570],
];

/// Number of cells of the spectrum over which sensitivities are taken to be constant: one per nanometre, 1/12 of the
/// narrowest lobe.
const CELLS: usize = 400;
/// Number of steps per unit of weight. Weights are whole multiples of 2^-22: f32 then adds them without rounding, in
/// any order, as long as sums stay below 4.
const WEIGHT_STEPS: f64 = (1 << 22) as f64;

/// Offset of the wavelength that represents its stratum.
const MIDDLE: f64 = 0.5;

/// Returns the CIE 1931 colour matching functions x, y, z at `wavelength`, nanometres; y peaks at about 1.
pub fn color_matching(wavelength: f64) -> [f64; 3] {
    let lobe = |height: f64, center: f64, below: f64, above: f64| {
        let width = if wavelength < center { below } else { above };
        let t = (wavelength - center) / width;
        height * (-0.5 * t * t).exp()
    };
    [
        lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2),
        lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
        lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
    ]
}

/// Converts a colour from CIE XYZ to linear sRGB, unclamped.
pub fn linear_srgb(xyz: [f64; 3]) -> [f64; 3] {
    LINEAR_SRGB_FROM_XYZ.map(|row| row[0] * xyz[0] + row[1] * xyz[1] + row[2] * xyz[2])
}

/// Stratified set of wavelengths that a path follows after it splits by colour, one from each stratum of the spectrum.
///
/// Strata are of equal importance, the sum of the absolute sensitivities of the three channels; so they are narrow
/// where the eye is sensitive. A stratum's weight is the integral of the sensitivities over it: where nothing depends
/// on the wavelength, the weights' sum is exactly white, and the split path returns exactly the RGB radiance of the
/// unsplit one.
#[derive(Clone, Debug, PartialEq)]
pub struct SpectralSampler {
    /// Fraction of all importance below each bound of a cell, ascending from 0 to 1.
    cumulative: Vec<f64>,
    weights: Vec<[f32; 3]>,
    /// Wavelengths that represent the strata, nanometres.
    middles: Vec<f64>,
}

impl SpectralSampler {
    /// Creates a sampler of `count` wavelengths; at least one.
    pub fn new(count: usize) -> SpectralSampler {
        let count = count.max(1);
        // Divide the spectrum into strata of equal importance
        let cells = cell_sensitivities();
        let cumulative = cumulative_importance(&cells);
        let bound = |index: usize| quantile(&cumulative, index as f64 / count as f64);
        let weights = quantise((0..count).map(|index| integral(&cells, bound(index), bound(index + 1))));
        let middle = |index: usize| quantile(&cumulative, (index as f64 + MIDDLE) / count as f64);
        SpectralSampler {
            middles: (0..count).map(middle).collect(),
            cumulative,
            weights,
        }
    }

    /// Returns the RGB weight of each wavelength, in ascending order; some are negative, their sum is exactly (1, 1,
    /// 1).
    pub fn weights(&self) -> &[[f32; 3]] {
        &self.weights
    }

    /// Returns the wavelength in stratum `index` below which the fraction `offset` of its importance lies, nanometres.
    ///
    /// `offset` is within [0, 1]: 0.5 for the wavelength that represents the stratum, a random number for jitter. An
    /// `index` beyond the last stratum is clamped to the last.
    pub fn wavelength(&self, index: usize, offset: f64) -> f64 {
        let count = self.weights.len();
        let index = index.min(count - 1);
        if offset == MIDDLE {
            return self.middles[index];
        }
        quantile(&self.cumulative, (index as f64 + offset) / count as f64)
    }

    /// Returns the index of the stratum that holds `wavelength`, nanometres; the first or last beyond the spectrum.
    pub fn stratum(&self, wavelength: f64) -> usize {
        let cells = ((wavelength - MIN_WAVELENGTH) / CELL).clamp(0.0, CELLS as f64);
        let cell = (cells as usize).min(CELLS - 1);
        let [low, high] = [cell, cell + 1].map(|bound| self.cumulative[bound]);
        let share = low + (high - low) * (cells - cell as f64);
        let count = self.weights.len();
        ((share * count as f64) as usize).min(count - 1)
    }
}

const CELL: f64 = (MAX_WAVELENGTH - MIN_WAVELENGTH) / CELLS as f64;

/// Returns the contribution of each cell of a flat spectrum to linear RGB, normalised so that the whole spectrum is (1,
/// 1, 1).
fn cell_sensitivities() -> Vec<[f64; 3]> {
    let mut cells: Vec<[f64; 3]> = (0..CELLS)
        .map(|cell| linear_srgb(color_matching(MIN_WAVELENGTH + (cell as f64 + 0.5) * CELL)))
        .collect();
    // Normalise each channel
    for channel in 0..3 {
        let sum: f64 = cells.iter().map(|cell| cell[channel]).sum();
        cells.iter_mut().for_each(|cell| cell[channel] /= sum);
    }
    cells
}

/// Returns the fraction of the importance of all cells that lies below each of their bounds.
fn cumulative_importance(cells: &[[f64; 3]]) -> Vec<f64> {
    let sums = cells.iter().scan(0.0, |sum, cell| {
        *sum += cell.iter().map(|c| c.abs()).sum::<f64>();
        Some(*sum)
    });
    let mut cumulative: Vec<f64> = std::iter::once(0.0).chain(sums).collect();
    let total = cumulative[CELLS];
    cumulative.iter_mut().for_each(|sum| *sum /= total);
    cumulative
}

/// Returns the wavelength below which the fraction `share` of the importance lies, nanometres.
fn quantile(cumulative: &[f64], share: f64) -> f64 {
    let cell = cumulative
        .partition_point(|below| *below <= share)
        .clamp(1, CELLS)
        - 1;
    let (low, high) = (cumulative[cell], cumulative[cell + 1]);
    let within = ((share - low) / (high - low)).clamp(0.0, 1.0);
    MIN_WAVELENGTH + (cell as f64 + within) * CELL
}

/// Returns the sensitivities summed from `low` to `high`, nanometres.
fn integral(cells: &[[f64; 3]], low: f64, high: f64) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for (index, cell) in cells.iter().enumerate() {
        let start = MIN_WAVELENGTH + index as f64 * CELL;
        // Weight the cell by its overlap with the interval
        let share = (high.min(start + CELL) - low.max(start)).max(0.0) / CELL;
        for channel in 0..3 {
            sum[channel] += share * cell[channel];
        }
    }
    sum
}

/// Rounds the weights so that f32 adds them exactly; the error of the running sum is carried forward so that it ends at
/// 1.
fn quantise(weights: impl ExactSizeIterator<Item = [f64; 3]>) -> Vec<[f32; 3]> {
    let last = weights.len() - 1;
    let (mut exact, mut given) = ([0.0; 3], [0.0; 3]);
    weights
        .enumerate()
        .map(|(index, weight)| {
            std::array::from_fn(|channel| {
                exact[channel] += weight[channel];
                let goal = if index == last { 1.0 } else { exact[channel] };
                let rounded = ((goal - given[channel]) * WEIGHT_STEPS).round() / WEIGHT_STEPS;
                given[channel] += rounded;
                rounded as f32
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fit_stays_close_to_the_tabulated_observer() {
        // CIE 1931 2° table; the paper gives its fit's largest error as about 0.02 of the peak of z.
        for (wavelength, table) in [
            (450.0, [0.33620, 0.03800, 1.77211]),
            (500.0, [0.00490, 0.32300, 0.27200]),
            (555.0, [0.51205, 1.00000, 0.00575]),
            (600.0, [1.06220, 0.63100, 0.00080]),
            (650.0, [0.28350, 0.10700, 0.00000]),
        ] {
            let found = color_matching(wavelength);
            for channel in 0..3 {
                assert!(
                    (found[channel] - table[channel]).abs() < 0.036,
                    "{wavelength} {found:?}"
                );
            }
        }
    }

    #[test]
    fn every_wavelength_of_a_stratum_is_found_in_it() {
        for count in [1, 3, 16, 36] {
            let sampler = SpectralSampler::new(count);
            for index in 0..count {
                for offset in [0.001, 0.25, 0.5, 0.999] {
                    assert_eq!(sampler.stratum(sampler.wavelength(index, offset)), index);
                }
            }
            assert_eq!(sampler.stratum(100.0), 0);
            assert_eq!(sampler.stratum(1000.0), count - 1);
        }
    }

    #[test]
    fn daylight_white_is_white_in_srgb() {
        // D65; the matrix is printed to four digits.
        for channel in linear_srgb([0.9505, 1.0, 1.089]) {
            assert!((channel - 1.0).abs() < 5e-4);
        }
    }

    #[test]
    fn a_flat_spectrum_adds_up_to_exactly_white_in_any_order() {
        for count in [1, 2, 3, 4, 7, 8, 16, 33, 64, 100] {
            let sampler = SpectralSampler::new(count);
            assert_eq!(sampler.weights().len(), count);
            let add = |sum: [f32; 3], w: &[f32; 3]| [sum[0] + w[0], sum[1] + w[1], sum[2] + w[2]];
            assert_eq!(sampler.weights().iter().fold([0.0; 3], add), [1.0; 3], "{count}");
            assert_eq!(
                sampler.weights().iter().rev().fold([0.0; 3], add),
                [1.0; 3],
                "{count}"
            );
        }
    }

    #[test]
    fn one_wavelength_carries_the_whole_radiance() {
        let sampler = SpectralSampler::new(1);
        assert_eq!(sampler.weights(), [[1.0; 3]]);
        assert_eq!(sampler.wavelength(0, 0.0), MIN_WAVELENGTH);
        assert_eq!(sampler.wavelength(0, 1.0), MAX_WAVELENGTH);
    }

    #[test]
    fn stored_wavelengths_have_the_bits_of_those_between() {
        for count in [1, 3, 16, 36] {
            let sampler = SpectralSampler::new(count);
            for index in 0..count {
                let share = (index as f64 + MIDDLE) / count as f64;
                assert_eq!(
                    sampler.wavelength(index, MIDDLE),
                    quantile(&sampler.cumulative, share)
                );
            }
        }
    }

    #[test]
    fn strata_follow_each_other_and_fill_the_spectrum() {
        for count in [2, 5, 32, 1000] {
            let sampler = SpectralSampler::new(count);
            for index in 1..count {
                assert_eq!(sampler.wavelength(index - 1, 1.0), sampler.wavelength(index, 0.0));
                assert!(
                    sampler.wavelength(index, 0.0) < sampler.wavelength(index, 1.0),
                    "{index} of {count}"
                );
            }
            assert_eq!(sampler.wavelength(0, 0.0), MIN_WAVELENGTH);
            assert_eq!(sampler.wavelength(count - 1, 1.0), MAX_WAVELENGTH);
        }
    }

    #[test]
    fn negative_lobes_are_kept() {
        // Around 500 nm no mixture of sRGB's primaries is as green: red must be negative.
        let sampler = SpectralSampler::new(32);
        let red: Vec<f32> = (0..32)
            .filter(|i| (480.0..520.0).contains(&sampler.wavelength(*i, 0.5)))
            .map(|i| sampler.weights()[i][0])
            .collect();
        assert!(
            !red.is_empty() && red.iter().all(|weight| *weight < 0.0),
            "{red:?}"
        );
    }

    #[test]
    fn long_waves_are_red_and_short_ones_blue() {
        let sampler = SpectralSampler::new(16);
        for (index, weight) in sampler.weights().iter().enumerate() {
            let wavelength = sampler.wavelength(index, 0.5);
            let largest = if wavelength > 620.0 {
                0
            } else if wavelength < 470.0 {
                2
            } else {
                continue;
            };
            assert!(
                weight.iter().all(|w| *w <= weight[largest]),
                "{wavelength} {weight:?}"
            );
        }
    }

    #[test]
    fn more_wavelengths_come_closer_to_the_integral_of_a_sloping_spectrum() {
        let slope = |wavelength: f64| (wavelength - MIN_WAVELENGTH) / (MAX_WAVELENGTH - MIN_WAVELENGTH);
        let green = |count: usize| -> f64 {
            let sampler = SpectralSampler::new(count);
            (0..count)
                .map(|i| f64::from(sampler.weights()[i][1]) * slope(sampler.wavelength(i, 0.5)))
                .sum()
        };
        let reference = green(2000);
        assert!((green(8) - reference).abs() > (green(32) - reference).abs());
        assert!((green(32) - reference).abs() < 1e-3);
    }
}
