//! Which of the next steps of a march may have matter in them: sixteen are looked at together.

use std::ops::Range;

use multiversion::multiversion;

use super::SkipEmpty;
use super::sample_batch::{PendingBatch, VolumeSegment, places};
use super::steps::Steps;
use crate::numeric::{LANES, Lanes};

/// Up to sixteen steps in a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepWindow {
    /// Middles of the steps.
    pub(super) t: Lanes<f64>,
    /// Their lengths, in units of t.
    pub(super) length: Lanes<f64>,
    /// How many of them, from the first on, are to be taken; the others are not of the march, or empty like what lies
    /// before the first.
    pub(super) wanted: usize,
    /// The step to go on from when these are done; what lies between is empty.
    pub(super) next: u64,
}

impl StepWindow {
    /// Looks at the steps from `i` on, which lies before `end`, along a ray through all of `met`.
    #[inline(always)]
    pub(super) fn new(met: &[VolumeSegment], skip: SkipEmpty, steps: &Steps, i: u64, end: u64) -> StepWindow {
        let [t, length] = steps.lanes(i);
        let count = (end - i).min(LANES as u64);
        let mut survey = StepWindow {
            t,
            length,
            wanted: count as usize,
            next: i + count,
        };
        if skip == SkipEmpty::Never {
            return survey;
        }
        // No closures here: one that is not inlined would be compiled for the lowest instruction set.
        let mut matter = 0;
        for met in met {
            matter |= met.volume.empty.matter(&places(&met.ray, &t));
        }
        matter &= u16::MAX >> (LANES as u64 - count);
        // Empty steps between others are taken: to pick out the others costs more.
        let beyond = LANES - matter.leading_zeros() as usize;
        if beyond < LANES && survey.next < end {
            survey.next = leap(met, steps, t[LANES - 1]).clamp(survey.next, end);
        }
        let first = beyond.min(matter.trailing_zeros() as usize);
        [survey.t, survey.length] = steps.lanes(i + first as u64);
        survey.wanted = beyond - first;
        survey
    }
}

/// The steps outside which there is no matter.
#[inline(always)]
pub(super) fn range(met: &[VolumeSegment], skip: SkipEmpty, steps: &Steps) -> Range<u64> {
    if skip == SkipEmpty::Never {
        return 0..steps.count;
    }
    let (mut start, mut end) = (f64::INFINITY, f64::NEG_INFINITY);
    for met in met {
        let [from, to] = met.volume.empty.span(&met.ray);
        if from <= to {
            start = if from < start { from } else { start };
            end = if to > end { to } else { end };
        }
    }
    if !(start <= end) {
        return 0..0;
    }
    steps.around(steps.last_before(start), steps.last_before(end))
}

/// The step up to which there is nothing from `t` on.
#[inline(always)]
fn leap(met: &[VolumeSegment], steps: &Steps, t: f64) -> u64 {
    let mut until = f64::INFINITY;
    for met in met {
        let leap = met.volume.empty.leap(&met.ray, t);
        until = if leap < until { leap } else { until };
    }
    // The step before the last is a whole step away from where it ends: much more than any rounding.
    steps.last_before(until)
}

/// Lets those steps of `range` that may have matter wait, until there is a batch of them; their lengths times `unit`
/// are in world units. Returns the step to go on from.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn fill(
    met: &[VolumeSegment],
    skip: SkipEmpty,
    (steps, unit): (&Steps, f64),
    range: Range<u64>,
    waiting: &mut PendingBatch,
) -> u64 {
    let mut i = range.start;
    while i < range.end && waiting.filled < LANES {
        let mut survey = StepWindow::new(met, skip, steps, i, range.end);
        for l in 0..LANES {
            survey.length[l] *= unit;
        }
        waiting.push(&survey.t, &survey.length, survey.wanted);
        i = survey.next;
    }
    i
}
