//! Formatting of numbers for reports.

use crate::measure::Interval;

/// Fraction of the time for which a thread may wait for a processor before a report says that the machine was busy.
const BUSY: f64 = 0.05;

/// Returns a sentence on the load by other programs if it was noticeable; `waiting` is the fraction of the
/// time in which a calibration kernel waited for a processor.
pub(super) fn busy_line(waiting: f64) -> Option<String> {
    (waiting > BUSY).then(|| {
        format!(
            "busy machine: a thread waited for a processor {} of the time; ratios and speeds of one thread are by \
             processor time, all other seconds by the clock",
            percent(waiting)
        )
    })
}

/// Formats a fraction as a percentage with at most two significant digits, as measured times are not more accurate.
pub(super) fn percent(part: f64) -> String {
    let percent = 100.0 * part.abs();
    match percent {
        0.0 => "0 %".into(),
        p if p < 0.01 => "<0.01 %".into(),
        p if p < 0.095 => format!("{p:.2} %"),
        p if p < 9.5 => format!("{p:.1} %"),
        p => format!("{p:.0} %"),
    }
}

/// Formats a number with `digits` significant digits, in positional notation for moderate exponents; a dash if it is
/// not finite.
pub(super) fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let after_first = digits.max(1) - 1;
    let powers = format!("{value:.after_first$e}");
    // Take the exponent after rounding: 9.99 may become 10.
    let exponent: i32 = powers
        .split_once('e')
        .and_then(|(_, e)| e.parse().ok())
        .unwrap_or(0);
    match exponent {
        -4..6 => format!("{value:.*}", (after_first as i32 - exponent).max(0) as usize),
        _ => powers,
    }
}

/// Formats a ratio as a factor, such as `x1.25`.
pub(super) fn times(ratio: f64) -> String {
    // A ratio that rounds to 1 has three digits, as larger ones do.
    format!("x{}", significant(ratio, if ratio < 0.995 { 2 } else { 3 }))
}

/// Formats the ends of an interval as `low to high`.
pub(super) fn range(interval: Interval, digits: usize) -> String {
    let [low, high] = [interval.low, interval.high].map(|end| significant(end, digits));
    format!("{low} to {high}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_significant_digits_requested() {
        let words = [0.0, 1.0, -0.7412, 9.996, 1234.5, 1e-4, 1e-5, 1.5e7].map(|x| significant(x, 3));
        assert_eq!(
            words,
            [
                "0", "1.00", "-0.741", "10.0", "1234", "0.000100", "1.00e-5", "1.50e7"
            ]
        );
        assert_eq!(significant(f64::NAN, 3), "–");
        assert_eq!(significant(f64::NEG_INFINITY, 3), "–");
        assert_eq!(
            [times(0.1234), times(3.94), times(1.0)],
            ["x0.12", "x3.94", "x1.00"]
        );
    }
}
