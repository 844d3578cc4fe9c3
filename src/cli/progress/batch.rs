//! Progress of a whole batch: finished images, images in progress, and the remaining time.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use indicatif::ProgressStyle;

use super::lines::RateLimiter;
use super::time_left::{Durations, Running};
use super::{Progress, STEPS, TICK};
use crate::cli::events::{self, Event};
use crate::cli::failure::Failure;

/// Largest number of image names displayed beside the bar.
const MAX_NAMES: usize = 2;

/// Way in which a frame ended, for its event.
struct FrameOutcome<'a> {
    image: &'a str,
    /// Word of the event: `done`, `failed` or `skipped`.
    status: &'a str,
    /// Error of a frame that failed.
    message: Option<&'a str>,
    seconds: f64,
}

/// Image that is being rendered.
struct Current {
    /// Index of its frame in the batch.
    number: usize,
    image: String,
    since: Instant,
    fraction: f64,
}

struct State {
    current: Vec<Current>,
    durations: Durations,
    finished: usize,
    limiter: RateLimiter,
}

/// Progress of a batch of images, several of which may be rendered concurrently; usable from any thread.
pub(in crate::cli) struct BatchProgress<'p> {
    progress: &'p Progress,
    total: usize,
    since: Instant,
    state: Mutex<State>,
}

/// Snapshot of the progress of a batch.
struct Snapshot {
    images: Vec<String>,
    fraction: f64,
    seconds_left: Option<f64>,
}

