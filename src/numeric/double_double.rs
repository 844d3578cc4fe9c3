//! Double-double arithmetic: numbers of 106 bits as the unevaluated sum of two floats, used as reference for f64
//! results.
//!
//! Sums and products follow Dekker ("A floating-point technique for extending the available precision", 1971) and Knuth
//! (The Art of Computer Programming, volume 2, section 4.2.2). Each operation is accurate to a few 2^-104; the exponent
//! has the range of f64, and errors grow where low parts underflow, below about 1e-290.

use std::cmp::Ordering;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// Unevaluated sum of two numbers, the second less than half a unit in the last place of the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubleDouble(f64, f64);

/// Natural logarithm of 2 to 106 bits.
const LN_2: DoubleDouble = DoubleDouble(std::f64::consts::LN_2, 2.319_046_813_846_299_6e-17);

impl DoubleDouble {
    /// Double-double number zero, exactly.
    pub const ZERO: DoubleDouble = DoubleDouble::of(0.0);
    /// Double-double number one, exactly.
    pub const ONE: DoubleDouble = DoubleDouble::of(1.0);

    /// Converts a float without rounding.
    pub const fn of(x: f64) -> DoubleDouble {
        DoubleDouble(x, 0.0)
    }

    /// Returns a + b to 106 bits; requires |a| >= |b|.
    pub fn from_parts(a: f64, b: f64) -> DoubleDouble {
        DoubleDouble::fast_two_sum(a, b)
    }

    /// Returns the sum a + b, exact if |a| >= |b| (Dekker's Fast2Sum).
    fn fast_two_sum(a: f64, b: f64) -> DoubleDouble {
        let s = a + b;
        if s.is_finite() {
            DoubleDouble(s, b - (s - a))
        } else {
            DoubleDouble(s, 0.0)
        }
    }

    /// Returns the nearest float.
    pub fn nearest(self) -> f64 {
        self.0
    }

    /// Returns the absolute value.
    pub fn abs(self) -> DoubleDouble {
        if self < DoubleDouble::ZERO { -self } else { self }
    }

    /// Returns the square root; zero for negative numbers.
    pub fn sqrt(self) -> DoubleDouble {
        if self.0 <= 0.0 {
            return DoubleDouble::ZERO;
        }
        let x = DoubleDouble::of(self.0.sqrt());
        // One Newton step doubles the number of correct digits.
        x + (self - x * x) / (x + x)
    }

    /// Returns e to the power of this number minus 1, without cancellation.
    pub fn exp_m1(self) -> DoubleDouble {
        // Halve the argument until the series is short. Then e^2x - 1 = y (y + 2) with y = e^x - 1 doubles it back,
        // each time with two roundings of a positive multiple.
        const HALVINGS: i32 = 10;
        // Reduce the argument by multiples of ln 2
        let exponent = (self.0 / LN_2.0).round();
        let x = (self - DoubleDouble::of(exponent) * LN_2) * DoubleDouble::of(0.5f64.powi(HALVINGS));
        // |x| <= ln 2 / 2^11: the eleventh term is below 2^-106 of the first.
        let mut term = x;
        let mut sum = x;
        for n in 2..12 {
            term = term * x / DoubleDouble::of(f64::from(n));
            sum = sum + term;
        }
        // Double the argument back
        for _ in 0..HALVINGS {
            sum = sum * (sum + DoubleDouble::of(2.0));
        }
        if exponent == 0.0 {
            return sum;
        }
        // Multiply by the power of two in two steps, as the power may overflow where the result does not.
        let half = (exponent * 0.5).floor();
        let power = |n: f64| DoubleDouble::of(n.clamp(-1074.0, 1023.0).exp2());
        (sum + DoubleDouble::ONE) * power(half) * power(exponent - half) - DoubleDouble::ONE
    }

    /// Returns the natural logarithm of 1 plus this number, which must be above -1.
    pub(crate) fn ln_1p(self) -> DoubleDouble {
        let mut y = DoubleDouble::of(self.0.ln_1p());
        // Newton's step for e^y - 1 = x squares the error: two steps eliminate that of the first guess.
        for _ in 0..2 {
            let e = y.exp_m1();
            y = y + (self - e) / (e + DoubleDouble::ONE);
        }
        y
    }

    /// Returns the difference of `x` from this number in units in its last place.
    pub(crate) fn ulps_from(self, x: f64) -> f64 {
        let exact = self.nearest();
        let off = (DoubleDouble::of(x) - self).nearest().abs();
        if off == 0.0 {
            0.0
        } else {
            off / (exact.abs().next_up() - exact.abs())
        }
    }
}

