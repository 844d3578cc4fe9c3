//! Lossless f64 in EXR: each value as two u32 channels, as EXR has no 64-bit channels and sums must keep all their
//! bits.

/// Returns the upper and the lower 32 bits of every value.
pub(crate) fn split_f64(values: &[f64]) -> [Vec<u32>; 2] {
    let upper = values.iter().map(|value| (value.to_bits() >> 32) as u32);
    let lower = values.iter().map(|value| value.to_bits() as u32);
    [upper.collect(), lower.collect()]
}

/// Returns the values with these upper and lower 32 bits, as many as the shorter slice has.
pub(crate) fn join_f64(upper: &[u32], lower: &[u32]) -> Vec<f64> {
    upper
        .iter()
        .zip(lower)
        .map(|(&upper, &lower)| f64::from_bits(u64::from(upper) << 32 | u64::from(lower)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_and_joined_values_keep_every_bit() {
        let nan = f64::from_bits(0x7ff8_0000_dead_beef);
        let values = [
            0.0,
            -0.0,
            1.0 / 3.0,
            f64::MIN_POSITIVE / 8.0,
            f64::MAX,
            f64::NEG_INFINITY,
            nan,
        ];
        let [upper, lower] = split_f64(&values);
        let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&join_f64(&upper, &lower)), bits(&values));
    }

    #[test]
    fn upper_half_holds_the_sign_and_the_exponent() {
        // -2 is sign 1, exponent 1024, mantissa 0; the next value differs in the lowest bit.
        let [upper, lower] = split_f64(&[-2.0, (-2.0f64).next_down()]);
        assert_eq!(upper, [0xc000_0000; 2]);
        assert_eq!(lower, [0, 1]);
    }
}
