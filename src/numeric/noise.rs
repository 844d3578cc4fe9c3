//! Perlin's improved noise (Perlin, "Improving noise", SIGGRAPH 2002), and sums of its octaves.
//!
//! An octave whose cells are narrower than the ray's footprint is replaced by its mean, so that unresolved detail
//! neither flickers nor darkens.

use glam::DVec3;

/// Permutation table of Perlin's reference implementation.
#[rustfmt::skip]
const PERMUTATION: [u8; 256] = [
    151, 160, 137, 91, 90, 15, 131, 13, 201, 95, 96, 53, 194, 233, 7, 225, 140, 36, 103, 30, 69, 142, 8, 99, 37, 240,
    21, 10, 23, 190, 6, 148, 247, 120, 234, 75, 0, 26, 197, 62, 94, 252, 219, 203, 117, 35, 11, 32, 57, 177, 33, 88,
    237, 149, 56, 87, 174, 20, 125, 136, 171, 168, 68, 175, 74, 165, 71, 134, 139, 48, 27, 166, 77, 146, 158, 231, 83,
    111, 229, 122, 60, 211, 133, 230, 220, 105, 92, 41, 55, 46, 245, 40, 244, 102, 143, 54, 65, 25, 63, 161, 1, 216,
    80, 73, 209, 76, 132, 187, 208, 89, 18, 169, 200, 196, 135, 130, 116, 188, 159, 86, 164, 100, 109, 198, 173, 186,
    3, 64, 52, 217, 226, 250, 124, 123, 5, 202, 38, 147, 118, 126, 255, 82, 85, 212, 207, 206, 59, 227, 47, 16, 58,
    17, 182, 189, 28, 42, 223, 183, 170, 213, 119, 248, 152, 2, 44, 154, 163, 70, 221, 153, 101, 155, 167, 43, 172, 9,
    129, 22, 39, 253, 19, 98, 108, 110, 79, 113, 224, 232, 178, 185, 112, 104, 218, 246, 97, 228, 251, 34, 242, 193,
    238, 210, 144, 12, 191, 179, 162, 241, 81, 51, 145, 235, 249, 14, 239, 107, 49, 192, 214, 31, 181, 199, 106, 157,
    184, 84, 204, 176, 115, 121, 50, 45, 127, 4, 150, 254, 138, 236, 205, 93, 222, 114, 67, 29, 24, 72, 243, 141, 128,
    195, 78, 66, 215, 61, 156, 180,
];

/// Each number of the table with the next in its upper byte: the hashes of two neighbouring cells.
const PAIRS: [u16; 256] = {
    let mut pairs = [0; 256];
    let mut i = 0;
    while i < 256 {
        pairs[i] = u16::from_le_bytes([PERMUTATION[i], PERMUTATION[(i + 1) % 256]]);
        i += 1;
    }
    pairs
};

/// Footprint width, in cells, from which on an octave has faded completely. With the smooth step from 0 to here an
/// octave fades as its mean over a square of that width does: measured 0.95, 0.86, 0.58, 0.32, 0.16 at widths 1/4, 1/2,
/// 1, 3/2, 2.
const FADE_OUT_WIDTH: f64 = 2.25;
/// Mean of |noise| over all space, from four million points of a low-discrepancy sequence.
const MEAN_MAGNITUDE: f64 = 0.2204;

/// Returns noise in [-1, 1] with cells of side 1, zero at the corners of every cell.
pub fn noise(p: DVec3) -> f64 {
    let [noise] = noise_at(&lone(p));
    noise
}

/// Returns the noise at `N` points, given as x, y and z.
#[inline(always)]
pub(crate) fn noise_at<const N: usize>(p: &[[f64; N]; 3]) -> [f64; N] {
    // Split the points into their cells and the positions inside
    let [(x, cells_x), (y, cells_y), (z, cells_z)] = [cells_of(&p[0]), cells_of(&p[1]), cells_of(&p[2])];
    // Hash the corners of the cells to gradients, two neighbours at a time
    let mut hashes = [[0u32; N]; 8];
    for l in 0..N {
        let along_x = permuted_pair(cells_x[l]);
        for dx in 0..2 {
            let along_y = permuted_pair(along_x[dx] + cells_y[l]);
            for dy in 0..2 {
                let along_z = permuted_pair(along_y[dy] + cells_z[l]);
                hashes[4 * dx + 2 * dy][l] = along_z[0];
                hashes[4 * dx + 2 * dy + 1][l] = along_z[1];
            }
        }
    }
    // Interpolate their dot products along x, y and z
    let mut noise = [0.0; N];
    for l in 0..N {
        let [x, y, z] = [x[l], y[l], z[l]];
        let [u, v, w] = [x, y, z].map(|t| t * t * t * (t * (t * 6.0 - 15.0) + 10.0));
        let corner = |dx: usize, dy: usize, dz: usize| {
            let offset = [x - dx as f64, y - dy as f64, z - dz as f64];
            slope(u64::from(hashes[4 * dx + 2 * dy + dz][l]), offset)
        };
        let edge = |dy, dz| lerp(u, corner(0, dy, dz), corner(1, dy, dz));
        let face = |dz| lerp(v, edge(0, dz), edge(1, dz));
        noise[l] = lerp(w, face(0), face(1));
    }
    noise
}

