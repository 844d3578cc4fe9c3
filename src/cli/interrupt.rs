//! Handling of Ctrl-C: the render stops, files being written are completed, finished images are kept, exit code 130.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use super::failure::Failure;

/// Flag that Ctrl-C was pressed; renders poll it.
pub(super) static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Number of files being written.
///
/// The number is not a lock held during the write: a thread that writes may wait for threads of a pool, take up another
/// frame meanwhile, and write that one too.
static WRITERS: Mutex<usize> = Mutex::new(0);
/// Signalled when the number of writers becomes zero.
static NO_WRITERS: Condvar = Condvar::new();

/// Time that a phase with its own cancellation gets to stop.
const CANCEL_TIMEOUT: Duration = Duration::from_millis(500);

/// Installs the Ctrl-C handler for the rest of the process.
pub(super) fn install() {
    // If the handler cannot be installed, Ctrl-C ends the process at once.
    let _ = ctrlc::set_handler(|| {
        CANCELLED.store(true, Ordering::Relaxed);
        thread::sleep(CANCEL_TIMEOUT);
        // The process is still running: some phase cannot be cancelled. It holds nothing but memory, unless it writes a
        // file. While this lock is held, no thread can start writing.
        let _none = NO_WRITERS
            .wait_while(writers(), |count| *count > 0)
            .unwrap_or_else(PoisonError::into_inner);
        let failure = Failure::Interrupted;
        failure.print();
        std::process::exit(failure.exit_code());
    });
}

/// Returns an error if Ctrl-C was pressed.
pub(super) fn check() -> Result<(), Failure> {
    if CANCELLED.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted);
    }
    Ok(())
}

/// Runs `write` to completion even if Ctrl-C is pressed meanwhile.
pub(super) fn without_interruption<T>(write: impl FnOnce() -> T) -> T {
    let _writer = InterruptWriter::new();
    write()
}

fn writers() -> MutexGuard<'static, usize> {
    WRITERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Guard that counts as one writer until it is dropped.
struct InterruptWriter;

impl InterruptWriter {
    fn new() -> InterruptWriter {
        *writers() += 1;
        InterruptWriter
    }
}

impl Drop for InterruptWriter {
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
    fn writers_may_be_nested() {
        assert!(without_interruption(|| without_interruption(|| *writers())) >= 2);
    }
}
