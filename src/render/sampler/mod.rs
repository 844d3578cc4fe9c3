//! Sample positions within pixels, random numbers of samples, and the grouping of samples into packets.
//!
//! Samples are addressed by (pixel, sample, purpose) instead of being drawn from a stateful generator, so an image
//! does not depend on the thread or the order in which tiles are rendered.

mod packet;
mod sobol;

use multiversion::multiversion;

use crate::numeric::{LANES, Lanes};
use crate::scene::image_settings::Pattern;

pub(super) use packet::{PacketShape, SampleGroup};

/// Use of a sample's pair of random numbers. Pairs of different purposes are independent of each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Purpose(pub u32);

impl Purpose {
    /// Position within the pixel.
    pub const FILM: Purpose = Purpose(0);
    /// Point on the lens.
    pub(crate) const LENS: Purpose = Purpose(1);
    /// Time within the shutter interval: the first number of the pair.
    pub(crate) const TIME: Purpose = Purpose(2);
    /// Point on a light, or direction towards the environment map.
    pub const LIGHT: Purpose = Purpose(3);
    /// Direction within the lobe of a rough surface.
    pub const LOBE: Purpose = Purpose(4);
    /// Direction of a ray from a diffuse surface.
    pub(crate) const BOUNCE: Purpose = Purpose(5);
    /// Decision whether a path goes on behind a diffuse surface: the first number of the pair.
    pub(crate) const ROULETTE: Purpose = Purpose(6);
    /// Choice of one of many lights: the first number of the pair.
    pub(crate) const LIGHT_CHOICE: Purpose = Purpose(7);
    /// Direction of a photon.
    pub(crate) const PHOTON: Purpose = Purpose(8);

    /// Returns the purpose for item `number`, for example one of several lights or one of the surfaces along a path.
    ///
    /// Nesting works to any depth and depends on the order. Purposes are hashed to 32 bits: among n purposes in use,
    /// two coincide with a probability of about n²/2^33. Their numbers are then correlated, but estimates stay
    /// unbiased.
    pub const fn nested(self, number: u32) -> Purpose {
        Purpose(sobol::mixed(self.0 ^ sobol::mixed(number ^ NESTED)))
    }

    /// Returns the purpose for an image with another `seed`: itself for 0.
    pub const fn seeded(self, seed: u32) -> Purpose {
        Purpose(self.0 ^ sobol::mixed(seed) ^ sobol::mixed(0))
    }
}

/// Constant that separates nested purposes from plain ones.
const NESTED: u32 = 0x85a3_08d3;

/// Returns the two numbers in [0, 1) of sample `sample` of `pixel` (column and row) for `purpose`, with `spp` samples
/// per pixel.
///
/// For [`Purpose::FILM`] they are the position within the pixel, from its top left corner, according to `pattern`;
/// with one sample per pixel it is the centre for every pattern. Grids have `spp` cells, in the numbers of rows and
/// columns that are closest to a square, so a prime number of samples lies in one row. Samples beyond `spp` start
/// another layer of cells. For every other purpose, all patterns give Owen-scrambled Sobol points in an order
/// specific to the purpose (Burley 2020, section 4): a grid in step with the one on the film would show as bands.
pub fn sample_2d(pattern: Pattern, pixel: [u32; 2], sample: u32, spp: u32, purpose: Purpose) -> [f64; 2] {
    let seed = sobol::seed(pixel, purpose.0);
    // All patterns use Sobol points for lenses, times, lights and lobes
    if purpose != Purpose::FILM {
        return sobol::point(sobol::shuffled(sample, seed), seed);
    }
    let layout = SampleLayout::new(pattern, spp);
    match layout.pattern {
        Pattern::Regular | Pattern::R2 => layout.shared_position(sample),
        Pattern::Jittered => layout.jittered(layout.cell(sample), sample, seed),
        Pattern::Sobol => sobol::point(sample, seed),
    }
}

