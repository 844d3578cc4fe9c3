//! Ctrl-C: the render stops, files being written are finished, everything finished is kept, exit code 130.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use super::failure::Failure;

/// Whether Ctrl-C was pressed.
pub(super) static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Held while files are written.
static WRITING: Mutex<()> = Mutex::new(());

/// How long a phase that can stop by itself gets to do so.
const GRACE: Duration = Duration::from_millis(500);

/// Takes over Ctrl-C for the rest of the process.
pub(super) fn install() {
    // Where it cannot be taken over, Ctrl-C ends the process the system's way.
    let _ = ctrlc::set_handler(|| {
        CANCELLED.store(true, Ordering::Relaxed);
        thread::sleep(GRACE);
        // Still here: a phase that cannot stop half-way. It holds nothing but memory, unless it writes.
        let _guard = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
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
    let _guard = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
    write()
}
