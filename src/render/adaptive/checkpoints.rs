//! Checkpoints of adaptive sampling: when the state is stored, and by which callback.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::rounds::Rounds;

/// Number of tiles per thread that are visited first, to measure how long others will take.
const FIRST_TILES: usize = 8;

/// Access to stored states of a render, which may end at any time and be resumed to the same bits.
pub struct Checkpoints<'a> {
    /// State of an earlier render of the image; `None` starts from the beginning. A state that cannot belong to the
    /// image is ignored.
    pub start: Option<Rounds>,
    /// Largest amount of work in seconds that may be lost.
    pub seconds: f64,
    /// Callback that stores the state about this often, and when the render is cancelled. `Break` ends the render as
    /// cancelled.
    pub keep: &'a mut dyn FnMut(&Rounds) -> ControlFlow<()>,
}

/// Number of tiles between two decisions about storing the state.
pub(super) struct Pace<'c, 'a> {
    checkpoints: Option<&'c mut Checkpoints<'a>>,
    tile_count: usize,
    kept_at: Instant,
    /// True if there are results that are not stored yet.
    has_unsaved: bool,
}

impl<'c, 'a> Pace<'c, 'a> {
    pub(super) fn new(checkpoints: Option<&'c mut Checkpoints<'a>>) -> Pace<'c, 'a> {
        let tile_count = match checkpoints {
            Some(_) => FIRST_TILES * rayon::current_num_threads(),
            None => usize::MAX,
        };
        Pace {
            checkpoints,
            tile_count,
            kept_at: Instant::now(),
            has_unsaved: false,
        }
    }

    /// Returns the number of tiles to be visited next.
    pub(super) fn tile_count(&self) -> usize {
        self.tile_count
    }

    /// Records the time that tiles took, and adapts the number of tiles to it.
    pub(super) fn record_time(&mut self, tile_count: usize, time: Duration) {
        self.has_unsaved = true;
        if let Some(checkpoints) = &self.checkpoints {
            let of_tile = (time.as_secs_f64() / tile_count as f64).max(f64::MIN_POSITIVE);
            // At most half of the work that may be lost is then in progress.
            let fitting = (0.5 * checkpoints.seconds / of_tile) as usize;
            self.tile_count = fitting.max(rayon::current_num_threads());
        }
    }

    /// Returns whether the state is due to be stored.
    pub(super) fn is_due(&self) -> bool {
        let is_due = |checkpoints: &&mut Checkpoints| {
            self.kept_at.elapsed().as_secs_f64() >= 0.5 * checkpoints.seconds
        };
        self.checkpoints.as_ref().is_some_and(is_due)
    }

    /// Stores the state, if it has changed and there is a callback.
    pub(super) fn keep(&mut self, known: &Rounds) -> ControlFlow<()> {
        // Do not store an unchanged state
        if !std::mem::take(&mut self.has_unsaved) {
            return ControlFlow::Continue(());
        }
        let kept = self
            .checkpoints
            .as_mut()
            .map_or(ControlFlow::Continue(()), |checkpoints| (checkpoints.keep)(known));
        self.kept_at = Instant::now();
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn next_tile_count_fills_half_of_the_interval() {
        let mut keep = |_: &Rounds| ControlFlow::Break(());
        let mut checkpoints = Checkpoints {
            start: None,
            seconds: 60.0,
            keep: &mut keep,
        };
        let threads = rayon::current_num_threads();
        let mut pace = Pace::new(Some(&mut checkpoints));
        assert_eq!(pace.tile_count(), FIRST_TILES * threads);
        pace.record_time(100, Duration::from_secs(5));
        assert_eq!(pace.tile_count(), 600.max(threads));
        pace.record_time(1, Duration::from_secs(1000));
        assert_eq!(pace.tile_count(), threads);
        pace.record_time(1000, Duration::ZERO);
        assert_eq!(pace.tile_count(), usize::MAX);
        assert!(!pace.is_due());
        // An unchanged state is not stored again.
        let known = Rounds::new([1, 1]);
        assert!(pace.keep(&known).is_break());
        assert!(pace.keep(&known).is_continue());
        let mut without_sink = Pace::new(None);
        without_sink.record_time(1, Duration::from_secs(1000));
        assert_eq!(without_sink.tile_count(), usize::MAX);
        assert!(!without_sink.is_due() && without_sink.keep(&known).is_continue());
    }
}
