//! Vectorisable f32 exponential of a negative number, without branches or calls.

/// Value of 1.5 · 2^23: added to a small number, it leaves the nearest integer in the lowest bits.
const TO_INTEGER: f32 = 12_582_912.0;

/// High part of ln 2, with the last 9 bits zero, so that its products with integers up to 2^9 are exact.
const LN_2_HIGH: f32 = 0.693_145_75;
/// Low part of ln 2: the rest that [`LN_2_HIGH`] omits.
const LN_2_LOW: f32 = 1.428_606_8e-6;

/// Returns e^-x for x within [0, 87], to a relative error of 2^-22.
///
/// -x = n ln 2 + f with |f| <= ln 2 / 2 (Cody and Waite), and e^f by its series to f^7, whose remainder is below 0.35^8
/// / 8! < 2^-27 there.
#[inline(always)]
pub(super) fn exp_neg(x: f32) -> f32 {
    let shifted = TO_INTEGER - x * std::f32::consts::LOG2_E;
    let n = shifted - TO_INTEGER;
    let f = (-x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut series = 1.0 / 5040.0;
    for coefficient in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        series = series * f + coefficient;
    }
    // n is in the lowest bits of `shifted`, from which the shift moves it into the exponent; n >= -126.
    f32::from_bits(series.to_bits().wrapping_add(shifted.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_power_is_right_to_its_stated_error() {
        // Test every 97th of all numbers from 2^-20 to 87.
        let bits = (0.5f32.powi(20).to_bits()..=87f32.to_bits()).step_by(97);
        for x in bits.map(f32::from_bits).chain([0.0, 87.0]) {
            let exact = (-f64::from(x)).exp();
            let error = (f64::from(exp_neg(x)) / exact - 1.0).abs();
            assert!(error <= 0.5f64.powi(22), "{x}: {error}");
        }
        assert_eq!(exp_neg(0.0), 1.0);
    }
}
