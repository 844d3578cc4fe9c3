//! Owen-scrambled Sobol points and the hashes that they are based on.
//!
//! The first two dimensions of Sobol's sequence form a (0,2)-sequence: of the first 2^k points, each box of area 2^-k
//! whose sides are powers of two holds exactly one. Owen's scrambling keeps this property and makes the points
//! otherwise random. It is implemented by a hash in which every bit affects only the bits above it (S. Laine, T.
//! Karras, "Stratified sampling for stochastic transparency", EGSR 2011), applied to the digits in reverse (B.
//! Burley, "Practical hash-based Owen scrambling", JCGT 9(4), 2020, sections 3 and 5). All functions are free of
//! branches and state, so that sixteen lanes are computed with SIMD.

/// Returns a well-mixed hash of `value`, also for zero (the finalizer of A. Appleby's MurmurHash3).
#[inline(always)]
pub(super) const fn mixed(value: u32) -> u32 {
    /// Fractional part of the golden ratio in 32 bits, which keeps zero from mapping to zero.
    const GOLDEN: u32 = 0x9e37_79b9;
    let mut v = value.wrapping_add(GOLDEN);
    v = (v ^ (v >> 16)).wrapping_mul(0x85eb_ca6b);
    v = (v ^ (v >> 13)).wrapping_mul(0xc2b2_ae35);
    v ^ (v >> 16)
}

/// Returns the seed of the random numbers of a pixel and purpose.
#[inline(always)]
pub(super) fn seed(pixel: [u32; 2], purpose: u32) -> u32 {
    mixed(pixel[0] ^ mixed(pixel[1] ^ mixed(purpose)))
}

/// Returns 32 bits as a fraction in [0, 1).
#[inline(always)]
pub(super) fn fraction(bits: u32) -> f64 {
    /// Weight 2^-32 of the lowest bit.
    const UNIT: f64 = 1.0 / (1u64 << 32) as f64;
    f64::from(bits) * UNIT
}

/// Returns point `index` of the sequence, scrambled by `seed`.
#[inline(always)]
pub(super) fn point(index: u32, seed: u32) -> [f64; 2] {
    [
        fraction(owen_of_reversed(index, mixed(seed))),
        fraction(owen_of_reversed(pascal(index), mixed(seed ^ SECOND))),
    ]
}

/// Permutes indices such that every aligned run of 2^k of them maps onto such a run.
///
/// Pairs of different purposes that use the same points in differently shuffled orders are independent.
#[inline(always)]
pub(super) fn shuffled(index: u32, seed: u32) -> u32 {
    owen_of_reversed(index.reverse_bits(), mixed(seed ^ SHUFFLE))
}

/// Constant that separates the scrambling of the second dimension from that of the first.
const SECOND: u32 = 0x5bd1_e995;
/// Constant that separates the shuffling from the scrambling.
const SHUFFLE: u32 = 0x2545_f491;

/// Returns the digits of the second dimension, the first of them in the lowest bit: the index times Pascal's triangle
/// modulo 2.
///
/// By Lucas's theorem C(k, j) is odd where the bits of j are a subset of those of k, so digit j is the sum of the
/// index bits k whose numbers contain j: a transform over subsets, with one step for each of the five bits of a bit
/// number.
#[inline(always)]
fn pascal(index: u32) -> u32 {
    let mut digits = index;
    digits ^= (digits >> 1) & 0x5555_5555;
    digits ^= (digits >> 2) & 0x3333_3333;
    digits ^= (digits >> 4) & 0x0f0f_0f0f;
    digits ^= (digits >> 8) & 0x00ff_00ff;
    digits ^ ((digits >> 16) & 0x0000_ffff)
}

