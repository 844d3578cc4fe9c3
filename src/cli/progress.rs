//! The progress bar: on a terminal only, on standard error.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::output;

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

/// Where a command stands, for the person who waits.
pub(super) struct Progress {
    bar: ProgressBar,
    verbosity: Verbosity,
}

impl Progress {
    /// A bar, invisible when quiet or when standard error is no terminal.
    pub(super) fn new(verbosity: Verbosity) -> Progress {
        let target = match verbosity {
            Verbosity::Quiet => ProgressDrawTarget::hidden(),
            Verbosity::Normal => ProgressDrawTarget::stderr(),
        };
        let bar = ProgressBar::with_draw_target(Some(STEPS as u64), target);
        if let Ok(style) =
            ProgressStyle::with_template("{prefix} {msg:7} {wide_bar} {percent:>3} % {elapsed:>4}")
        {
            bar.set_style(style);
        }
        Progress { bar, verbosity }
    }

    /// Begins a phase of the work on `what`.
    pub(super) fn phase(&self, what: &str, phase: &'static str) {
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
        self.bar.set_position((fraction * STEPS) as u64);
    }

    /// Prints a warning above the bar, unless quiet.
    pub(super) fn warn(&self, warning: &str) {
        if self.verbosity == Verbosity::Normal {
            self.bar
                .suspend(|| output::tell(&format!("whit: warning: {warning}")));
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
}