/// Returns the positions of coordinates in their cells, and the indices of the cells.
// One axis at a time: the compiler would vectorise a loop over three axes in place of that over the points
#[inline(always)]
fn cells_of<const N: usize>(coordinates: &[f64; N]) -> ([f64; N], [u32; N]) {
    let (mut inside, mut cells) = ([0.0; N], [0; N]);
    for l in 0..N {
        let cell = coordinates[l].floor();
        inside[l] = coordinates[l] - cell;
        cells[l] = period_index(cell);
    }
    (inside, cells)
}

/// Returns the numbers at an index of the permutation, which repeats, and at the next one.
#[inline(always)]
fn permuted_pair(index: u32) -> [u32; 2] {
    let pair = u32::from(PAIRS[(index & 255) as usize]);
    [pair & 255, pair >> 8]
}

/// Returns the index of a cell in the period of 256 cells; any index for infinity and NaN.
#[inline(always)]
fn period_index(cell: f64) -> u32 {
    /// From here up to its double, numbers are integers in the low bits of the significand.
    const INTEGERS: f64 = (1u64 << 52) as f64;
    // Subtract whole periods, which is exact
    let index = cell - 256.0 * (cell * (1.0 / 256.0)).floor();
    ((index + INTEGERS).to_bits() & 255) as u32
}

/// Returns a point as `N` = 1 points.
#[inline(always)]
pub(crate) fn lone(p: DVec3) -> [[f64; 1]; 3] {
    p.to_array().map(|x| [x])
}

/// Returns the sums of `octaves` at `N` points, each octave of twice the frequency and half the amplitude of the one
/// before, as fractions of the largest sum: within [-1, 1]. `widths` are those of the rays' footprints, in cells of the
/// first octave.
#[inline(always)]
pub(crate) fn fractal<const N: usize>(p: &[[f64; N]; 3], octaves: u32, widths: &[f64; N]) -> [f64; N] {
    octave_sums(p, octaves, widths, |noise| noise, 0.0)
}

/// Returns the sums of octaves of the noise's magnitude, with the arguments of `fractal`: within [0, 1].
#[inline(always)]
pub(crate) fn turbulence<const N: usize>(p: &[[f64; N]; 3], octaves: u32, widths: &[f64; N]) -> [f64; N] {
    octave_sums(p, octaves, widths, f64::abs, MEAN_MAGNITUDE)
}

/// Returns the normalised sums of octaves `of` the noise; those narrower than the footprint are replaced by `mean`.
#[inline(always)]
fn octave_sums<const N: usize>(
    p: &[[f64; N]; 3],
    octaves: u32,
    widths: &[f64; N],
    of: impl Fn(f64) -> f64,
    mean: f64,
) -> [f64; N] {
    let (mut sums, mut max_sum) = ([0.0; N], 0.0);
    let (mut height, mut frequency) = (1.0, 1.0);
    // Blend each octave towards its mean as its cells become narrower than the footprint
    for _ in 0..octaves {
        let mut remaining = [0.0; N];
        for l in 0..N {
            remaining[l] = remaining_amplitude(widths[l] * frequency);
        }
        let mut noise = [0.0; N];
        if remaining.iter().any(|&amplitude| amplitude > 0.0) {
            let mut scaled = [[0.0; N]; 3];
            for axis in 0..3 {
                for l in 0..N {
                    scaled[axis][l] = p[axis][l] * frequency;
                }
            }
            noise = noise_at(&scaled);
        }
        for l in 0..N {
            let blended = mean + remaining[l] * (of(noise[l]) - mean);
            let octave = if remaining[l] > 0.0 { blended } else { mean };
            sums[l] += height * octave;
        }
        max_sum += height;
        height *= 0.5;
        frequency *= 2.0;
    }
    for sum in &mut sums {
        *sum /= max_sum;
    }
    sums
}

/// Returns the fraction of an octave's amplitude that remains for a ray footprint of this width in cells.
#[inline(always)]
pub(crate) fn remaining_amplitude(width: f64) -> f64 {
    let t = (width / FADE_OUT_WIDTH).min(1.0);
    1.0 - t * t * (3.0 - 2.0 * t)
}

