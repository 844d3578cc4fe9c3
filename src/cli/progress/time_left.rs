//! Estimates of the remaining time of a phase or of a whole batch.

use std::collections::VecDeque;

/// Number of most recent frame durations that are averaged, so that the estimate follows changes within a batch.
const MAX_DURATIONS: usize = 64;

/// Returns the remaining seconds of work that has taken `seconds` up to `fraction`; `None` if they cannot be estimated.
pub(in crate::cli) fn remaining_seconds(fraction: f64, seconds: f64) -> Option<f64> {
    let left = seconds * (1.0 - fraction) / fraction;
    (fraction > 0.0 && left.is_finite()).then_some(left.max(0.0))
}

/// Progress of a frame that is being rendered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Running {
    /// Finished part of the frame, 0 to 1.
    pub(super) fraction: f64,
    /// Seconds that the finished part took.
    pub(super) seconds: f64,
}

/// Durations of the most recent finished frames in seconds.
#[derive(Debug, Default)]
pub(super) struct Durations(VecDeque<f64>);

impl Durations {
    /// Adds the duration of a finished frame.
    pub(super) fn note(&mut self, seconds: f64) {
        if self.0.len() == MAX_DURATIONS {
            self.0.pop_front();
        }
        self.0.push_back(seconds);
    }

    /// Returns the typical duration of a frame: the mean without the shortest and the longest eighth, so that no
    /// outlier, such as the first frame, which loads everything, dominates.
    fn typical(&self) -> Option<f64> {
        let mut all: Vec<f64> = self.0.iter().copied().collect();
        all.sort_by(f64::total_cmp);
        // Of two durations, the longer may be the outlier; of three and more, both ends are cut.
        let cut = if all.len() < 3 { 0 } else { (all.len() / 8).max(1) };
        let middle = &all[cut..all.len() - cut];
        (!middle.is_empty()).then(|| middle.iter().sum::<f64>() / middle.len() as f64)
    }

    /// Returns the seconds until the `running` frames and `waiting` more are finished, if as many run concurrently as
    /// now.
    ///
    /// The estimate for a running frame weights its own progress by the finished fraction.
    pub(super) fn left(&self, running: &[Running], waiting: usize) -> Option<f64> {
        let of_running = |frame: &Running| -> Option<f64> {
            let Running { fraction, seconds } = *frame;
            let whole = match self.typical() {
                // The weighted mean of both estimates: (1 - f) typical + f (seconds / f).
                Some(typical) => (1.0 - fraction) * typical + seconds,
                None => seconds + remaining_seconds(fraction, seconds)?,
            };
            Some((1.0 - fraction) * whole)
        };
        let all: Vec<f64> = running.iter().filter_map(of_running).collect();
        let typical = self.typical().or_else(|| {
            // Before any frame is finished, the estimates of the running frames replace the typical duration.
            let wholes = running.iter().zip(&all).map(|(frame, left)| frame.seconds + left);
            let sum: f64 = wholes.sum();
            (!all.is_empty()).then(|| sum / all.len() as f64)
        });
        // At the end, the slowest running frame decides; before, the work is shared among the lanes
        if waiting == 0 {
            return match running {
                [] => Some(0.0),
                _ => all.iter().copied().reduce(f64::max),
            };
        }
        // As many frames run concurrently as now
        let lanes = running.len().max(1) as f64;
        Some((all.iter().sum::<f64>() + waiting as f64 * typical?) / lanes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn durations(all: &[f64]) -> Durations {
        let mut durations = Durations::default();
        all.iter().for_each(|&seconds| durations.note(seconds));
        durations
    }

    const HALF: Running = Running {
        fraction: 0.5,
        seconds: 3.0,
    };

    #[test]
    fn remaining_time_of_a_phase_is_extrapolated_linearly() {
        assert_eq!(remaining_seconds(0.25, 2.0), Some(6.0));
        assert_eq!(remaining_seconds(1.0, 2.0), Some(0.0));
        assert_eq!(remaining_seconds(0.0, 2.0), None);
        assert_eq!(remaining_seconds(f64::NAN, 2.0), None);
    }

    #[test]
    fn outlier_durations_are_ignored() {
        assert_eq!(durations(&[4.0, 900.0, 4.0, 4.0]).left(&[], 3), Some(12.0));
        assert_eq!(durations(&[4.0, 6.0]).left(&[], 2), Some(10.0));
    }

    #[test]
    fn concurrent_frames_divide_the_remaining_time() {
        // Whole frame: half of 4 and 3 seconds so far, 5; half of that is left of each, and 4 for each of 6 that wait.
        let left = durations(&[4.0]).left(&[HALF, HALF], 6);
        assert_eq!(left, Some((2.0 * 2.5 + 6.0 * 4.0) / 2.0));
    }

    #[test]
    fn slowest_frame_determines_the_remaining_time_at_the_end() {
        let slow = Running {
            fraction: 0.5,
            seconds: 8.0,
        };
        // The slow frame takes 0.5 * 4 + 8 = 10 seconds, of which half is left.
        assert_eq!(durations(&[4.0]).left(&[HALF, slow], 0), Some(5.0));
        assert_eq!(durations(&[4.0]).left(&[], 0), Some(0.0));
    }

    #[test]
    fn running_frames_give_the_estimate_before_any_is_finished() {
        // 3 seconds are left of the running frame, and 6 for each of the others.
        assert_eq!(Durations::default().left(&[HALF], 2), Some(15.0));
        let begun = Running {
            fraction: 0.0,
            seconds: 1.0,
        };
        assert_eq!(Durations::default().left(&[begun], 2), None);
        assert_eq!(Durations::default().left(&[], 2), None);
    }

    #[test]
    fn estimate_follows_increasing_durations() {
        let growing: Vec<f64> = (0..1000).map(f64::from).collect();
        let left = durations(&growing).left(&[], 1).unwrap();
        assert!((936.0..1000.0).contains(&left), "{left}");
    }
}