/// Returns the pairs of sixteen samples, each of its own pixel, for a purpose other than [`Purpose::FILM`]: see
/// [`sample_2d`]. Compiled for several instruction sets, all of which give the same bits.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
pub(super) fn number_packet(
    pixels: &[Lanes<u32>; 2],
    samples: &Lanes<u32>,
    purpose: Purpose,
) -> [Lanes<f64>; 2] {
    debug_assert_ne!(purpose, Purpose::FILM);
    let mut numbers = [[0.0; LANES]; 2];
    for l in 0..LANES {
        let seed = sobol::seed([pixels[0][l], pixels[1][l]], purpose.0);
        [numbers[0][l], numbers[1][l]] = sobol::point(sobol::shuffled(samples[l], seed), seed);
    }
    numbers
}

/// Pattern for a number of samples, with the data that all pixels share.
#[derive(Clone, Copy, Debug)]
pub(super) struct SampleLayout {
    pattern: Pattern,
    columns: u32,
    rows: u32,
}

impl SampleLayout {
    /// Returns the layout of `pattern` for `spp` samples per pixel, at least 1.
    pub(super) fn new(pattern: Pattern, spp: u32) -> SampleLayout {
        // Find the divisor of `spp` that is closest to its root from below
        let rows = (1..=spp.isqrt())
            .rev()
            .find(|&rows| spp.is_multiple_of(rows))
            .unwrap_or(1);
        SampleLayout {
            // Centre of the only cell, where every pattern has a single sample.
            pattern: if spp == 1 { Pattern::Regular } else { pattern },
            columns: spp / rows,
            rows,
        }
    }

    /// Returns whether positions differ between pixels, so that [`SampleGroup::position`] holds grid cells instead.
    pub(super) fn is_per_pixel(&self) -> bool {
        matches!(self.pattern, Pattern::Jittered | Pattern::Sobol)
    }

    /// Returns the column and row of the grid cell that a sample belongs to.
    fn cell(&self, sample: u32) -> [f64; 2] {
        let cell = sample % (self.columns * self.rows);
        [cell % self.columns, cell / self.columns].map(f64::from)
    }

    /// Returns the position of a sample in every pixel, for patterns that are equal in all pixels.
    fn shared_position(&self, sample: u32) -> [f64; 2] {
        match self.pattern {
            Pattern::R2 => r2(sample),
            _ => {
                let [column, row] = self.cell(sample);
                [
                    (column + 0.5) / f64::from(self.columns),
                    (row + 0.5) / f64::from(self.rows),
                ]
            }
        }
    }

    /// Returns the shared data of a sample: its position or, if pixels differ, its grid cell.
    pub(super) fn shared(&self, sample: u32) -> [f64; 2] {
        if self.is_per_pixel() {
            self.cell(sample)
        } else {
            self.shared_position(sample)
        }
    }

    /// Returns a random position within `cell`.
    #[inline(always)]
    fn jittered(&self, cell: [f64; 2], sample: u32, seed: u32) -> [f64; 2] {
        let across = sobol::mixed(seed ^ sobol::mixed(sample));
        let down = sobol::mixed(across);
        [
            (cell[0] + sobol::fraction(across)) / f64::from(self.columns),
            (cell[1] + sobol::fraction(down)) / f64::from(self.rows),
        ]
    }

    /// Returns the positions of sixteen samples in pixels of columns `x` and rows `y` of the image with that `seed`,
    /// for a pattern that differs between pixels.
    #[inline(always)]
    pub(super) fn lane_positions(
        &self,
        x: &Lanes<u32>,
        y: &Lanes<u32>,
        group: &SampleGroup,
        seed: u32,
    ) -> [Lanes<f64>; 2] {
        let mut position = [[0.0; LANES]; 2];
        let purpose = Purpose::FILM.seeded(seed);
        let mut seeds = [0; LANES];
        for l in 0..LANES {
            seeds[l] = sobol::seed([x[l], y[l]], purpose.0);
        }
        // Scramble Sobol points, or jitter within the shared cells
        if self.pattern == Pattern::Sobol {
            for l in 0..LANES {
                [position[0][l], position[1][l]] = sobol::point(group.sample[l], seeds[l]);
            }
        } else {
            for l in 0..LANES {
                let cell = [group.position[0][l], group.position[1][l]];
                [position[0][l], position[1][l]] = self.jittered(cell, group.sample[l], seeds[l]);
            }
        }
        position
    }
}

