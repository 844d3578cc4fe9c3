//! Limits that measured values are held against.

use std::fmt::Display;

/// The verdicts on the values of one measurement.
#[derive(Default)]
pub(crate) struct Limits {
    is_any_missed: bool,
}

impl Limits {
    /// Returns a text on whether `value` is at most `limit`.
    pub(crate) fn at_most(&mut self, value: f64, limit: f64) -> String {
        self.judge(value <= limit, limit)
    }

    /// Returns a text on whether `value` is at least `limit`.
    #[cfg(feature = "embree")]
    pub(crate) fn at_least(&mut self, value: f64, limit: f64) -> String {
        self.judge(value >= limit, limit)
    }

    /// Returns a text on whether `value` lies from `low` to `high`.
    pub(crate) fn between(&mut self, value: f64, low: f64, high: f64) -> String {
        self.judge((low..=high).contains(&value), format!("{low} to {high}"))
    }

    /// Returns a text on whether a value is within `limit`, which the caller has found out.
    pub(crate) fn judge(&mut self, is_within: bool, limit: impl Display) -> String {
        self.is_any_missed |= !is_within;
        let verdict = if is_within { "within" } else { "MISSES" };
        format!("{verdict} the limit of {limit}")
    }

    /// Returns whether any value has missed its limit.
    pub(crate) fn is_any_missed(&self) -> bool {
        self.is_any_missed
    }
}
