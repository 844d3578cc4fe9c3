//! Progress of a command on standard error: a bar on a terminal, JSON lines for programs, or nothing.

mod batch;
mod lines;
mod time_left;

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use whit::measure::Observer;

use super::events::{self, Event};
use super::failure::Failure;
use super::interrupt;
use super::output;
use super::standard_error;
use lines::Lines;

pub(super) use batch::BatchProgress;

/// Number of positions of the bar, more than its columns.
const STEPS: f64 = 1000.0;
/// Interval of redrawing the bar: short enough for a moving clock, long enough to cost nothing.
const TICK: Duration = Duration::from_millis(200);

/// Amount of output besides the results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verbosity {
    /// Errors only, without warnings and progress.
    Quiet,
    /// Print warnings, progress and one line per image.
    Normal,
}

impl Verbosity {
    /// Returns the verbosity for the value of the flag `--quiet`.
    pub(super) fn of_flag(quiet: bool) -> Verbosity {
        match quiet {
            true => Verbosity::Quiet,
            false => Verbosity::Normal,
        }
    }
}

/// Form of the progress on standard error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum ProgressKind {
    /// Bar, shown on a terminal only
    #[default]
    Auto,
    /// JSON lines on standard error: progress, warnings and failures
    Json,
    /// No progress, but warnings are still printed
    None,
}

/// Progress display of a command.
pub(super) struct Progress {
    bar: ProgressBar,
    lines: Option<Lines>,
    verbosity: Verbosity,
}

impl Progress {
    /// Returns a bar, which is hidden when quiet or when standard error is no terminal.
    pub(super) fn new(verbosity: Verbosity) -> Progress {
        Progress::of_kind(ProgressKind::Auto, verbosity)
    }

    /// Returns a progress display of the given kind; when quiet it shows nothing but failures.
    pub(super) fn of_kind(kind: ProgressKind, verbosity: Verbosity) -> Progress {
        if kind == ProgressKind::Json {
            events::use_json();
        }
        // Hide the bar when quiet or when another kind of progress is requested
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
        let writes_json = kind == ProgressKind::Json && verbosity == Verbosity::Normal;
        Progress {
            bar,
            lines: writes_json.then(Lines::default),
            verbosity,
        }
    }

    /// Starts a new image of a scene.
    pub(super) fn start(&self, scene: &str, image: &str) {
        if let Some(lines) = &self.lines {
            lines.start(scene, image);
        }
    }

    /// Starts a phase of the work on `what`.
    pub(super) fn phase(&self, what: &str, phase: &'static str) {
        if let Some(lines) = &self.lines {
            return lines.phase(what, phase);
        }
        self.bar.set_prefix(what.to_owned());
        self.bar.set_message(phase);
        self.bar.set_position(0);
        self.bar.reset_elapsed();
        // A hidden bar needs no thread that redraws it
        if !self.bar.is_hidden() {
            self.bar.enable_steady_tick(TICK);
        }
    }

    /// Displays the finished fraction of the phase, from 0 to 1; callable from any thread.
    pub(super) fn fraction(&self, fraction: f64) {
        match &self.lines {
            Some(lines) => lines.fraction(fraction),
            None => self.bar.set_position((fraction * STEPS) as u64),
        }
    }

    /// Runs a measurement whose steps are displayed, and which Ctrl-C cancels.
    pub(super) fn observe<T>(&self, measure: impl FnOnce(&Observer) -> T) -> T {
        measure(&Observer {
            progress: &|step, fraction| {
                self.bar.set_message(step.to_owned());
                self.fraction(fraction);
            },
            cancel: &interrupt::CANCELLED,
        })
    }

    /// Prints a warning above the bar, unless quiet.
    pub(super) fn warn(&self, warning: &str) {
        if self.verbosity == Verbosity::Quiet {
            return;
        }
        match &self.lines {
            Some(_) => events::emit(&Event::Warning { message: warning }),
            None => self
                .bar
                .suspend(|| standard_error::emit(&format!("whit: warning: {warning}"))),
        }
    }

    /// Reports that the current image is written.
    pub(super) fn done(&self, seconds: f64) {
        if let Some(lines) = &self.lines {
            lines.done(seconds);
        }
    }

    /// Reports that the current image has failed, also when quiet.
    pub(super) fn failed(&self, failure: &Failure) {
        match &self.lines {
            Some(lines) => lines.failed(failure),
            None => self.bar.suspend(|| failure.print()),
        }
    }

    /// Runs `callback` while the bar is hidden, so that its output does not mix with the bar.
    pub(super) fn suspend<T>(&self, callback: impl FnOnce() -> T) -> T {
        self.bar.suspend(callback)
    }

    /// Prints a result above the bar, unless quiet.
    pub(super) fn result(&self, text: &str) -> Result<(), Failure> {
        match self.verbosity {
            Verbosity::Quiet => Ok(()),
            Verbosity::Normal => self.suspend(|| output::print(text)),
        }
    }

    /// Removes the bar from the terminal.
    pub(super) fn clear(&self) {
        self.bar.finish_and_clear();
    }

    /// Switches to the progress of a batch of `total` images; that of single phases is not displayed any more.
    pub(super) fn batch(&self, total: usize) -> BatchProgress<'_> {
        BatchProgress::new(self, total)
    }
}
