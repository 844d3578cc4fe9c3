//! Progress of an adaptively sampled image in samples: those taken, and those that pixels will probably still need by
//! their current errors.

use std::sync::atomic::{AtomicU64, Ordering};

use super::super::tile::PixelVisit;
use super::state::SamplingState;
use super::target::ROUND;

/// Numbers of samples taken and samples expected.
#[derive(Debug, Default)]
pub(super) struct AdaptiveProgress {
    /// Samples before the current round, or before it was resumed.
    taken: u64,
    /// Samples in the round since then.
    finished: AtomicU64,
    /// Expected final number of samples.
    all: u64,
    /// Bits of the largest fraction so far, which are ordered like the fractions: progress does not decrease if the
    /// expected number rises.
    greatest: AtomicU64,
}

impl AdaptiveProgress {
    /// Begins a round in which `left` are still to be visited.
    pub(super) fn begin_round<'v>(
        &mut self,
        state: &SamplingState,
        left: impl Iterator<Item = &'v PixelVisit>,
    ) {
        self.taken = state.taken();
        *self.finished.get_mut() = 0;
        let in_round = self.taken + left.map(samples).sum::<u64>();
        // Before any error is known, half of the work is assumed to be done after the round.
        self.all = in_round + state.likely_later().unwrap_or(in_round);
    }

    /// Returns the finished fraction, including `visits` of the round.
    pub(super) fn finish(&self, visits: &[PixelVisit]) -> f64 {
        let new: u64 = visits.iter().map(samples).sum();
        let done = self.taken + self.finished.fetch_add(new, Ordering::Relaxed) + new;
        let fraction = (done as f64 / self.all.max(1) as f64).min(1.0);
        let before = self.greatest.fetch_max(fraction.to_bits(), Ordering::Relaxed);
        fraction.max(f64::from_bits(before))
    }
}

fn samples(visit: &PixelVisit) -> u64 {
    u64::from(ROUND) * visit.groups.len() as u64
}

#[cfg(test)]
mod tests {
    use super::super::super::film::estimate;
    use super::super::super::subset::{Patch, PatchAtlas};
    use super::super::super::tile::tiles;
    use super::super::target::Adaptive;
    use super::*;

    #[test]
    fn progress_includes_expected_samples_and_never_falls() {
        let canvas = PatchAtlas {
            size: [2, 1],
            sites: tiles(2, 1)
                .into_iter()
                .map(|tile| Patch { tile, at: [0, 0] })
                .collect(),
        };
        let target = Adaptive {
            error: 1e-2,
            gain: 1.0,
        };
        let mut state = SamplingState::new(target, &canvas, 64);
        let mut progress = AdaptiveProgress::default();
        let visit = |x: u32, groups: std::ops::Range<u32>| PixelVisit { x, y: 0, groups };
        let first = [visit(0, 0..1), visit(1, 0..1)];
        progress.begin_round(&state, first.iter());
        assert_eq!(progress.finish(&first[..1]), 0.25);
        assert_eq!(progress.finish(&first[1..]), 0.5);
        // One pixel is certain, the other has the largest variance: it will need all of the 64 samples.
        let uncertain: Vec<f64> = (0..16).map(|sample| f64::from(sample % 2)).collect();
        state.merge(
            canvas.sites[0],
            &first,
            &[estimate(&[0.5; 16]), estimate(&uncertain)],
        );
        state.end_round();
        assert!(state.decide());
        assert_eq!(state.likely_later(), Some(32));
        // Both are doubled, because they are neighbours: 64 of 96 samples.
        let second = state.visits(&canvas.sites).remove(0).1;
        progress.begin_round(&state, second.iter());
        assert_eq!(progress.finish(&second), 64.0 / 96.0);
        // Image that turns out to need many more samples.
        progress.all = 1 << 20;
        assert_eq!(progress.finish(&[]), 64.0 / 96.0);
    }
}
