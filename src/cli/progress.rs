//! Where a command stands, on standard error: a bar on a terminal, JSON lines for programs, or nothing.

mod batch;
mod lines;
mod time_left;

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::events::{self, Event};
use super::failure::Failure;
use super::output;
use lines::Lines;

pub(super) use batch::Batch;

/// The bar's positions: more than it has columns.
const STEPS: f64 = 1000.0;
/// Often enough to look alive, seldom enough to cost nothing.
const TICK: Duration = Duration::from_millis(200);

/// How much is said besides the results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verbosity {
    /// Errors only.
    Quiet,
    /// Warnings, progress and one line an image.
    Normal,
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ProgressKind {
    /// A bar, on a terminal only
    #[default]
    Auto,
    /// JSON lines on standard error: progress, warnings and failures
    Json,
    /// No progress; warnings all the same
    None,
}

/// Where a command stands, for the person or the program that waits.
pub(super) struct Progress {
    bar: ProgressBar,
    lines: Option<Lines>,
    verbosity: Verbosity,
}

impl Progress {
    /// A bar, invisible when quiet or when standard error is no terminal.
    pub(super) fn new(verbosity: Verbosity) -> Progress {
        Progress::of_kind(ProgressKind::Auto, verbosity)
    }

    /// Progress of that kind; when quiet none is shown, and only failures are told.
    pub(super) fn of_kind(kind: ProgressKind, verbosity: Verbosity) -> Progress {
        if kind == ProgressKind::Json {
            events::speak_json();
        }
        let target = match (verbosity, kind) {
            (Verbosity::Normal, ProgressKind::Auto) => ProgressDrawTarget::stderr(),
            _ => ProgressDrawTarget::hidden(),
        };
        let bar = ProgressBar::with_draw_target(Some(STEPS as u64), target);
        if let Ok(style) =
            ProgressStyle::with_template("{prefix} {msg:7} {wide_bar} {percent:>3} % {elapsed:>4}")
        {
            bar.set_style(style);
        }
        let speaks = kind == ProgressKind::Json && verbosity == Verbosity::Normal;
        Progress {
            bar,
            lines: speaks.then(Lines::default),
            verbosity,
        }
    }

    /// Begins a picture.
    pub(super) fn start(&self, scene: &str, image: &str) {
        if let Some(lines) = &self.lines {
            lines.start(scene, image);
        }
    }

    /// Begins a phase of the work on `what`.
    pub(super) fn phase(&self, what: &str, phase: &'static str) {
        if let Some(lines) = &self.lines {
            return lines.phase(what, phase);
        }
        self.bar.set_prefix(what.to_owned());
        self.bar.set_message(phase);
        self.bar.set_position(0);
        self.bar.reset_elapsed();
        if !self.bar.is_hidden() {
            self.bar.enable_steady_tick(TICK);
        }
    }

    /// Says what is being done within the phase.
    pub(super) fn say(&self, what: &str) {
        self.bar.set_message(what.to_owned());
    }

    /// Shows the finished fraction of the phase; from any thread.
    pub(super) fn fraction(&self, fraction: f64) {
        match &self.lines {
            Some(lines) => lines.fraction(fraction),
            None => self.bar.set_position((fraction * STEPS) as u64),
        }
    }

    /// Prints a warning above the bar, unless quiet.
    pub(super) fn warn(&self, warning: &str) {
        if self.verbosity == Verbosity::Quiet {
            return;
        }
        match &self.lines {
            Some(_) => events::tell(&Event::Warning { message: warning }),
            None => self
                .bar
                .suspend(|| output::tell(&format!("whit: warning: {warning}"))),
        }
    }

    /// The picture that was begun is written.
    pub(super) fn done(&self, seconds: f64) {
        if let Some(lines) = &self.lines {
            lines.done(seconds);
        }
    }

    /// Tells that the picture that was begun has failed, quiet or not.
    pub(super) fn failed(&self, failure: &Failure) {
        match &self.lines {
            Some(lines) => lines.failed(failure),
            None => self.bar.suspend(|| failure.print()),
        }
    }

    /// Runs `speak` while the bar is off the screen.
    pub(super) fn suspend<T>(&self, speak: impl FnOnce() -> T) -> T {
        self.bar.suspend(speak)
    }

    /// Takes the bar off the screen.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Turns to a batch of `total` pictures: from now on its progress is shown, and that of single phases is not.
    pub(super) fn batch(&self, total: usize) -> Batch<'_> {
        Batch::new(self, total)
    }
}
