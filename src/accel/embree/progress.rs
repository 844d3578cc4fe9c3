//! Progress of a build, from Embree's progress monitor.

use std::any::Any;
use std::ffi::c_void;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Mutex;

/// Progress of the whole build, over all its commits.
pub(super) struct BuildProgress<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    done: usize,
    total: usize,
}

/// Part of the progress that one commit covers.
pub(super) struct Stage<'a> {
    report: Option<&'a (dyn Fn(f64) + Sync)>,
    from: f64,
    to: f64,
    /// Largest fraction reported: Embree calls from several threads, not always in order.
    reported: Mutex<f64>,
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

impl<'a> BuildProgress<'a> {
    /// Starts the progress of a build of `total` primitives, which calls `report`.
    pub(super) fn new(report: Option<&'a (dyn Fn(f64) + Sync)>, total: usize) -> BuildProgress<'a> {
        BuildProgress {
            report,
            done: 0,
            total,
        }
    }

    /// Starts the next commit, of `count` primitives.
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
            reported: Mutex::new(from),
            panic: Mutex::new(None),
        }
    }
}

impl Stage<'_> {
    /// Reports that the stage is finished.
    pub(super) fn finish(&self) {
        if let Some(report) = self.report {
            report(self.to);
        }
    }

    /// Resumes the panic that cancelled the stage, if there was one.
    pub(super) fn resume_panic(&self) {
        let payload = self.panic.lock().unwrap_or_else(|e| e.into_inner()).take();
        if let Some(payload) = payload {
            panic::resume_unwind(payload);
        }
    }
}

/// Forwards progress to the caller. Returning false cancels the build, which is done after a panic, as it must not
/// unwind into C.
pub(super) unsafe extern "C" fn on_progress(stage: *mut c_void, fraction: f64) -> bool {
    // SAFETY: `commit` set this pointer and removes it before the stage is dropped.
    let stage = unsafe { &*stage.cast::<Stage>() };
    let Some(report) = stage.report else {
        return true;
    };
    let fraction = stage.from + fraction.clamp(0.0, 1.0) * (stage.to - stage.from);
    let mut reported = stage.reported.lock().unwrap_or_else(|e| e.into_inner());
    if fraction < *reported {
        return true;
    }
    *reported = fraction;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_that_arrive_out_of_order_are_dropped() {
        let reported = Mutex::new(Vec::new());
        let report = |fraction: f64| reported.lock().unwrap().push(fraction);
        let mut progress = BuildProgress::new(Some(&report), 4);
        for count in [1, 3] {
            let stage = progress.stage(count);
            let data = (&raw const stage).cast_mut().cast();
            for fraction in [0.5, 1.0, 0.9] {
                // SAFETY: `data` points to the stage, which is alive.
                assert!(unsafe { on_progress(data, fraction) });
            }
            stage.finish();
        }
        assert_eq!(
            reported.into_inner().unwrap(),
            [0.125, 0.25, 0.25, 0.625, 1.0, 1.0]
        );
    }
}
