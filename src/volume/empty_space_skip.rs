//! Empty-space skipping: finds the next steps of a march that may be non-empty, sixteen at a time.

use std::ops::Range;

use multiversion::multiversion;

use super::sample_batch::{PendingBatch, VolumeSegment, points};
use super::steps::Steps;
use crate::numeric::{LANES, Lanes};

/// Treatment of empty space: skipped or sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SkipEmpty {
    /// Empty-space skipping with the macrocells.
    #[default]
    Leap,
    /// Every sample is taken: the reference for tests.
    Never,
}

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
    /// Classifies the steps from `i` on, which lies before `end`, along a ray through all of `segments`.
    #[inline(always)]
    pub(super) fn new(
        segments: &[VolumeSegment],
        skip: SkipEmpty,
        steps: &Steps,
        i: u64,
        end: u64,
    ) -> StepWindow {
        // Compute the next sixteen steps
        let [t, length] = steps.lanes(i);
        let count = (end - i).min(LANES as u64);
        let mut window = StepWindow {
            t,
            length,
            wanted: count as usize,
            next: i + count,
        };
        if skip == SkipEmpty::Never {
            return window;
        }
        // Use no closures: one that is not inlined would be compiled for the lowest instruction set.
        // Mark steps in non-empty cells of any volume
        let mut occupancy = 0;
        for segment in segments {
            occupancy |= segment.volume.empty.occupancy(&points(&segment.ray, &t));
        }
        occupancy &= u16::MAX >> (LANES as u64 - count);
        // Trim empty steps at both ends only: removing those in between costs more than sampling them.
        let beyond = LANES - occupancy.leading_zeros() as usize;
        // Skip ahead through empty blocks if the window ends in empty space
        if beyond < LANES && window.next < end {
            window.next = skip_ahead(segments, steps, t[LANES - 1]).clamp(window.next, end);
        }
        let first = beyond.min(occupancy.trailing_zeros() as usize);
        [window.t, window.length] = steps.lanes(i + first as u64);
        window.wanted = beyond - first;
        window
    }
}

/// Returns the range of steps outside which all volumes are empty.
#[inline(always)]
pub(super) fn range(segments: &[VolumeSegment], skip: SkipEmpty, steps: &Steps) -> Range<u64> {
    if skip == SkipEmpty::Never {
        return 0..steps.count;
    }
    // Unite the intervals of the volumes' non-empty boxes
    let (mut start, mut end) = (f64::INFINITY, f64::NEG_INFINITY);
    for segment in segments {
        let [from, to] = segment.volume.empty.span(&segment.ray);
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

/// Returns the index of the step up to which all of `segments` are empty from `t` on.
#[inline(always)]
fn skip_ahead(segments: &[VolumeSegment], steps: &Steps, t: f64) -> u64 {
    let mut until = f64::INFINITY;
    for segment in segments {
        let skip_ahead = segment.volume.empty.skip_ahead(&segment.ray, t);
        until = if skip_ahead < until { skip_ahead } else { until };
    }
    // Step back by one: a whole step is a margin much larger than any rounding error.
    steps.last_before(until)
}

/// Fills `pending` with the steps of `range` that may be non-empty, until it holds a batch; their lengths are
/// multiplied by `unit` to get world units. Returns the step to continue from.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma",
    "x86_64+sse4.2"
))]
pub(super) fn fill(
    segments: &[VolumeSegment],
    skip: SkipEmpty,
    (steps, unit): (&Steps, f64),
    range: Range<u64>,
    pending: &mut PendingBatch,
) -> u64 {
    let mut i = range.start;
    while i < range.end && pending.filled < LANES {
        // Find the non-empty steps of the next window
        let mut window = StepWindow::new(segments, skip, steps, i, range.end);
        // Convert lengths to world units
        for l in 0..LANES {
            window.length[l] *= unit;
        }
        pending.push(&window.t, &window.length, window.wanted);
        i = window.next;
    }
    i
}
