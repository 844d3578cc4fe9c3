//! Trigonometric functions, exponential and logarithm without branches and calls, which vectorise in loops over lanes.
//!
//! Sources: the rational approximation of asin and the polynomials of sine, cosine and atan of W. Cody and W. Waite, "Software
//! Manual for the Elementary Functions", 1980, with the minimax coefficients of fdlibm (Sun Microsystems, 1993).

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_PI, FRAC_PI_2, FRAC_PI_4, LN_2, LOG2_E, PI};

/// Returns the arc cosine of `x` in [-1, 1], in radians, with an error of at most 4 units in the last place of π.
#[inline(always)]
pub(crate) fn acos(x: f64) -> f64 {
    /// Numerator and denominator of (asin(x) - x) / x³ by x², for |x| <= 1/2, lowest power first.
    const NUMERATOR: [f64; 6] = [
        1.666_666_666_666_666_6e-1,
        -3.255_658_186_224_009e-1,
        2.012_125_321_348_629_3e-1,
        -4.005_553_450_067_941e-2,
        7.915_349_942_898_145e-4,
        3.479_331_075_960_212e-5,
    ];
    const DENOMINATOR: [f64; 5] = [
        1.0,
        -2.403_394_911_734_414,
        2.020_945_760_233_505_7,
        -6.882_839_716_054_533e-1,
        7.703_815_055_590_194e-2,
    ];
    let size = x.abs();
    let is_small = size < 0.5;
    // Halve the angle beyond 60 degrees of the sine: acos(x) = 2 asin(sqrt((1 - x) / 2))
    let squared = if is_small { x * x } else { 0.5 * (1.0 - size) };
    let sine = if is_small { size } else { squared.sqrt() };
    let ratio = polynomial(&NUMERATOR, squared) / polynomial(&DENOMINATOR, squared);
    let arc = sine + sine * squared * ratio;
    // Mirror negative arguments
    let small = FRAC_PI_2 - arc.copysign(x);
    let large = if x < 0.0 { PI - 2.0 * arc } else { 2.0 * arc };
    if is_small { small } else { large }
}

/// Returns the angle of the point (x, y) from the x axis in radians, in [-π, π], with an error of at most 4 units in the last
/// place of π; 0 for the origin.
#[inline(always)]
pub(crate) fn atan2(y: f64, x: f64) -> f64 {
    /// Polynomial of (1 - atan(t) / t) / t² by t², for |t| <= 7/16, lowest power first.
    const SERIES: [f64; 11] = [
        3.333_333_333_333_293e-1,
        -1.999_999_999_987_648_3e-1,
        1.428_571_427_250_346_6e-1,
        -1.111_111_040_546_235_6e-1,
        9.090_887_133_436_507e-2,
        -7.691_876_205_044_83e-2,
        6.661_073_137_387_531e-2,
        -5.833_570_133_790_573_5e-2,
        4.976_877_994_615_932_4e-2,
        -3.653_157_274_421_691_6e-2,
        1.628_582_011_536_578_2e-2,
    ];
    /// Tangent of an eighth of π.
    const TAN_PI_8: f64 = 0.414_213_562_373_095_03;
    // Reduce to the octant between the axes, and half of it to the angle from the diagonal
    let (across, up) = (x.abs(), y.abs());
    let is_steep = up > across;
    let (short, long) = if is_steep { (across, up) } else { (up, across) };
    let is_wide = short > TAN_PI_8 * long;
    let numerator = if is_wide { short - long } else { short };
    let denominator = if is_wide { short + long } else { long };
    let t = numerator / denominator.max(f64::MIN_POSITIVE);
    let squared = t * t;
    let arc = t - t * squared * polynomial(&SERIES, squared);
    // Undo the reductions
    let arc = if is_wide { FRAC_PI_4 + arc } else { arc };
    let arc = if is_steep { FRAC_PI_2 - arc } else { arc };
    let arc = if x < 0.0 { PI - arc } else { arc };
    arc.copysign(y)
}

/// Returns the sine and the cosine of `x` radians, where |x| is at most 2^20, with an error of at most 1e-15.
#[inline(always)]
pub(crate) fn sin_cos(x: f64) -> [f64; 2] {
    /// Polynomials of sin(r) / r and cos(r) by r², for |r| <= π/4, lowest power first.
    const SINE: [f64; 7] = [
        1.0,
        -1.666_666_666_666_663_2e-1,
        8.333_333_333_322_49e-3,
        -1.984_126_982_985_795e-4,
        2.755_731_370_707_007e-6,
        -2.505_076_025_340_686_3e-8,
        1.589_690_995_211_55e-10,
    ];
    const COSINE: [f64; 8] = [
        1.0,
        -0.5,
        4.166_666_666_666_66e-2,
        -1.388_888_888_887_411e-3,
        2.480_158_728_947_673e-5,
        -2.755_731_435_139_066_3e-7,
        2.087_572_321_298_175e-9,
        -1.135_964_755_778_819_5e-11,
    ];
    /// First 33 bits of π/2, whose products with the number of turns are exact, and the rest.
    const HALF_TURN: [f64; 2] = [1.570_796_326_734_125_6, 6.077_100_506_506_192e-11];
    /// Adding and subtracting it rounds to an integer.
    const ROUNDER: f64 = 1.5 * (1u64 << 52) as f64;
    // Reduce to a quarter turn around a multiple of π/2; the integer is in the low bits of the sum
    let shifted = x * FRAC_2_PI + ROUNDER;
    let turns = shifted - ROUNDER;
    let quadrant = shifted.to_bits() & 3;
    let rest = x - turns * HALF_TURN[0] - turns * HALF_TURN[1];
    let squared = rest * rest;
    let sine = rest * polynomial(&SINE, squared);
    let cosine = polynomial(&COSINE, squared);
    // Exchange and negate by the quadrant
    let is_odd = quadrant & 1 == 1;
    let (a, b) = if is_odd { (cosine, sine) } else { (sine, cosine) };
    let sign = |bit: u64| f64::from_bits(1.0f64.to_bits() | bit << 63);
    [a * sign(quadrant >> 1), b * sign((quadrant ^ quadrant >> 1) & 1)]
}

