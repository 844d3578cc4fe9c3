//! Conversion between opacity and optical depth: 1 - exp(-tau) and -ln(1 - alpha), without cancellation.
//!
//! Branch-free arithmetic with a split ln 2 and series that converge to the last bit, so that loops over lanes
//! vectorise and every machine gives identical bits. Both functions are within 3 ulp of the standard library over their
//! range.

/// High part of ln 2, its first 33 bits, so that products with small integers are exact.
const LN2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
/// Low part of ln 2: the rest beyond [`LN2_HIGH`].
const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// Constant 1.5 · 2^52: adding it leaves a rounded integer in the low bits.
const ROUNDER: f64 = 6_755_399_441_055_744.0;
/// Depth from which on an opacity rounds to 1: exp(-64) < 2^-92.
const SATURATION_DEPTH: f64 = 64.0;
/// Bit pattern of 1.0, that is, of the exponent bias.
const ONE_BITS: u64 = 1.0f64.to_bits();
/// Mask of the 52 mantissa bits of an f64.
const MANTISSA: u64 = (1 << 52) - 1;
/// Bit pattern of sqrt(1/2), the lower end of the octave around 1 that arguments of ln are reduced to.
const ROOT_HALF_BITS: u64 = std::f64::consts::FRAC_1_SQRT_2.to_bits();

/// Optical depth that stands for the infinite one of an opacity of 1: its transmittance is 0, yet 0 times it is 0.
pub(super) const OPAQUE: f64 = 1e6;

/// Compensated sum of optical depths, so that ten million equal terms are as exact as one (D. Knuth, The Art of
/// Computer Programming 2, 4.2.2, theorem B). Adding 0 changes no bit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct CompensatedSum {
    rounded: f64,
    compensation: f64,
}

impl CompensatedSum {
    /// Adds a depth, with the rounding error of the addition (two-sum).
    #[inline(always)]
    pub(super) fn add(&mut self, depth: f64) {
        let sum = self.rounded + depth;
        let added = sum - self.rounded;
        self.compensation += (self.rounded - (sum - added)) + (depth - added);
        self.rounded = sum;
    }

    /// Returns the sum without its compensation term: for comparisons.
    #[inline(always)]
    pub(super) fn rounded(&self) -> f64 {
        self.rounded
    }

    /// Returns the transmittance exp(-sum), from 0 to 1.
    pub(super) fn transmittance(&self) -> f64 {
        // Drop the compensation of an infinite sum, which is NaN.
        let compensation = if self.rounded < f64::INFINITY {
            self.compensation
        } else {
            0.0
        };
        (-(self.rounded + compensation)).exp()
    }
}

/// Returns the transmittance of layers of these optical depths in sequence, none negative.
pub fn transmittance_of(depths: impl Iterator<Item = f64>) -> f64 {
    let mut sum = CompensatedSum::default();
    depths.for_each(|depth| sum.add(depth));
    sum.transmittance()
}

/// Returns the opacity 1 - exp(-tau) of an optical depth `tau`, which is not negative.
#[inline(always)]
pub fn opacity(tau: f64) -> f64 {
    let x = -if tau < SATURATION_DEPTH {
        tau
    } else {
        SATURATION_DEPTH
    };
    // Reduce the argument: exp(x) = 2^k exp(r) with |r| at most ln 2 / 2
    let shifted = x * std::f64::consts::LOG2_E + ROUNDER;
    let k = shifted - ROUNDER;
    let r = (x - k * LN2_HIGH) - k * LN2_LOW;
    // Build 2^k from the exponent bits
    let power = f64::from_bits(shifted.to_bits().wrapping_shl(52).wrapping_add(ONE_BITS));
    // Evaluate 1 - exp(x) without cancellation
    (1.0 - power) - power * exp_m1_near_zero(r)
}

/// Returns exp(r) - 1 for |r| up to ln 2 / 2: the next term of the series is r^14 / 14!, under 2^-57 of the value.
#[inline(always)]
fn exp_m1_near_zero(r: f64) -> f64 {
    const INVERSE_FACTORIALS: [f64; 11] = [
        1.0 / 6_227_020_800.0,
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
    ];
    let mut sum = INVERSE_FACTORIALS[0];
    for factor in &INVERSE_FACTORIALS[1..] {
        sum = sum * r + factor;
    }
    let square = r * r;
    r + (0.5 * square + square * r * sum)
}

