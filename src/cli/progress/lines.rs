//! Progress as JSON lines, limited to a rate that costs readers nothing.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::time_left;
use crate::cli::events::{self, Event};
use crate::cli::failure::Failure;

/// Shortest time between two lines of progress.
const PAUSE: Duration = Duration::from_millis(100);

/// Rate limiter that allows one line of progress per [`PAUSE`].
#[derive(Debug, Default)]
pub(super) struct Pace {
    last: Option<Instant>,
}

impl Pace {
    /// Returns whether a line may be printed now; if so, counts it as printed.
    pub(super) fn allows(&mut self, now: Instant) -> bool {
        let is_time = self
            .last
            .is_none_or(|last| now.saturating_duration_since(last) >= PAUSE);
        if is_time {
            self.last = Some(now);
        }
        is_time
    }
}

/// State of the current image and phase.
struct About {
    scene: String,
    image: String,
    phase: &'static str,
    /// Start time of the phase.
    since: Instant,
    fraction: f64,
    pace: Pace,
}

/// Progress of one image after another.
pub(super) struct Lines(Mutex<About>);

impl Default for Lines {
    fn default() -> Lines {
        Lines(Mutex::new(About {
            scene: String::new(),
            image: String::new(),
            phase: "",
            since: Instant::now(),
            fraction: 0.0,
            pace: Pace::default(),
        }))
    }
}

impl Lines {
    fn lock(&self) -> MutexGuard<'_, About> {
        // Ignoring poisoning is safe: a panic in another thread leaves no state half-changed.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn start(&self, scene: &str, image: &str) {
        let mut about = self.lock();
        about.scene = scene.to_owned();
        about.image = image.to_owned();
        events::tell(&Event::Start { scene, image });
    }

    pub(super) fn phase(&self, scene: &str, phase: &'static str) {
        let mut about = self.lock();
        about.scene = scene.to_owned();
        about.phase = phase;
        about.since = Instant::now();
        about.fraction = 0.0;
        events::tell(&Event::Phase {
            scene,
            image: &about.image,
            phase,
        });
    }

    /// Prints the fraction, unless another thread is printing; then a later fraction will be printed.
    pub(super) fn fraction(&self, fraction: f64) {
        let Ok(mut about) = self.0.try_lock() else {
            return;
        };
        // Fractions of several threads may arrive out of order.
        if !(fraction > about.fraction) || !about.pace.allows(Instant::now()) {
            return;
        }
        about.fraction = fraction;
        let seconds = about.since.elapsed().as_secs_f64();
        events::tell(&Event::Progress {
            scene: &about.scene,
            image: &about.image,
            phase: about.phase,
            fraction,
            seconds,
            seconds_left: time_left::of_phase(fraction, seconds),
        });
    }

    pub(super) fn done(&self, seconds: f64) {
        let about = self.lock();
        events::tell(&Event::Done {
            scene: &about.scene,
            image: &about.image,
            seconds,
        });
    }

    pub(super) fn failed(&self, failure: &Failure) {
        let about = self.lock();
        events::tell(&Event::Failed {
            scene: Some(&about.scene),
            image: Some(&about.image),
            message: &failure.to_string(),
            exit_code: failure.exit_code(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_no_faster_than_their_pace() {
        let mut pace = Pace::default();
        let start = Instant::now();
        let told = (0..1000).filter(|&i| pace.allows(start + Duration::from_millis(i)));
        assert_eq!(told.count(), 10);
    }
}
