//! Ctrl-C: the render stops, files being written are finished, everything finished is kept, exit code 130.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use super::failure::Failure;

/// Whether Ctrl-C was pressed.
pub(super) static CANCELLED: AtomicBool = AtomicBool::new(false);

/// How many files are being written.
///
/// A count rather than a lock that is held meanwhile: whoever writes may wait for threads of a pool, and there take up
/// another picture, which is written too.
static WRITERS: Mutex<usize> = Mutex::new(0);
/// Told when that becomes none.
static NO_WRITERS: Condvar = Condvar::new();

/// How long a phase that can stop by itself gets to do so.
const GRACE: Duration = Duration::from_millis(500);

/// Takes over Ctrl-C for the rest of the process.
pub(super) fn install() {
    // Where it cannot be taken over, Ctrl-C ends the process the system's way.
    let _ = ctrlc::set_handler(|| {
        CANCELLED.store(true, Ordering::Relaxed);
        thread::sleep(GRACE);
        // Still here: a phase that cannot stop half-way. It holds nothing but memory, unless it writes. As long as the
        // count is held nobody begins to.
        let _none = NO_WRITERS
            .wait_while(writers(), |count| *count > 0)
            .unwrap_or_else(PoisonError::into_inner);
        let failure = Failure::Interrupted;
        failure.print();
        std::process::exit(failure.exit_code());
    });
}

/// An error once Ctrl-C was pressed.
pub(super) fn check() -> Result<(), Failure> {
    if CANCELLED.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted);
    }
    Ok(())
}

/// Runs `write` to its end, Ctrl-C or not.
pub(super) fn finish_first<T>(write: impl FnOnce() -> T) -> T {
    let _writer = Writer::new();
    write()
}

fn writers() -> MutexGuard<'static, usize> {
    WRITERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Counts as long as it lives.
struct Writer;

impl Writer {
    fn new() -> Writer {
        *writers() += 1;
        Writer
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        let mut count = writers();
        *count -= 1;
        if *count == 0 {
            NO_WRITERS.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_writes_may_write_another_file_meanwhile() {
        assert!(finish_first(|| finish_first(|| *writers())) >= 2);
    }
}