/// Returns the optical depth -ln(1 - alpha) of an opacity in [0, 1]; for 1 it is a large number that stands for
/// infinity.
#[inline(always)]
pub fn optical_depth(alpha: f64) -> f64 {
    let rest = 1.0 - alpha;
    // Rounding error of the difference, exact.
    let compensation = (1.0 - rest) - alpha;
    // Reduce the argument: rest = 2^k (1 + f) with 1 + f between sqrt(1/2) and sqrt(2)
    let bits = rest.to_bits().wrapping_add(ONE_BITS - ROOT_HALF_BITS);
    let k = f64::from_bits(ROUNDER_BITS | (bits >> 52)) - ROUNDER_AND_BIAS;
    let f = f64::from_bits((bits & MANTISSA).wrapping_add(ROOT_HALF_BITS)) - 1.0;
    // Evaluate ln(1 + f) by its series in s = f / (2 + f)
    let s = f / (2.0 + f);
    let half_square = 0.5 * f * f;
    // Sum the parts, smallest first
    let tail = s * (half_square + odd_powers(s * s)) + (k * LN2_LOW + compensation / rest);
    let depth = ((half_square - tail) - f) - k * LN2_HIGH;
    if alpha < 1.0 { depth } else { OPAQUE }
}

/// Bit pattern of 2^52, whose low bits hold small integers directly.
const ROUNDER_BITS: u64 = 4_503_599_627_370_496.0f64.to_bits();
/// Constant 2^52 plus the exponent bias 1023.
const ROUNDER_AND_BIAS: f64 = 4_503_599_627_370_496.0 + 1023.0;

/// Returns 2 (z / 3 + z² / 5 + ...), the part of ln((1 + s) / (1 - s)) / s beyond 2, for z = s². As z is at most
/// 0.0295, the first omitted term is under 2^-58.
#[inline(always)]
fn odd_powers(z: f64) -> f64 {
    const HALF_TERMS: [f64; 10] = [
        2.0 / 21.0,
        2.0 / 19.0,
        2.0 / 17.0,
        2.0 / 15.0,
        2.0 / 13.0,
        2.0 / 11.0,
        2.0 / 9.0,
        2.0 / 7.0,
        2.0 / 5.0,
        2.0 / 3.0,
    ];
    let mut sum = HALF_TERMS[0];
    for term in &HALF_TERMS[1..] {
        sum = sum * z + term;
    }
    sum * z
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the distance in units of the last place of `expected`.
    fn ulps(got: f64, expected: f64) -> f64 {
        (got - expected).abs() / (expected.next_up() - expected)
    }

    #[test]
    fn opacity_matches_the_standard_library_for_all_depths() {
        let mut worst = 0.0f64;
        for i in 0..400_000 {
            let tau = 10f64.powf(f64::from(i) / 400_000.0 * 322.0 - 320.0);
            worst = worst.max(ulps(opacity(tau), -(-tau).exp_m1()));
        }
        // Two ulp for this implementation and one for the library's.
        assert!(worst <= 3.0, "{worst}");
        assert_eq!(opacity(0.0), 0.0);
        assert_eq!(opacity(f64::INFINITY), 1.0);
        assert_eq!(opacity(OPAQUE), 1.0);
    }

    #[test]
    fn optical_depth_matches_the_standard_library_for_all_opacities() {
        let mut worst = 0.0f64;
        for i in 0..400_000 {
            let alpha = 10f64.powf(f64::from(i) / 400_000.0 * -320.0);
            for alpha in [alpha, 1.0 - alpha] {
                if alpha < 1.0 {
                    let expected = -(-alpha).ln_1p();
                    worst = worst.max(if expected == 0.0 {
                        0.0
                    } else {
                        ulps(optical_depth(alpha), expected)
                    });
                }
            }
        }
        assert!(worst <= 3.0, "{worst}");
        assert_eq!(optical_depth(0.0), 0.0);
        assert_eq!(optical_depth(1.0), OPAQUE);
    }

    #[test]
    fn ten_million_equal_depths_sum_to_their_product() {
        for depth in [1e-7, 0.3, 0.1] {
            let mut sum = CompensatedSum::default();
            for _ in 0..10_000_000 {
                sum.add(depth);
            }
            let expected = 1e7 * depth;
            assert!((sum.rounded + sum.compensation - expected).abs() <= f64::EPSILON * expected);
        }
    }

    #[test]
    fn infinite_optical_depth_transmits_nothing() {
        let mut sum = CompensatedSum::default();
        for depth in [1.0, f64::INFINITY, 1.0, f64::INFINITY] {
            sum.add(depth);
        }
        assert_eq!(sum.transmittance(), 0.0);
    }

    #[test]
    fn optical_depths_round_trip_through_opacities() {
        for tau in [1e-300, 1e-9, 0.1, 1.0, 5.0] {
            let there = opacity(tau);
            // An opacity near 1 keeps fewer bits of its depth: the error of 2 ulp is multiplied by exp(tau).
            let bound = 4.0 * f64::EPSILON * tau * (1.0 + tau.exp());
            assert!((optical_depth(there) - tau).abs() <= bound, "{tau}");
        }
    }
}
