//! Logarithmic axes of measured values.

use super::plot::even_ticks;
use crate::cost::Interval;

/// Smallest shown interval end as a fraction of the smallest value; ends below it are clipped.
const REACH: f64 = 0.25;
/// Smallest factor that an axis spans, and the factor on either side of a single value.
const MIN_SPAN: f64 = 2.0;
/// Margin at either end, as a fraction of the shown span.
const ROOM: f64 = 0.05;
/// Margin below the smallest value if other values are 0 and drawn at the foot, as a fraction of the shown span.
const ROOM_FOR_ZERO: f64 = 0.15;
/// Smallest distance of a tick from a foot that stands for 0, as a fraction of the axis.
const APART: f64 = 0.06;

/// Logarithmic axis; values of at most 0 are drawn at its foot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogAxis<'a> {
    /// Label with the quantity and its unit.
    pub label: &'a str,
    /// Decimal logarithms of the values at the ends.
    low: f64,
    high: f64,
    /// True if the foot stands for 0.
    has_zero: bool,
}

impl<'a> LogAxis<'a> {
    /// Returns an axis that contains all values, and their intervals within limits.
    pub fn around(label: &'a str, all: &[Interval]) -> LogAxis<'a> {
        // Find the smallest positive value
        let usable = |x: &f64| *x > 0.0 && x.is_finite();
        let values = || all.iter().map(|interval| interval.value);
        let least = values().filter(usable).fold(f64::INFINITY, f64::min);
        let has_zero = values().any(|value| value <= 0.0);
        if !least.is_finite() {
            return LogAxis {
                label,
                low: -1.0,
                high: 0.0,
                has_zero,
            };
        }
        // Extend the range by the intervals
        let lows = all.iter().filter(|interval| interval.value > 0.0);
        let lows = lows.map(|interval| interval.low.max(REACH * least));
        let ends = lows.chain(values()).filter(usable);
        let low = ends.fold(least, f64::min).log10();
        let ends = all.iter().map(|interval| interval.high);
        let high = ends.chain(values()).filter(usable).fold(least, f64::max).log10();
        // Widen a narrow range and add margins
        let lacking = (MIN_SPAN.log10() - 0.5 * (high - low)).max(0.0);
        let (low, high) = (low - lacking, high + lacking);
        let below = if has_zero { ROOM_FOR_ZERO } else { ROOM };
        LogAxis {
            label,
            low: low - below * (high - low),
            high: high + ROOM * (high - low),
            has_zero,
        }
    }

    /// Returns the position of a value from 0 to 1; NaN is at the end.
    pub fn place(&self, value: f64) -> f64 {
        if value.is_nan() {
            return 1.0;
        }
        // The logarithm of 0 is negative infinity, which clamps to the foot.
        ((value.max(0.0).log10() - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
    }

    /// Returns about `most` ticks with labels at most: round numbers, and the foot if it stands for 0.
    pub fn ticks(&self, most: f64) -> Vec<(f64, String)> {
        let mut ticks = self.round_numbers(most.max(2.0) as usize);
        if self.has_zero {
            ticks.retain(|(value, _)| self.place(*value) > APART);
            ticks.push((0.0, "0".to_owned()));
        }
        ticks
    }

    /// Returns as many round ticks as `most` permits: linear steps if the axis spans less than a decade, otherwise 1, 2
    /// and 5 times powers of ten, otherwise powers of ten alone.
    fn round_numbers(&self, most: usize) -> Vec<(f64, String)> {
        if self.high - self.low < 1.0 {
            let ticks = even_ticks(10f64.powf(self.low), 10f64.powf(self.high));
            if ticks.len() <= most {
                return ticks.into_iter().map(in_few_letters).collect();
            }
        }
        let ticks = self.multiples(&[1, 2, 5], 1);
        if (2..=most).contains(&ticks.len()) {
            return ticks;
        }
        let step = ((self.high - self.low) / most as f64).ceil().max(1.0);
        let powers = self.multiples(&[1], step as i32);
        if powers.is_empty() { ticks } else { powers }
    }

    /// Returns the products of `factors` with powers of ten whose exponent is a multiple of `step`, within the axis.
    fn multiples(&self, factors: &[u32], step: i32) -> Vec<(f64, String)> {
        let powers = (self.low.floor() as i32..=self.high.ceil() as i32).filter(|power| power % step == 0);
        let all = powers.flat_map(|power| {
            let of = move |&factor: &u32| (f64::from(factor) * 10f64.powi(power), factor, power);
            factors.iter().map(of)
        });
        all.filter(|(value, _, _)| (self.low..=self.high).contains(&value.log10()))
            .map(|(value, factor, power)| (value, name(value, factor, power)))
            .collect()
    }
}

/// Shortens the label of a linear tick to scientific notation if it has many zeros.
fn in_few_letters((value, name): (f64, String)) -> (f64, String) {
    if (1e-4..1e6).contains(&value) {
        (value, name)
    } else {
        (value, format!("{value:.1e}"))
    }
}

/// Formats a tick in positional notation where this is short.
fn name(value: f64, factor: u32, power: i32) -> String {
    match power {
        0..=5 => format!("{value:.0}"),
        -4..0 => format!("{value:.*}", -power as usize),
        _ => format!("{factor}e{power}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(values: &[f64]) -> LogAxis<'static> {
        let all: Vec<Interval> = values.iter().map(|&value| Interval::exact(value)).collect();
        LogAxis::around("", &all)
    }

    fn names(values: &[f64], most: f64) -> Vec<String> {
        axis(values).ticks(most).into_iter().map(|tick| tick.1).collect()
    }

    #[test]
    fn ticks_are_round_and_limited_in_number() {
        assert_eq!(names(&[0.01, 0.1], 9.0), ["0.01", "0.02", "0.05", "0.1"]);
        assert_eq!(names(&[0.001, 1.0], 5.0), ["0.001", "0.01", "0.1", "1"]);
        assert_eq!(names(&[1e-9, 1e-3], 4.0), ["1e-8", "1e-6", "0.0001"]);
        // A single value has a factor of two on either side.
        assert_eq!(names(&[2.0], 9.0), ["1", "2", "3", "4"]);
    }

    #[test]
    fn every_axis_has_finite_ticks() {
        for exponent in -30..30 {
            for span in [1.0, 1.001, 1.9, 3.0, 9.9, 30.0, 1e3, 1e9] {
                for most in [2.0, 5.0, 12.0] {
                    let low = 1.7 * 10f64.powi(exponent);
                    let ticks = axis(&[low, low * span]).ticks(most);
                    assert!(ticks.len() <= most as usize + 1, "{low} {span}: {ticks:?}");
                    assert!(!ticks.is_empty() || most < 3.0, "{low} {span} {most}");
                    assert!(ticks.iter().all(|tick| tick.0 > 0.0 && tick.0.is_finite()));
                }
            }
        }
    }

    #[test]
    fn zero_has_its_own_tick_at_the_foot() {
        let axis = axis(&[0.0, 1.0, 10.0]);
        assert_eq!(axis.place(0.0), 0.0);
        assert_eq!(axis.place(-1.0), 0.0);
        assert!(axis.place(1.0) > 0.1);
        assert_eq!(axis.ticks(9.0).pop().unwrap().1, "0");
    }

    #[test]
    fn interval_end_far_below_all_values_is_clipped() {
        let wide = Interval {
            value: 1.0,
            low: 1e-30,
            high: 1.0,
        };
        let axis = LogAxis::around("", &[wide, Interval::exact(100.0)]);
        assert!(axis.low > -1.0, "{axis:?}");
        assert_eq!(axis.place(1e-30), 0.0);
    }

    #[test]
    fn non_finite_values_have_a_position() {
        for values in [&[][..], &[f64::NAN], &[f64::INFINITY, 0.0], &[0.0]] {
            let axis = axis(values);
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, 1.0] {
                assert!((0.0..=1.0).contains(&axis.place(value)), "{axis:?} {value}");
            }
        }
    }
}