impl<'p> BatchProgress<'p> {
    pub(super) fn new(progress: &'p Progress, total: usize) -> BatchProgress<'p> {
        // Replace the layout of the bar for single images by that for batches
        if let Ok(style) =
            ProgressStyle::with_template("{prefix} {wide_bar} {percent:>3} % {elapsed:>4} {msg}")
        {
            progress.bar.set_style(style);
        }
        progress.bar.set_prefix(format!("0 of {total}"));
        progress.bar.set_message("");
        progress.bar.set_position(0);
        progress.bar.reset_elapsed();
        if !progress.bar.is_hidden() {
            progress.bar.enable_steady_tick(TICK);
        }
        BatchProgress {
            progress,
            total,
            since: Instant::now(),
            state: Mutex::new(State {
                current: Vec::new(),
                durations: Durations::default(),
                finished: 0,
                limiter: RateLimiter::default(),
            }),
        }
    }

    /// Starts the image of frame `number` and adds it to those in progress.
    pub(in crate::cli) fn begin(&self, number: usize, image: &str) {
        let mut state = self.lock();
        state.current.push(Current {
            number,
            image: image.to_owned(),
            since: Instant::now(),
            fraction: 0.0,
        });
        self.show(&mut state);
    }

    /// Displays the finished fraction of an image; callable from any thread. Returns at once if another thread holds
    /// the lock.
    pub(in crate::cli) fn fraction(&self, number: usize, fraction: f64) {
        let Ok(mut state) = self.state.try_lock() else {
            return;
        };
        if let Some(frame) = state.current.iter_mut().find(|frame| frame.number == number) {
            // Fractions of several threads may arrive out of order.
            frame.fraction = frame.fraction.max(fraction.clamp(0.0, 1.0));
            self.show(&mut state);
        }
    }

    /// Removes an image that is interrupted, which does not count as finished.
    pub(in crate::cli) fn interrupt(&self, number: usize) {
        BatchProgress::take(&mut self.lock(), number);
    }

    /// Reports that an image is skipped because it exists already.
    pub(in crate::cli) fn skip(&self, image: &str) {
        let mut state = self.lock();
        state.finished += 1;
        self.emit(
            &state,
            FrameOutcome {
                image,
                status: "skipped",
                message: None,
                seconds: 0.0,
            },
        );
        self.show(&mut state);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Ignoring poisoning is safe: a panic in another thread leaves no state half-changed.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn snapshot(&self, state: &State) -> Snapshot {
        // Count the finished fractions of running frames
        let of_current = |frame: &Current| Running {
            fraction: frame.fraction,
            seconds: frame.since.elapsed().as_secs_f64(),
        };
        // Estimate the remaining time from the running frames and the number of waiting ones
        let running: Vec<Running> = state.current.iter().map(of_current).collect();
        let waiting = self.total.saturating_sub(state.finished + running.len());
        let parts: f64 = running.iter().map(|frame| frame.fraction).sum();
        Snapshot {
            images: state.current.iter().map(|frame| frame.image.clone()).collect(),
            fraction: ((state.finished as f64 + parts) / self.total.max(1) as f64).min(1.0),
            seconds_left: state.durations.left(&running, waiting),
        }
    }

    /// Displays the progress, unless the last display was too recent.
    fn show(&self, state: &mut State) {
        if !state.limiter.allows(Instant::now()) {
            return;
        }
        let Snapshot {
            images,
            fraction,
            seconds_left,
        } = self.snapshot(state);
        // Print an event, or update the bar
        if self.progress.lines.is_some() {
            return events::emit(&Event::Batch {
                images: &images,
                fraction,
                finished: state.finished,
                total: self.total,
                seconds: self.since.elapsed().as_secs_f64(),
                seconds_left,
            });
        }
        let bar = &self.progress.bar;
        bar.set_position((fraction * STEPS) as u64);
        bar.set_prefix(format!("{} of {}", state.finished, self.total));
        bar.set_message(message(&images, seconds_left));
    }

    /// Prints the event that an image is finished, failed or skipped; only with JSON lines.
    fn emit(&self, state: &State, outcome: FrameOutcome) {
        if self.progress.lines.is_none() {
            return;
        }
        events::emit(&Event::Frame {
            image: outcome.image,
            status: outcome.status,
            message: outcome.message,
            seconds: outcome.seconds,
            finished: state.finished,
            total: self.total,
            seconds_left: self.snapshot(state).seconds_left,
        });
    }

    /// Removes an image from those in progress and returns it.
    fn take(state: &mut State, number: usize) -> Option<Current> {
        let place = state.current.iter().position(|frame| frame.number == number)?;
        Some(state.current.remove(place))
    }

    /// Reports that an image is written, or has failed for a reason.
    pub(in crate::cli) fn end(&self, number: usize, failure: Option<&Failure>) {
        let mut state = self.lock();
        let Some(frame) = BatchProgress::take(&mut state, number) else {
            return;
        };
        let seconds = frame.since.elapsed().as_secs_f64();
        state.finished += 1;
        // Only successful frames contribute to the typical duration
        if failure.is_none() {
            state.durations.note(seconds);
        }
        let message = failure.map(ToString::to_string);
        let outcome = FrameOutcome {
            image: &frame.image,
            status: failure.map_or("done", |_| "failed"),
            message: message.as_deref(),
            seconds,
        };
        match failure {
            Some(failure) if self.progress.lines.is_none() => self.progress.suspend(|| failure.print()),
            _ => self.emit(&state, outcome),
        }
        self.show(&mut state);
    }
}

/// Returns the text beside the bar: the remaining time and the images in progress.
fn message(images: &[String], seconds_left: Option<f64>) -> String {
    let left = match seconds_left {
        Some(seconds) => format!("{} left", duration(seconds)),
        None => "time left unknown".to_owned(),
    };
    let names = images[..images.len().min(MAX_NAMES)].join(", ");
    match images.len() {
        0 => left,
        1..=MAX_NAMES => format!("{left}: {names}"),
        more => format!("{left}: {names} and {} more", more - MAX_NAMES),
    }
}

/// Returns a duration in at most two units.
fn duration(seconds: f64) -> String {
    let whole = seconds.max(0.0).ceil() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, seconds) => format!("{seconds} s"),
        (0, minutes, seconds) => format!("{minutes} min {seconds:02} s"),
        (hours, minutes, _) => format!("{hours} h {minutes:02} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Verbosity;
    use super::*;

    #[test]
    fn batch_fraction_counts_finished_and_partly_rendered_images() {
        let progress = Progress::new(Verbosity::Quiet);
        let batch = progress.batch(4);
        batch.skip("a");
        batch.begin(1, "b");
        batch.end(1, None);
        batch.begin(2, "c");
        batch.fraction(2, 0.5);
        batch.fraction(2, 0.25);
        let snapshot = batch.snapshot(&batch.lock());
        assert_eq!(
            (snapshot.fraction, &*snapshot.images),
            (2.5 / 4.0, &["c".to_owned()][..])
        );
        assert!(snapshot.seconds_left.is_some());
        batch.interrupt(2);
        let snapshot = batch.snapshot(&batch.lock());
        assert_eq!((snapshot.fraction, snapshot.images.len()), (0.5, 0));
    }

    #[test]
    fn remaining_time_is_formatted_briefly() {
        assert_eq!(
            [0.2, 59.5, 61.0, 3599.2, 86_400.0].map(duration),
            ["1 s", "1 min 00 s", "1 min 01 s", "1 h 00 min", "24 h 00 min"]
        );
        let names: Vec<String> = ["a", "b", "c"].map(str::to_owned).into();
        assert_eq!(message(&names, Some(1.0)), "1 s left: a, b and 1 more");
        assert_eq!(message(&names[..1], None), "time left unknown: a");
        assert_eq!(message(&[], Some(0.0)), "0 s left");
    }
}