/// Returns Owen's scrambling of the number whose digits, highest first, are the bits of `reversed`, lowest first.
#[inline(always)]
fn owen_of_reversed(reversed: u32, seed: u32) -> u32 {
    // Hash of Laine and Karras: sums and products by even numbers carry upwards only.
    let mut v = reversed.wrapping_add(seed);
    v ^= v.wrapping_mul(0x6c50_b47c);
    v ^= v.wrapping_mul(0xb82f_1e52);
    v ^= v.wrapping_mul(0xc7af_e638);
    v ^= v.wrapping_mul(0x8d22_f6e6);
    v.reverse_bits()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    /// Returns whether every elementary box of area 1 / 2^log2 holds one of the points.
    fn is_net(points: &[[f64; 2]], log2: u32) -> bool {
        (0..=log2).all(|across| {
            let (columns, rows) = (f64::from(1u32 << across), f64::from(1u32 << (log2 - across)));
            let boxes: HashSet<_> = points
                .iter()
                .map(|p| ((p[0] * columns) as u32, (p[1] * rows) as u32))
                .collect();
            boxes.len() == 1 << log2
        })
    }

    #[test]
    fn second_dimension_equals_published_sobol_points() {
        // Direction numbers of x + 1: 1/2, 3/4, 5/8, 15/16; so 0, 1/2, 3/4, 1/4, 5/8, 1/8, 3/8, 7/8.
        let eighths: Vec<u32> = (0..8).map(|i| pascal(i).reverse_bits() >> 29).collect();
        assert_eq!(eighths, [0, 4, 6, 2, 5, 1, 3, 7]);
        assert_eq!(pascal(8).reverse_bits() >> 28, 15);
    }

    #[test]
    fn every_index_bit_brings_the_direction_number_of_the_recurrence() {
        // For x + 1: v(k+1) = v(k) ^ v(k) / 2, starting with 1/2.
        let mut direction = 1u32 << 31;
        for bit in 0..32 {
            assert_eq!(pascal(1 << bit).reverse_bits(), direction, "bit {bit}");
            direction ^= direction >> 1;
        }
        // The transform is linear: sums are taken bit by bit.
        assert_eq!(pascal(0xdead_beef), pascal(0xdead_0000) ^ pascal(0xbeef));
    }

    #[test]
    fn every_elementary_box_holds_one_point_scrambled_or_not() {
        for log2 in 0..=10 {
            let count = 1u32 << log2;
            let plain: Vec<[f64; 2]> = (0..count)
                .map(|i| [fraction(i.reverse_bits()), fraction(pascal(i).reverse_bits())])
                .collect();
            assert!(is_net(&plain, log2), "plain, 2^{log2}");
            for pixel in [[0, 0], [1, 0], [0, 1], [77, 1023]] {
                for purpose in 0..3 {
                    let seed = seed(pixel, purpose);
                    let points: Vec<[f64; 2]> = (0..count).map(|i| point(i, seed)).collect();
                    assert!(is_net(&points, log2), "{pixel:?} {purpose}, 2^{log2}");
                }
            }
        }
    }

    #[test]
    fn every_later_run_of_a_power_of_two_is_a_net_too() {
        let seed = seed([5, 9], 0);
        for run in 0..20 {
            let points: Vec<[f64; 2]> = (16 * run..16 * (run + 1)).map(|i| point(i, seed)).collect();
            assert!(is_net(&points, 4), "run {run}");
        }
    }

    #[test]
    fn shuffling_preserves_power_of_two_runs() {
        for seed in [0, 1, 0xdead_beef] {
            for log2 in [0, 4, 8] {
                let runs: HashSet<u32> = (0..1 << log2).map(|i| shuffled(i, seed) >> log2).collect();
                assert_eq!(runs.len(), 1, "seed {seed}, 2^{log2}");
                let places: HashSet<u32> = (0..1 << log2).map(|i| shuffled(i, seed)).collect();
                assert_eq!(places.len(), 1 << log2);
            }
        }
    }

    #[test]
    fn neighbouring_pixels_are_scrambled_differently() {
        let firsts: HashSet<u64> = (0..64)
            .flat_map(|y| (0..64).map(move |x| point(0, seed([x, y], 0))[0].to_bits()))
            .collect();
        // 4096 draws of 2^32: a coincidence is expected in 0.002 of all cases.
        assert_eq!(firsts.len(), 4096);
    }
}
