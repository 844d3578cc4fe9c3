//! Handling of Ctrl-C: the render stops, files being written are completed, finished images are kept, exit code 130.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use whit::batch::OngoingWrites;

use super::failure::Failure;

/// Flag that Ctrl-C was pressed; renders poll it.
pub(super) static CANCELLED: AtomicBool = AtomicBool::new(false);

/// Count of the files being written.
pub(super) static WRITES: OngoingWrites = OngoingWrites::new();

/// Time that a phase with its own cancellation gets to stop.
const CANCEL_TIMEOUT: Duration = Duration::from_millis(500);

/// Installs the Ctrl-C handler for the rest of the process.
pub(super) fn install() {
    // If the handler cannot be installed, Ctrl-C ends the process at once.
    let _ = ctrlc::set_handler(|| {
        CANCELLED.store(true, Ordering::Relaxed);
        thread::sleep(CANCEL_TIMEOUT);
        // The process is still running: some phase cannot be cancelled. It holds nothing but memory, unless it writes a
        // file. While this guard is held, no thread can start writing.
        let _none = WRITES.wait_for_none();
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
    WRITES.during(write)
}
