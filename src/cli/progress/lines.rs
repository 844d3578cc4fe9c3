//! Progress as JSON lines, limited to a rate that costs readers nothing.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::time_left;
use crate::cli::events::{self, Event};
use crate::cli::failure::Failure;

/// Shortest time between two lines of progress.
const MIN_INTERVAL: Duration = Duration::from_millis(100);

/// Rate limiter that allows one line of progress per [`MIN_INTERVAL`].
#[derive(Debug, Default)]
pub(super) struct RateLimiter {
    last: Option<Instant>,
}

impl RateLimiter {
    /// Returns whether a line may be printed now; if so, counts it as printed.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        let is_time = self
            .last
            .is_none_or(|last| now.saturating_duration_since(last) >= MIN_INTERVAL);
        if is_time {
            self.last = Some(now);
        }
        is_time
    }
}

/// State of the current image and phase.
struct CurrentLine {
    scene: String,
    image: String,
    phase: &'static str,
    /// Start time of the phase.
    since: Instant,
    fraction: f64,
    limiter: RateLimiter,
}

/// Progress of one image after another.
pub(super) struct Lines(Mutex<CurrentLine>);

impl Default for Lines {
    fn default() -> Lines {
        Lines(Mutex::new(CurrentLine {
            scene: String::new(),
            image: String::new(),
            phase: "",
            since: Instant::now(),
            fraction: 0.0,
            limiter: RateLimiter::default(),
        }))
    }
}

impl Lines {
    fn lock(&self) -> MutexGuard<'_, CurrentLine> {
        // Ignoring poisoning is safe: a panic in another thread leaves no state half-changed.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn start(&self, scene: &str, image: &str) {
        let mut current = self.lock();
        current.scene = scene.to_owned();
        current.image = image.to_owned();
        events::emit(&Event::Start { scene, image });
    }

    pub(super) fn phase(&self, scene: &str, phase: &'static str) {
        let mut current = self.lock();
        current.scene = scene.to_owned();
        current.phase = phase;
        current.since = Instant::now();
        current.fraction = 0.0;
        events::emit(&Event::Phase {
            scene,
            image: &current.image,
            phase,
        });
    }

    /// Prints the fraction, unless another thread is printing; then a later fraction will be printed.
    pub(super) fn fraction(&self, fraction: f64) {
        let Ok(mut current) = self.0.try_lock() else {
            return;
        };
        // Fractions of several threads may arrive out of order.
        if !(fraction > current.fraction) || !current.limiter.allows(Instant::now()) {
            return;
        }
        current.fraction = fraction;
        let seconds = current.since.elapsed().as_secs_f64();
        events::emit(&Event::Progress {
            scene: &current.scene,
            image: &current.image,
            phase: current.phase,
            fraction,
            seconds,
            seconds_left: time_left::remaining_seconds(fraction, seconds),
        });
    }

    pub(super) fn done(&self, seconds: f64) {
        let current = self.lock();
        events::emit(&Event::Done {
            scene: &current.scene,
            image: &current.image,
            seconds,
        });
    }

    pub(super) fn failed(&self, failure: &Failure) {
        let current = self.lock();
        events::emit(&Event::Failed {
            scene: Some(&current.scene),
            image: Some(&current.image),
            message: &failure.to_string(),
            exit_code: failure.exit_code(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_limited_to_ten_per_second() {
        let mut limiter = RateLimiter::default();
        let start = Instant::now();
        let allowed = (0..1000).filter(|&i| limiter.allows(start + Duration::from_millis(i)));
        assert_eq!(allowed.count(), 10);
    }
}
