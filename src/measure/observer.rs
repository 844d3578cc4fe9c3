//! Progress and cancellation of a long measurement, for its caller.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::render::Monitor;

/// Callback and cancellation flag that connect a measurement with its caller.
#[derive(Clone, Copy)]
pub struct Observer<'a> {
    /// Callback that receives the current step and its finished fraction, from any thread.
    pub progress: &'a (dyn Fn(&str, f64) + Sync),
    /// Flag that stops the measurement when it is set.
    pub cancel: &'a AtomicBool,
}

impl<'a> Observer<'a> {
    /// Returns whether the measurement is to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Returns a monitor for renders that stop with the measurement and report no progress of their own.
    pub fn monitor(&self) -> Monitor<'a> {
        Monitor {
            cancel: self.cancel,
            ..Monitor::default()
        }
    }
}