impl Add for DoubleDouble {
    type Output = DoubleDouble;
    fn add(self, other: DoubleDouble) -> DoubleDouble {
        let s = self.0 + other.0;
        let b = s - self.0;
        let error = (self.0 - (s - b)) + (other.0 - b);
        // Add the low parts with their error too, as they may cancel
        let low = self.1 + other.1;
        let l = low - self.1;
        let low_error = (self.1 - (low - l)) + (other.1 - l);
        let sum = DoubleDouble::fast_two_sum(s, error + low);
        DoubleDouble::fast_two_sum(sum.0, sum.1 + low_error)
    }
}

impl Neg for DoubleDouble {
    type Output = DoubleDouble;
    fn neg(self) -> DoubleDouble {
        DoubleDouble(-self.0, -self.1)
    }
}

impl Sub for DoubleDouble {
    type Output = DoubleDouble;
    fn sub(self, other: DoubleDouble) -> DoubleDouble {
        self + -other
    }
}

impl Mul for DoubleDouble {
    type Output = DoubleDouble;
    fn mul(self, other: DoubleDouble) -> DoubleDouble {
        let p = self.0 * other.0;
        let error = self.0.mul_add(other.0, -p);
        DoubleDouble::fast_two_sum(p, error + (self.0 * other.1 + self.1 * other.0))
    }
}

impl Div for DoubleDouble {
    type Output = DoubleDouble;
    fn div(self, other: DoubleDouble) -> DoubleDouble {
        let first = DoubleDouble::of(self.0 / other.0);
        let rest = self - first * other;
        let second = DoubleDouble::of(rest.0 / other.0);
        let rest = rest - second * other;
        first + second + DoubleDouble::of(rest.0 / other.0)
    }
}

impl PartialOrd for DoubleDouble {
    fn partial_cmp(&self, other: &DoubleDouble) -> Option<Ordering> {
        Some(self.0.partial_cmp(&other.0)?.then(self.1.partial_cmp(&other.1)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn double_double_keeps_the_rounding_error() {
        let tiny = DoubleDouble::of(2f64.powi(-80));
        assert_eq!((DoubleDouble::ONE + tiny) - DoubleDouble::ONE, tiny);
        // (1 + 2^-60)² - 1 - 2·2^-60 = 2^-120 is beyond 106 bits: 0 up to 2^-105.
        let x = DoubleDouble::ONE + DoubleDouble::of(2f64.powi(-60));
        let rest = x * x - DoubleDouble::ONE - DoubleDouble::of(2f64.powi(-59));
        assert!(rest.nearest().abs() <= 2f64.powi(-105));
        let third = DoubleDouble::ONE / DoubleDouble::of(3.0);
        assert!(
            (third * DoubleDouble::of(3.0) - DoubleDouble::ONE)
                .nearest()
                .abs()
                <= 2f64.powi(-104)
        );
        let root = DoubleDouble::of(2.0).sqrt();
        assert!((root * root - DoubleDouble::of(2.0)).nearest().abs() <= 2f64.powi(-103));
    }

    #[test]
    fn e_has_thirty_one_correct_digits() {
        // e = 2.71828182845904523536028747135266249775...: the nearest float and the remainder.
        let e = DoubleDouble::from_parts(std::f64::consts::E, 1.445_646_891_729_250_2e-16);
        let found = DoubleDouble::ONE.exp_m1() + DoubleDouble::ONE;
        // Twelve doublings and the series have under 64 roundings of 2^-104.
        assert!((found - e).nearest().abs() <= 2f64.powi(-98));
    }

    #[test]
    fn logarithm_and_exponential_are_inverse() {
        for x in [
            1e-300, 1e-30, 1e-9, 0.3, 1.0, 50.0, 700.0, -1e-12, -0.5, -0.999_999,
        ] {
            let back = DoubleDouble::of(x).ln_1p().exp_m1();
            let off = ((back - DoubleDouble::of(x)) / DoubleDouble::of(x))
                .nearest()
                .abs();
            // The error of the logarithm returns times (1 + x) / x ln(1 + x), which is 8 at most here except near -1,
            // and 700 where the exponent's own size matters.
            assert!(off <= 2f64.powi(-84), "{x}: {off:e}");
        }
    }

    #[test]
    fn ulp_distances_are_correct() {
        assert_eq!(DoubleDouble::ONE.ulps_from(1.0), 0.0);
        assert_eq!(DoubleDouble::ONE.ulps_from(1.0 + 3.0 * f64::EPSILON), 3.0);
        let half = DoubleDouble::ONE + DoubleDouble::of(0.5 * f64::EPSILON);
        assert_eq!(half.ulps_from(1.0), 0.5);
    }
}
