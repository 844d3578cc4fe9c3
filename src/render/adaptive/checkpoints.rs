//! When a picture that is sampled adaptively is kept half-made, and by whom.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use super::rounds::Rounds;

/// Tiles for each thread that are visited first, by which is told how long others will take.
const FIRST_TILES: usize = 8;

/// A render that may be ended at any time, and gone on with by another one to the same bits.
pub struct Checkpoints<'a> {
    /// How far an earlier render of the same picture was; `None` begins it. What cannot be of the picture is taken for
    /// none.
    pub start: Option<Rounds>,
    /// Seconds of work that may be lost.
    pub seconds: f64,
    /// Keeps what is known about so often, and when the render is cancelled. `Break` ends the render as cancelled.
    pub keep: &'a mut dyn FnMut(&Rounds) -> ControlFlow<()>,
}

/// How many tiles are visited before what is known is looked at for keeping.
pub(super) struct Pace<'c, 'a> {
    checkpoints: Option<&'c mut Checkpoints<'a>>,
    tile_count: usize,
    kept_at: Instant,
    /// Whether anything has come that is not kept.
    has_news: bool,
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
            has_news: false,
        }
    }

    /// How many tiles are to be visited next.
    pub(super) fn tile_count(&self) -> usize {
        self.tile_count
    }

    /// What tiles took.
    pub(super) fn took(&mut self, tile_count: usize, time: Duration) {
        self.has_news = true;
        if let Some(checkpoints) = &self.checkpoints {
            let of_tile = (time.as_secs_f64() / tile_count as f64).max(f64::MIN_POSITIVE);
            // So that at most half of what may be lost is in the making.
            let fitting = (0.5 * checkpoints.seconds / of_tile) as usize;
            self.tile_count = fitting.max(rayon::current_num_threads());
        }
    }

    /// Whether it is time to keep what is known.
    pub(super) fn is_due(&self) -> bool {
        let is_due = |checkpoints: &&mut Checkpoints| {
            self.kept_at.elapsed().as_secs_f64() >= 0.5 * checkpoints.seconds
        };
        self.checkpoints.as_ref().is_some_and(is_due)
    }

    /// Has what is known kept, if there is anything new and anybody who keeps it.
    pub(super) fn keep(&mut self, known: &Rounds) -> ControlFlow<()> {
        if !std::mem::take(&mut self.has_news) {
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
    fn as_many_tiles_come_next_as_half_of_the_time_is_enough_for() {
        let mut keep = |_: &Rounds| ControlFlow::Break(());
        let mut checkpoints = Checkpoints {
            start: None,
            seconds: 60.0,
            keep: &mut keep,
        };
        let threads = rayon::current_num_threads();
        let mut pace = Pace::new(Some(&mut checkpoints));
        assert_eq!(pace.tile_count(), FIRST_TILES * threads);
        pace.took(100, Duration::from_secs(5));
        assert_eq!(pace.tile_count(), 600.max(threads));
        pace.took(1, Duration::from_secs(1000));
        assert_eq!(pace.tile_count(), threads);
        pace.took(1000, Duration::ZERO);
        assert_eq!(pace.tile_count(), usize::MAX);
        assert!(!pace.is_due());
        // What is kept once is not kept again.
        let known = Rounds::new([1, 1]);
        assert!(pace.keep(&known).is_break());
        assert!(pace.keep(&known).is_continue());
        let mut nobody = Pace::new(None);
        nobody.took(1, Duration::from_secs(1000));
        assert_eq!(nobody.tile_count(), usize::MAX);
        assert!(!nobody.is_due() && nobody.keep(&known).is_continue());
    }
}
