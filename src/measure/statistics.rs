//! Medians, means and their 95 % confidence intervals, by order statistics and the bootstrap (B. Efron, R. Tibshirani,
//! "An Introduction to the Bootstrap", 1993).

use serde::{Deserialize, Serialize};

use crate::numeric::SplitMix64;

/// Number of bootstrap resamples.
const RESAMPLES: usize = 2000;
/// Tail probability on either side of a 95 % interval.
const TAIL: f64 = 0.025;

/// Measured value with an interval, which is a 95 % confidence interval unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Measured or estimated value.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Interval {
    /// Returns an interval of zero width, for a value without uncertainty.
    pub fn exact(value: f64) -> Interval {
        Interval {
            value,
            low: value,
            high: value,
        }
    }

    /// Returns the median with its confidence interval; NaN for no values.
    ///
    /// The ends are order statistics, which enclose the true median with 95 % probability for any distribution. With
    /// fewer than six values none do, and the ends are the extremes.
    pub fn of_median(values: &[f64]) -> Interval {
        Interval::of_ranks(values, skipped_ranks(values.len()))
    }

    /// Returns the median with the smallest and the largest value as ends; NaN for no values.
    pub fn of_extremes(values: &[f64]) -> Interval {
        Interval::of_ranks(values, 0)
    }

    /// Returns the median between the values that are left after dropping `skipped` at either end.
    fn of_ranks(values: &[f64], skipped: usize) -> Interval {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        // Of an even number of values, take the mean of the two in the middle
        let middle = sorted.len() / 2;
        let value = match sorted.len() % 2 {
            _ if sorted.is_empty() => f64::NAN,
            1 => sorted[middle],
            _ => 0.5 * (sorted[middle - 1] + sorted[middle]),
        };
        match sorted.get(skipped..sorted.len() - skipped) {
            Some([low, .., high]) => Interval {
                value,
                low: *low,
                high: *high,
            },
            _ => Interval::exact(value),
        }
    }

    /// Applies `f` to the value and to both ends; `f` must be non-decreasing.
    pub fn map(self, f: impl Fn(f64) -> f64) -> Interval {
        Interval {
            value: f(self.value),
            low: f(self.low),
            high: f(self.high),
        }
    }

    /// Returns whether the interval contains `value`.
    pub fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// Returns the median, or the mean of the two middle values for an even count; NaN for no values.
pub(super) fn median(values: &[f64]) -> f64 {
    Interval::of_extremes(values).value
}

/// Returns the number of values that can be dropped at either end of `count` sorted values so that the rest enclose the
/// true median with 95 % probability: the sum of binomial weights on either side is at most 1/40.
fn skipped_ranks(count: usize) -> usize {
    let mut weight = 0.5f64.powi(count.min(1000) as i32);
    let mut sum = 0.0;
    // Add binomial weights from the end until they exceed the tail probability
    for skipped in 0..count / 2 {
        sum += weight;
        if sum > TAIL {
            return skipped.saturating_sub(1);
        }
        weight *= (count - skipped) as f64 / (skipped + 1) as f64;
    }
    (count / 2).saturating_sub(1)
}

/// Returns `statistic` of the indices 0, ..., `count` - 1 with its bootstrap interval.
///
/// `statistic` receives `count` indices, which may repeat. The resamples depend on `seed` alone.
pub fn bootstrap(count: usize, seed: u64, statistic: impl Fn(&[usize]) -> f64) -> Interval {
    let mut chosen: Vec<usize> = (0..count).collect();
    let value = statistic(&chosen);
    // Evaluate the statistic on resamples with replacement
    let mut random = SplitMix64::new(seed, count as u64);
    let mut draws: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            chosen.iter_mut().for_each(|place| *place = random.below(count));
            statistic(&chosen)
        })
        .collect();
    // Take quantiles of the resampled values
    draws.sort_by(f64::total_cmp);
    let at = |part: f64| draws[((RESAMPLES - 1) as f64 * part).round() as usize];
    Interval {
        value,
        low: at(TAIL),
        high: at(1.0 - TAIL),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_the_middle_value() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn extremes_are_the_smallest_and_the_largest_value() {
        let of = Interval::of_extremes(&[4.0, 1.0, 2.0, 9.0]);
        assert_eq!((of.value, of.low, of.high), (3.0, 1.0, 9.0));
        assert_eq!(Interval::of_extremes(&[2.0]), Interval::exact(2.0));
        assert!(Interval::of_extremes(&[]).value.is_nan());
    }

    #[test]
    fn order_statistics_match_published_tables() {
        // The extremes of 6 values enclose the median with 96.9 %; of 20 values the 6th and 15th do with 95.9 %, by
        // tables of the sign test.
        let skipped: Vec<usize> = [5, 6, 8, 9, 10, 12, 15, 20, 25, 50].map(skipped_ranks).into();
        assert_eq!(skipped, [0, 0, 0, 1, 1, 2, 3, 5, 7, 17]);
    }

    #[test]
    fn median_interval_contains_the_median_in_95_percent() {
        for count in [6, 11, 30] {
            let held = (0..2000)
                .filter(|&sample| {
                    let mut random = SplitMix64::new(7, sample * 100 + count);
                    // Squares of uniform numbers are skewed, and their median is 1/4.
                    let values: Vec<f64> = (0..count).map(|_| random.unit().powi(2)).collect();
                    Interval::of_median(&values).holds(0.25)
                })
                .count();
            assert!(held >= 1880, "{count} values: {held} of 2000");
        }
    }

    #[test]
    fn bootstrap_interval_contains_the_mean_in_about_95_percent() {
        let held = (0..400)
            .filter(|&sample| {
                let mut random = SplitMix64::new(8, sample);
                let values: Vec<f64> = (0..60).map(|_| random.unit()).collect();
                let of = |places: &[usize]| places.iter().map(|&i| values[i]).sum::<f64>() / 60.0;
                bootstrap(values.len(), sample, of).holds(0.5)
            })
            .count();
        assert!((365..=398).contains(&held), "{held} of 400");
    }
}
