//! Ray-marching steps: the i-th begins at start + i · size, never at a running sum, and the last ends at the end of the
//! segment.
//!
//! Each step is sampled at its middle. A running sum of sizes in f32 is off by 0.9 % after a million steps; the product
//! is within 1 ulp at any step.

use std::ops::Range;

use crate::numeric::{LANES, Lanes};

/// Segment of a ray, divided into steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Steps {
    start: f64,
    size: f64,
    /// Number of steps, at least one.
    pub(super) count: u64,
    /// Middle and length of the last step.
    last: [f64; 2],
}

/// Error bound of a parameter on the ray, and of each operation on lengths: twice the error of one rounding.
const SLACK: f64 = f64::EPSILON;

impl Steps {
    /// Divides `start` to `end` into steps of `size`; all finite, `end` beyond `start`, `size` positive.
    #[inline(always)]
    pub(super) fn new(start: f64, end: f64, size: f64) -> Steps {
        Steps::of_cut(start, size, Steps::cut(start, end, size))
    }

    /// Returns the number of steps that [`Steps::new`] makes, and the middle and the length of the last.
    ///
    /// A length that is a whole number of steps up to rounding gets no sliver of a step at the end.
    #[inline(always)]
    pub(super) fn cut(start: f64, end: f64, size: f64) -> [f64; 3] {
        // Shorten the length by its error bound before rounding up
        let length = (end - start) * (1.0 - 2.0 * SLACK) - SLACK * (start.abs() + end.abs());
        let count = (length / size).ceil();
        let count = if count > 1.0 { count } else { 1.0 };
        // Place the last step, which ends where the segment does
        let begin = start + (count - 1.0) * size;
        [count, 0.5 * (begin + end), end - begin]
    }

    /// Builds the steps from the result of [`Steps::cut`].
    #[inline(always)]
    pub(super) fn of_cut(start: f64, size: f64, [count, middle, length]: [f64; 3]) -> Steps {
        Steps {
            start,
            size,
            // The conversion saturates, far beyond any feasible number of steps.
            count: count as u64,
            last: [middle, length],
        }
    }

    /// Returns the middles and lengths of steps `i` to `i + 15`. Values beyond the last step have no meaning.
    #[inline(always)]
    pub(super) fn lanes(&self, i: u64) -> [Lanes<f64>; 2] {
        let first = i as f64;
        let last = (self.count - 1) as f64;
        let [last_middle, last_length] = self.last;
        let mut middle = [0.0; LANES];
        let mut length = [0.0; LANES];
        for l in 0..LANES {
            let i = first + l as f64;
            let here = self.start + (i + 0.5) * self.size;
            middle[l] = if i == last { last_middle } else { here };
            length[l] = if i == last { last_length } else { self.size };
        }
        [middle, length]
    }

    /// Returns the last step whose middle is not beyond `t`, up to rounding; 0 before the first.
    #[inline(always)]
    pub(super) fn last_before(&self, t: f64) -> u64 {
        // A negative quotient becomes 0.
        Steps::number(self.start, self.size, t) as u64
    }

    /// Returns the real-valued index of the step whose middle is at `t`, in steps of `size` from `start` on.
    #[inline(always)]
    pub(super) fn number(start: f64, size: f64, t: f64) -> f64 {
        (t - start) / size - 0.5
    }

    /// Returns the steps from `first` to `last`, extended by one at either end: a margin much larger than any rounding
    /// error.
    #[inline(always)]
    pub(super) fn around(&self, first: u64, last: u64) -> Range<u64> {
        let end = last.saturating_add(2).min(self.count);
        first.min(end)..end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_count_tolerates_rounding() {
        for count in [1u32, 3, 7, 10, 1000, 1_000_000] {
            let size = 1.0 / f64::from(count);
            for end in [1.0f64.next_down(), 1.0, 1.0f64.next_up()] {
                assert_eq!(
                    Steps::new(0.0, end, size).count,
                    u64::from(count),
                    "{count} {end}"
                );
            }
        }
        assert_eq!(Steps::new(0.0, 1.0, 0.3).count, 4);
        assert_eq!(Steps::new(0.0, 1.0, 5.0).count, 1);
    }

    #[test]
    fn step_lengths_sum_to_the_interval_and_midpoints_lie_inside() {
        for (start, end, size) in [(0.0, 1.0, 0.3), (100.0, 101.7, 0.1), (-3.0, 5.0, 9.0)] {
            let steps = Steps::new(start, end, size);
            let mut at = start;
            for i in 0..steps.count {
                let [[middle, ..], [length, ..]] = steps.lanes(i);
                assert!(length > 0.0 && length <= size + 8.0 * f64::EPSILON * end.abs());
                assert!((middle - (at + 0.5 * length)).abs() <= 8.0 * f64::EPSILON * end.abs());
                at += length;
            }
            assert!((at - end).abs() <= 64.0 * f64::EPSILON * end.abs());
        }
    }

    #[test]
    fn sixteen_lane_steps_match_single_steps() {
        for count in [1u32, 5, 16, 17, 100] {
            let (start, end, size) = (0.1, 0.1 + f64::from(count) / 7.0 - 0.03, 1.0 / 7.0);
            let steps = Steps::new(start, end, size);
            assert_eq!(steps.count, u64::from(count));
            for i in 0..steps.count {
                let [middle, length] = steps.lanes(i);
                for l in 0..(steps.count - i).min(LANES as u64) {
                    let number = (i + l) as f64;
                    let begin = start + number * size;
                    let expected = if i + l + 1 == steps.count {
                        [0.5 * (begin + end), end - begin]
                    } else {
                        [start + (number + 0.5) * size, size]
                    };
                    assert_eq!([middle[l as usize], length[l as usize]], expected);
                }
            }
        }
    }

    #[test]
    fn last_step_before_a_point_has_its_midpoint_at_or_before_it() {
        let steps = Steps::new(2.0, 12.0, 1.0);
        // Middles at 2.5, 3.5, ...
        for (t, last) in [
            (-1.0, 0),
            (2.4, 0),
            (2.5, 0),
            (3.4, 0),
            (3.5, 1),
            (7.0, 4),
            (1e300, u64::MAX),
        ] {
            assert_eq!(steps.last_before(t), last, "{t}");
        }
    }
}
