//! Empty-space skipping: finds the next steps of a march that may be non-empty, sixteen at a time.

use std::ops::Range;

use multiversion::multiversion;

use super::SkipEmpty;
use super::sample_batch::{PendingBatch, VolumeSegment, places};
use super::steps::Steps;
use crate::numeric::{LANES, Lanes};

/// Window of up to sixteen consecutive steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepWindow {
    /// Ray parameters of the steps' middles.
    pub(super) t: Lanes<f64>,
    /// Lengths of the steps, in units of t.
    pub(super) length: Lanes<f64>,
    /// Number of steps, from the first on, to be sampled; the others are beyond the march's end or empty, as are the
    /// skipped steps before the first.
    pub(super) wanted: usize,
    /// Index of the step to continue from afterwards; the steps in between are empty.
    pub(super) next: u64,
}

impl StepWindow {
    /// Classifies the steps from `i` on, which lies before `end`, along a ray through all of `met`.
    #[inline(always)]
    pub(super) fn new(met: &[VolumeSegment], skip: SkipEmpty, steps: &Steps, i: u64, end: u64) -> StepWindow {
        // Compute the next sixteen steps
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
        // Use no closures: one that is not inlined would be compiled for the lowest instruction set.
        // Mark steps in non-empty cells of any volume
        let mut matter = 0;
        for met in met {
            matter |= met.volume.empty.matter(&places(&met.ray, &t));
        }
        matter &= u16::MAX >> (LANES as u64 - count);
        // Trim empty steps at both ends only: removing those in between costs more than sampling them.
        let beyond = LANES - matter.leading_zeros() as usize;
        // Skip ahead through empty blocks if the window ends in empty space
        if beyond < LANES && survey.next < end {
            survey.next = leap(met, steps, t[LANES - 1]).clamp(survey.next, end);
        }
        let first = beyond.min(matter.trailing_zeros() as usize);
        [survey.t, survey.length] = steps.lanes(i + first as u64);
        survey.wanted = beyond - first;
        survey
    }
}

/// Returns the range of steps outside which all volumes are empty.
#[inline(always)]
pub(super) fn range(met: &[VolumeSegment], skip: SkipEmpty, steps: &Steps) -> Range<u64> {
    if skip == SkipEmpty::Never {
        return 0..steps.count;
    }
    // Unite the intervals of the volumes' non-empty boxes
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

/// Returns the index of the step up to which all of `met` are empty from `t` on.
#[inline(always)]
fn leap(met: &[VolumeSegment], steps: &Steps, t: f64) -> u64 {
    let mut until = f64::INFINITY;
    for met in met {
        let leap = met.volume.empty.leap(&met.ray, t);
        until = if leap < until { leap } else { until };
    }
    // Step back by one: a whole step is a margin much larger than any rounding error.
    steps.last_before(until)
}

/// Fills `waiting` with the steps of `range` that may be non-empty, until it holds a batch; their lengths are
/// multiplied by `unit` to get world units. Returns the step to continue from.
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
        // Find the non-empty steps of the next window
        let mut survey = StepWindow::new(met, skip, steps, i, range.end);
        // Convert lengths to world units
        for l in 0..LANES {
            survey.length[l] *= unit;
        }
        waiting.push(&survey.t, &survey.length, survey.wanted);
        i = survey.next;
    }
    i
}