/// Returns e to the power `x`, with a relative error of at most 1e-13; 0 below -700, and the value at 700 above it.
#[inline(always)]
pub(crate) fn exp(x: f64) -> f64 {
    /// Coefficients of the power series, 1 / n!.
    const SERIES: [f64; 13] = [
        1.0,
        1.0,
        1.0 / 2.0,
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5_040.0,
        1.0 / 40_320.0,
        1.0 / 362_880.0,
        1.0 / 3_628_800.0,
        1.0 / 39_916_800.0,
        1.0 / 479_001_600.0,
    ];
    /// First 32 bits of ln 2, whose products with exponents are exact, and the rest.
    const LN_2_PARTS: [f64; 2] = [0.693_147_180_369_123_8, 1.908_214_929_270_587_7e-10];
    const LIMIT: f64 = 700.0;
    // Reduce to half a binary step around 0
    let bounded = x.clamp(-LIMIT, LIMIT);
    let exponent = (bounded * LOG2_E).round_ties_even();
    let rest = bounded - exponent * LN_2_PARTS[0] - exponent * LN_2_PARTS[1];
    // Scale the series by the power of two
    let scale = f64::from_bits(((exponent as i64 + 1023) as u64) << 52);
    let value = polynomial(&SERIES, rest) * scale;
    if x < -LIMIT { 0.0 } else { value }
}

/// Returns the natural logarithm of a positive and normal `x`, with an error of at most 1e-15 of the larger of its size
/// and 1.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    /// Coefficients of artanh(s) / s by s², 1 / (2 n + 1).
    const SERIES: [f64; 11] = [
        1.0,
        1.0 / 3.0,
        1.0 / 5.0,
        1.0 / 7.0,
        1.0 / 9.0,
        1.0 / 11.0,
        1.0 / 13.0,
        1.0 / 15.0,
        1.0 / 17.0,
        1.0 / 19.0,
        1.0 / 21.0,
    ];
    // Split into a power of two and a factor around 1
    let shifted = x.to_bits().wrapping_sub(FRAC_1_SQRT_2.to_bits());
    let exponent = (shifted as i64) >> 52;
    let factor = f64::from_bits(x.to_bits().wrapping_sub((exponent << 52) as u64));
    // The logarithm of the factor is 2 artanh((factor - 1) / (factor + 1))
    let s = (factor - 1.0) / (factor + 1.0);
    exponent as f64 * LN_2 + 2.0 * s * polynomial(&SERIES, s * s)
}

#[inline(always)]
fn polynomial<const N: usize>(coefficients: &[f64; N], x: f64) -> f64 {
    let mut sum = 0.0;
    for coefficient in coefficients.iter().rev() {
        sum = sum * x + coefficient;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_and_logarithm_equal_those_of_the_standard_library() {
        for i in -70_000..=70_000 {
            let x = f64::from(i) / 100.0;
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-13, "{x}");
            let y = (x / 2.0).exp();
            let error = (ln(y) - y.ln()).abs();
            assert!(error <= 1e-15 * y.ln().abs().max(1.0), "{y}: {error}");
        }
        assert_eq!((exp(0.0), ln(1.0), exp(-1e9)), (1.0, 0.0, 0.0));
        assert_eq!(exp(1e9), exp(700.0));
    }

    #[test]
    fn arc_cosine_equals_that_of_the_standard_library() {
        const STEPS: i32 = 100_000;
        for i in -STEPS..=STEPS {
            let x = f64::from(i) / f64::from(STEPS);
            assert!((acos(x) - x.acos()).abs() <= 4.0 * f64::EPSILON, "{x}");
        }
        for x in [
            1.0,
            -1.0,
            0.5,
            -0.5,
            0.0,
            1.0 - f64::EPSILON,
            -1.0 + f64::EPSILON,
            1e-300,
        ] {
            assert!((acos(x) - x.acos()).abs() <= 4.0 * f64::EPSILON, "{x}");
        }
    }

    #[test]
    fn angle_of_a_point_equals_that_of_the_standard_library() {
        const STEPS: i32 = 100_000;
        for i in -STEPS..=STEPS {
            let (y, x) = (PI * f64::from(i) / f64::from(STEPS)).sin_cos();
            for scale in [1.0, 1e-200, 1e200] {
                let (found, expected) = (atan2(scale * y, scale * x), (scale * y).atan2(scale * x));
                assert!((found - expected).abs() <= 4.0 * f64::EPSILON, "{x} {y}: {found}");
            }
        }
        assert_eq!(
            (atan2(0.0, 0.0), atan2(0.0, 2.0), atan2(3.0, 0.0)),
            (0.0, 0.0, FRAC_PI_2)
        );
        assert_eq!((atan2(0.0, -1.0), atan2(-0.0, -1.0)), (PI, -PI));
    }

    #[test]
    fn sine_and_cosine_equal_those_of_the_standard_library() {
        for i in -200_000..=200_000 {
            let x = f64::from(i) * 1.234e-4;
            let [sine, cosine] = sin_cos(x);
            assert!(
                (sine - x.sin()).abs() <= 1e-15 && (cosine - x.cos()).abs() <= 1e-15,
                "{x}"
            );
        }
        assert_eq!(sin_cos(0.0), [0.0, 1.0]);
    }
}
