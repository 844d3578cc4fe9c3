//! Processor time, which other programs do not add to: of one thread and of the whole process.

/// Returns the processor seconds of this thread so far.
pub(crate) fn thread_seconds() -> f64 {
    imp::seconds(imp::Clock::Thread)
}

/// Returns the processor seconds of all threads of this process so far.
pub(crate) fn process_seconds() -> f64 {
    imp::seconds(imp::Clock::Process)
}

#[cfg(target_os = "linux")]
mod imp {
    use rustix::time::{ClockId, clock_gettime};

    pub(super) enum Clock {
        Thread,
        Process,
    }

    pub(super) fn seconds(clock: Clock) -> f64 {
        let time = clock_gettime(match clock {
            Clock::Thread => ClockId::ThreadCPUTime,
            Clock::Process => ClockId::ProcessCPUTime,
        });
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
}

/// Elsewhere both are the seconds since the first call.
#[cfg(not(target_os = "linux"))]
mod imp {
    use std::sync::LazyLock;
    use std::time::Instant;

    pub(super) enum Clock {
        Thread,
        Process,
    }

    pub(super) fn seconds(_: Clock) -> f64 {
        static START: LazyLock<Instant> = LazyLock::new(Instant::now);
        START.elapsed().as_secs_f64()
    }
}
