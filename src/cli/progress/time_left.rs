//! How long a phase or a whole batch will still take.

use std::collections::VecDeque;

/// Durations of frames that are looked at: as many as tell what frames take now, later in a batch too.
const MAX_DURATIONS: usize = 64;

/// Seconds that are left of what has taken `seconds` up to `fraction` of it; `None` where that cannot be told.
pub(in crate::cli) fn of_phase(fraction: f64, seconds: f64) -> Option<f64> {
    let left = seconds * (1.0 - fraction) / fraction;
    (fraction > 0.0 && left.is_finite()).then_some(left.max(0.0))
}

/// A frame in the making.
#[derive(Clone, Copy, Debug)]
pub(super) struct Running {
    /// How much of it is finished, 0 to 1.
    pub(super) fraction: f64,
    /// How long that took.
    pub(super) seconds: f64,
}

/// What finished frames tell of the others.
#[derive(Debug, Default)]
pub(super) struct Durations(VecDeque<f64>);

impl Durations {
    /// Notes how long a frame took.
    pub(super) fn note(&mut self, seconds: f64) {
        if self.0.len() == MAX_DURATIONS {
            self.0.pop_front();
        }
        self.0.push_back(seconds);
    }

    /// What a frame takes: the mean without the shortest and the longest eighth, so that no odd one, such as the first
    /// that loads everything, counts for many.
    fn typical(&self) -> Option<f64> {
        let mut all: Vec<f64> = self.0.iter().copied().collect();
        all.sort_by(f64::total_cmp);
        // Of two, the longer may be the odd one; of three and more, the ends are.
        let cut = if all.len() < 3 { 0 } else { (all.len() / 8).max(1) };
        let middle = &all[cut..all.len() - cut];
        (!middle.is_empty()).then(|| middle.iter().sum::<f64>() / middle.len() as f64)
    }

    /// Seconds until all are finished: those that run and `waiting` more, if as many go on at once as now.
    ///
    /// A frame's own progress is believed the more, the farther it is.
    pub(super) fn left(&self, running: &[Running], waiting: usize) -> Option<f64> {
        let of_running = |frame: &Running| -> Option<f64> {
            let Running { fraction, seconds } = *frame;
            let whole = match self.typical() {
                // (1 - f) typical + f (seconds / f)
                Some(typical) => (1.0 - fraction) * typical + seconds,
                None => seconds + of_phase(fraction, seconds)?,
            };
            Some((1.0 - fraction) * whole)
        };
        let all: Vec<f64> = running.iter().filter_map(of_running).collect();
        let typical = self.typical().or_else(|| {
            // All that is known is what runs.
            let wholes = running.iter().zip(&all).map(|(frame, left)| frame.seconds + left);
            let sum: f64 = wholes.sum();
            (!all.is_empty()).then(|| sum / all.len() as f64)
        });
        if waiting == 0 {
            return match running {
                [] => Some(0.0),
                _ => all.iter().copied().reduce(f64::max),
            };
        }
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
    fn a_phase_takes_as_long_as_its_first_part_says() {
        assert_eq!(of_phase(0.25, 2.0), Some(6.0));
        assert_eq!(of_phase(1.0, 2.0), Some(0.0));
        assert_eq!(of_phase(0.0, 2.0), None);
        assert_eq!(of_phase(f64::NAN, 2.0), None);
    }

    #[test]
    fn one_odd_frame_does_not_count() {
        assert_eq!(durations(&[4.0, 900.0, 4.0, 4.0]).left(&[], 3), Some(12.0));
        assert_eq!(durations(&[4.0, 6.0]).left(&[], 2), Some(10.0));
    }

    #[test]
    fn frames_at_once_share_what_is_left() {
        // Whole: half of 4 and 3 seconds so far, 5; half of that is left of each, and 4 for each of 6 that wait.
        let left = durations(&[4.0]).left(&[HALF, HALF], 6);
        assert_eq!(left, Some((2.0 * 2.5 + 6.0 * 4.0) / 2.0));
    }

    #[test]
    fn the_last_frames_take_as_long_as_the_longest_of_them() {
        let slow = Running {
            fraction: 0.5,
            seconds: 8.0,
        };
        // (half of 4 and 8) times half.
        assert_eq!(durations(&[4.0]).left(&[HALF, slow], 0), Some(5.0));
        assert_eq!(durations(&[4.0]).left(&[], 0), Some(0.0));
    }

    #[test]
    fn before_any_frame_is_finished_the_running_ones_tell() {
        // 3 seconds are left of it, and 6 for each of the others.
        assert_eq!(Durations::default().left(&[HALF], 2), Some(15.0));
        let begun = Running {
            fraction: 0.0,
            seconds: 1.0,
        };
        assert_eq!(Durations::default().left(&[begun], 2), None);
        assert_eq!(Durations::default().left(&[], 2), None);
    }

    #[test]
    fn frames_that_take_longer_and_longer_are_followed() {
        let growing: Vec<f64> = (0..1000).map(f64::from).collect();
        let left = durations(&growing).left(&[], 1).unwrap();
        assert!((936.0..1000.0).contains(&left), "{left}");
    }
}
