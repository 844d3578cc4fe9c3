//! Frame ranges in the notation `24`, `10-20` or `1-24x2`.

use crate::scene_file::forms::forms;

/// Largest number of frames of a job file; more is taken for a typing error.
pub(super) const MAX_FRAMES: usize = 1_000_000;

/// Frame numbers from `first` to `last`, inclusive, with a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct FrameRange {
    pub(super) first: u32,
    pub(super) last: u32,
    pub(super) step: u32,
}

impl FrameRange {
    /// Range of the single frame 1.
    pub(super) const ONE: FrameRange = FrameRange {
        first: 1,
        last: 1,
        step: 1,
    };

    /// Returns the frame numbers in ascending order.
    pub(super) fn numbers(&self) -> impl Iterator<Item = u32> + use<> {
        (self.first..=self.last).step_by(self.step as usize)
    }

    /// Returns the number of frames.
    pub(super) fn count(&self) -> usize {
        ((self.last - self.first) / self.step) as usize + 1
    }

    /// Returns the number of frames that the range would have with a step of 1.
    pub(super) fn span(&self) -> f64 {
        f64::from(self.last - self.first) + 1.0
    }

    fn parse(text: &str) -> Result<FrameRange, String> {
        let form = || "give a number of frames, or a range as in \"1-24\" or \"1-24x2\"".to_owned();
        // Split off the step, then the two ends
        let (range, step) = match text.split_once('x') {
            Some((range, step)) => (range, step.parse().map_err(|_| form())?),
            None => (text, 1),
        };
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let [first, last] = [first, last].map(|number| number.parse::<u32>().map_err(|_| form()));
        FrameRange {
            first: first?,
            last: last?,
            step,
        }
        .checked()
    }

    fn checked(self) -> Result<FrameRange, String> {
        if self.last < self.first || self.step == 0 {
            return Err(
                "has no frames: give a first number that is not larger than the last, and a step of 1 or more"
                    .into(),
            );
        }
        if self.count() > MAX_FRAMES {
            return Err(format!("has more than {MAX_FRAMES} frames: split the file"));
        }
        Ok(self)
    }
}

forms! {
    ['de] FrameRange, "a number of frames or a range as in \"1-24\"";
    integer count => FrameRange {
        last: u32::try_from(count).unwrap_or(0),
        ..FrameRange::ONE
    }
    .checked()
    .map_err(E::custom);
    text text => FrameRange::parse(text).map_err(E::custom);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_parsed_with_their_steps() {
        let numbers = |text| FrameRange::parse(text).map(|range| range.numbers().collect::<Vec<_>>());
        assert_eq!(numbers("3"), Ok(vec![3]));
        assert_eq!(numbers("0-3"), Ok(vec![0, 1, 2, 3]));
        assert_eq!(numbers("1-8x3"), Ok(vec![1, 4, 7]));
        let widest = FrameRange::parse("0-4294967295x1000000").unwrap();
        // 4294 steps of a million fit, and the whole range is 2^32 frames.
        assert_eq!((widest.count(), widest.span()), (4295, 4_294_967_296.0));
        for bad in ["", "a", "3-1", "1-3x0", "-1", "1-", "1-4294967295"] {
            assert!(numbers(bad).is_err(), "{bad}");
        }
    }
}
