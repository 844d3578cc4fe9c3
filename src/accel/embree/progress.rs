//! How far a build is, as Embree tells it.

use std::any::Any;
use std::ffi::c_void;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Mutex;

/// How far the whole build is, over all its commits.
pub(super) struct Progress<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    done: usize,
    total: usize,
}

/// One commit's part of the progress.
pub(super) struct Stage<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    from: f64,
    to: f64,
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl<'a> Progress<'a> {
    /// Of a build of `total` primitives, told to `report`.
    pub(super) fn new(report: Option<&'a (dyn Fn(f64) + Sync)>, total: usize) -> Progress<'a> {
        Progress {
            report,
            done: 0,
            total,
        }
    }

    /// The next commit, of `count` primitives.
    pub(super) fn stage(&mut self, count: usize) -> Stage<'a> {
        let fraction = |done: usize| {
            if self.total == 0 {
                1.0
            } else {
                done as f64 / self.total as f64
            }
        };
        let from = fraction(self.done);
        self.done += count;
        Stage {
            report: self.report,
            from,
            to: fraction(self.done),
            panic: Mutex::new(None),
        }
    }
}

impl Stage<'_> {
    /// Tells that it is done.
    pub(super) fn finish(&self) {
        if let Some(report) = self.report {
            report(self.to);
        }
    }

    /// Goes on with the panic that cancelled it, if one did.
    pub(super) fn resume_panic(&self) {
        let payload = self.panic.lock().unwrap_or_else(|e| e.into_inner()).take();
        if let Some(payload) = payload {
            panic::resume_unwind(payload);
        }
    }
}

/// Passes progress on. False cancels the build: after a panic, which must not cross into C, nothing else makes sense.
pub(super) unsafe extern "C" fn on_progress(stage: *mut c_void, fraction: f64) -> bool {
    // SAFETY: `commit` set this pointer and takes it away before the stage goes.
    let stage = unsafe { &*stage.cast::<Stage>() };
    let Some(report) = stage.report else {
        return true;
    };
    let fraction = stage.from + fraction.clamp(0.0, 1.0) * (stage.to - stage.from);
    match panic::catch_unwind(AssertUnwindSafe(|| report(fraction))) {
        Ok(()) => true,
        Err(payload) => {
            stage
                .panic
                .lock()
                .unwrap_or_else(|e| e.into_inner())
                .get_or_insert(payload);
            false
        }
    }
}
