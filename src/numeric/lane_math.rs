//! Trigonometric functions without branches and calls, which vectorise in loops over lanes.
//!
//! Sources: the rational approximation of asin and the polynomials of sine and cosine of W. Cody and W. Waite, "Software
//! Manual for the Elementary Functions", 1980, with the minimax coefficients of fdlibm (Sun Microsystems, 1993).

use std::f64::consts::{FRAC_2_PI, FRAC_PI_2, PI};

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