/// Returns point `sample` of Roberts' R2 sequence, which starts at the centre.
///
/// It is the two-dimensional analogue of the golden ratio (M. Roberts, "The unreasonable effectiveness of quasirandom
/// sequences", 2018). Any prefix of the sequence is evenly distributed.
#[inline(always)]
fn r2(sample: u32) -> [f64; 2] {
    const STEP: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
    STEP.map(|step| (0.5 + f64::from(sample) * step).fract())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    const PATTERNS: &[Pattern] = &[Pattern::Regular, Pattern::Jittered, Pattern::Sobol, Pattern::R2];

    fn film(pattern: Pattern, pixel: [u32; 2], sample: u32, spp: u32) -> [f64; 2] {
        sample_2d(pattern, pixel, sample, spp, Purpose::FILM)
    }

    #[test]
    fn single_sample_is_at_the_pixel_centre() {
        for pattern in PATTERNS {
            for pixel in [[0, 0], [3, 1000]] {
                assert_eq!(film(*pattern, pixel, 0, 1), [0.5, 0.5], "{pattern:?}");
            }
        }
        assert_eq!(film(Pattern::R2, [7, 7], 0, 16), [0.5, 0.5]);
    }

    #[test]
    fn all_samples_are_in_the_unit_square() {
        for pattern in PATTERNS {
            for sample in 0..10_000 {
                let place = film(*pattern, [12, 34], sample, 10_000);
                assert!(
                    place.iter().all(|x| (0.0..1.0).contains(x)),
                    "{pattern:?} {sample}"
                );
            }
        }
    }

    #[test]
    fn sixteen_samples_of_r2_are_nearly_even_over_the_quarters() {
        // A low-discrepancy sequence leaves no quarter of the pixel empty and none with half of the samples.
        let mut quarters = [0; 4];
        for sample in 0..16 {
            let [x, y] = r2(sample);
            quarters[(x * 2.0) as usize + 2 * (y * 2.0) as usize] += 1;
        }
        assert!(
            quarters.iter().all(|&count| (2..8).contains(&count)),
            "{quarters:?}"
        );
    }

    #[test]
    fn grids_have_as_many_cells_as_samples_and_come_near_a_square() {
        for (spp, columns, rows) in [(1, 1, 1), (2, 2, 1), (6, 3, 2), (7, 7, 1), (16, 4, 4), (48, 8, 6)] {
            let layout = SampleLayout::new(Pattern::Regular, spp);
            assert_eq!((layout.columns, layout.rows), (columns, rows), "{spp}");
        }
        // Three by two cells: the first centre is at (1/6, 1/4), the last at (5/6, 3/4).
        assert_eq!(film(Pattern::Regular, [9, 9], 0, 6), [0.5 / 3.0, 0.25]);
        assert_eq!(film(Pattern::Regular, [9, 9], 5, 6), [2.5 / 3.0, 0.75]);
    }

    #[test]
    fn every_cell_holds_one_regular_and_one_jittered_sample_of_every_layer() {
        for pattern in [Pattern::Regular, Pattern::Jittered] {
            for layer in 0..3 {
                let cells: HashSet<_> = (16 * layer..16 * (layer + 1))
                    .map(|sample| film(pattern, [5, 6], sample, 16).map(|x| (4.0 * x) as u32))
                    .collect();
                assert_eq!(cells.len(), 16, "{pattern:?}, layer {layer}");
            }
        }
        assert_ne!(
            film(Pattern::Jittered, [5, 6], 0, 16),
            film(Pattern::Jittered, [5, 6], 16, 16)
        );
    }

    #[test]
    fn only_jittered_and_sobol_samples_differ_from_pixel_to_pixel() {
        for pattern in PATTERNS {
            let same = film(*pattern, [0, 0], 3, 16) == film(*pattern, [1, 0], 3, 16);
            assert_ne!(
                same,
                SampleLayout::new(*pattern, 16).is_per_pixel(),
                "{pattern:?}"
            );
        }
    }

    #[test]
    fn pairs_of_different_purposes_are_not_correlated() {
        // 4096 pairs: the correlation of independent ones is below 4/64 except in one case in ten thousand.
        let count = 4096;
        for pattern in PATTERNS {
            for other in [1, 2, 100] {
                let product = |sample| {
                    let a = film(*pattern, [8, 8], sample, count);
                    let b = sample_2d(*pattern, [8, 8], sample, count, Purpose(other));
                    // Centred; uniform numbers have variance 1/12.
                    12.0 * (a[0] - 0.5) * (b[0] - 0.5)
                };
                let correlation = (0..count).map(product).sum::<f64>() / f64::from(count);
                assert!(
                    correlation.abs() < 4.0 / 64.0,
                    "{pattern:?} {other}: {correlation}"
                );
            }
        }
    }

    #[test]
    fn all_purposes_and_those_nested_in_them_differ() {
        let plain = [
            Purpose::FILM,
            Purpose::LENS,
            Purpose::TIME,
            Purpose::LIGHT,
            Purpose::LOBE,
        ];
        let mut seen: HashSet<Purpose> = plain.into_iter().collect();
        for purpose in plain {
            for first in 0..32 {
                seen.insert(purpose.nested(first));
                seen.extend((0..8).map(|second| purpose.nested(first).nested(second)));
            }
        }
        assert_eq!(seen.len(), 5 + 5 * 32 + 5 * 32 * 8);
        assert_ne!(
            Purpose::LIGHT.nested(1).nested(2),
            Purpose::LIGHT.nested(2).nested(1)
        );
    }

    #[test]
    fn light_samples_are_uniform_and_differ_between_lights() {
        let count = 1024;
        let pair = |purpose, sample| sample_2d(Pattern::R2, [40, 2], sample, count, purpose);
        // Plain and nested purposes
        let purposes = [
            Purpose::LENS,
            Purpose::TIME,
            Purpose::LIGHT.nested(0),
            Purpose::LIGHT.nested(1),
            Purpose::LIGHT.nested(0).nested(1),
            Purpose::LOBE.nested(0),
        ];
        for (index, &purpose) in purposes.iter().enumerate() {
            // Of every aligned run of sixteen samples, one lies in each cell of a four by four grid.
            for run in 0..count / 16 {
                let cells: HashSet<_> = (16 * run..16 * (run + 1))
                    .map(|sample| pair(purpose, sample).map(|x| (4.0 * x) as u32))
                    .collect();
                assert_eq!(cells.len(), 16, "{purpose:?} {run}");
            }
            for &other in &purposes[..index] {
                for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let product = |s| 12.0 * (pair(purpose, s)[a] - 0.5) * (pair(other, s)[b] - 0.5);
                    let correlation = (0..count).map(product).sum::<f64>() / f64::from(count);
                    // Four standard errors of independent pairs, 1/32 each.
                    assert!(
                        correlation.abs() < 4.0 / 32.0,
                        "{purpose:?} {other:?}: {correlation}"
                    );
                }
            }
        }
    }

    #[test]
    fn numbers_of_sixteen_pixels_equal_those_of_each() {
        let pixels: [Lanes<u32>; 2] = [3, 1000].map(|first| std::array::from_fn(|l| first + 7 * l as u32));
        let samples: Lanes<u32> = std::array::from_fn(|l| 1000 * l as u32 + 1);
        let purpose = Purpose::LIGHT.nested(2);
        let numbers = number_packet(&pixels, &samples, purpose);
        for l in 0..LANES {
            let one = sample_2d(Pattern::R2, [pixels[0][l], pixels[1][l]], samples[l], 16, purpose);
            assert_eq!([numbers[0][l], numbers[1][l]], one);
        }
    }

    #[test]
    fn packet_samples_equal_single_samples() {
        for pattern in [Pattern::Jittered, Pattern::Sobol] {
            for spp in [2, 5, 16, 40] {
                let shape = PacketShape::for_samples(spp);
                let layout = SampleLayout::new(pattern, spp);
                let [dx, dy] = shape.pixels();
                let (x, y) = (dx.map(|d| 96 + d), dy.map(|d| 640 + d));
                for group in shape.groups(layout, spp) {
                    let position = layout.lane_positions(&x, &y, &group, 0);
                    for l in (0..LANES).filter(|&l| group.exists[l]) {
                        let one = film(pattern, [x[l], y[l]], group.sample[l], spp);
                        assert_eq!([position[0][l], position[1][l]], one, "{pattern:?} {spp} {l}");
                    }
                }
            }
        }
    }
}