/// Returns the dot product of `offset` and one of the twelve gradients, the midpoints of a cube's edges.
#[inline(always)]
fn slope(hash: u64, [x, y, z]: [f64; 3]) -> f64 {
    let h = hash & 15;
    let u = if h < 8 { x } else { y };
    let far = if (h == 12) | (h == 14) { x } else { z };
    let v = if h < 4 { y } else { far };
    // The two lowest bits are the signs
    let [u, v] = [u.to_bits() ^ (h << 63), v.to_bits() ^ ((h & 2) << 62)];
    f64::from_bits(u) + f64::from_bits(v)
}

#[inline(always)]
fn lerp(t: f64, a: f64, b: f64) -> f64 {
    a + t * (b - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns points of Roberts's R3 sequence.
    fn points(count: usize, size: f64) -> impl Iterator<Item = DVec3> {
        const STEP: [f64; 3] = [
            0.819_172_513_396_164_4,
            0.671_043_606_703_789_2,
            0.549_700_477_901_975_9,
        ];
        (0..count).map(move |i| DVec3::from_array(STEP.map(|s| (i as f64 * s).fract() * size)))
    }

    #[test]
    fn noise_matches_perlins_reference_implementation() {
        let p = DVec3::new(157.0 / 50.0, 42.0, 7.0);
        assert!((noise(p) - 0.136_919_958_784_000_12).abs() < 1e-15);
    }

    #[test]
    fn permutation_contains_every_byte_once() {
        let mut sorted = PERMUTATION;
        sorted.sort_unstable();
        assert!((0..=255).eq(sorted));
    }

    #[test]
    fn noise_vanishes_on_the_lattice_and_repeats_after_256_cells() {
        for p in points(1000, 256.0) {
            assert_eq!(noise(p.floor()), 0.0);
            // Adding 256 costs the fractions low bits: 2^-45 times a slope of at most a few.
            let moved = p + DVec3::new(256.0, -256.0, 512.0);
            assert!((noise(p) - noise(moved)).abs() < 1e-11);
        }
    }

    #[test]
    fn octaves_narrower_than_the_footprint_become_their_mean() {
        for p in points(1000, 20.0) {
            assert_eq!(fractal(&lone(p), 8, &[FADE_OUT_WIDTH]), [0.0]);
            let [faded] = turbulence(&lone(p), 8, &[f64::INFINITY]);
            assert!((faded - MEAN_MAGNITUDE).abs() < 1e-15);
            assert_eq!(fractal(&lone(p), 1, &[0.0]), [noise(p)]);
            // Of three octaves the second has twice, the third four times the frequency: both have faded.
            let one = remaining_amplitude(0.5 * FADE_OUT_WIDTH) * noise(p) / 1.75;
            let [sum] = fractal(&lone(p), 3, &[0.5 * FADE_OUT_WIDTH]);
            assert!((sum - one).abs() < 1e-15);
        }
    }

    #[test]
    fn mean_magnitude_matches_the_constant() {
        const COUNT: usize = 100_000;
        let mean = points(COUNT, 256.0).map(|p| noise(p).abs()).sum::<f64>() / COUNT as f64;
        // The standard deviation of |noise| is 0.16: the tolerance is three times that over the root of the count.
        assert!((mean - MEAN_MAGNITUDE).abs() < 1.5e-3, "{mean}");
    }

    #[test]
    fn octave_fades_like_its_mean_over_a_square() {
        let (a, b) = (DVec3::new(0.6, 0.64, 0.48), DVec3::new(-0.8, 0.48, 0.36));
        for width in [0.25, 0.5, 1.0, 1.5, 2.0] {
            let (mut product, mut square) = (0.0, 0.0);
            for p in points(4000, 256.0) {
                // Average the noise over a tilted square around each point
                let at = |i: i32| width * ((f64::from(i) + 0.5) / 8.0 - 0.5);
                let cells = (0..64).map(|i| noise(p + at(i % 8) * a + at(i / 8) * b));
                product += noise(p) * cells.sum::<f64>() / 64.0;
                square += noise(p).powi(2);
            }
            // The remaining fraction agrees within the misfit of the smooth step and the variance of 4000 points.
            assert!(
                (product / square - remaining_amplitude(width)).abs() < 0.15,
                "{width}: {}",
                product / square
            );
        }
    }

    #[test]
    fn far_and_non_finite_points_have_finite_noise() {
        for x in [1e300, -1e300, 1e-320, -0.0] {
            let [sum] = turbulence(&lone(DVec3::new(x, 0.5, -x)), 16, &[0.0]);
            assert!(sum <= 1.0);
        }
    }
}
