//! Reasons for which a benchmark ends without a result.

use crate::accel::AccelError;
use crate::measure::Observer;
use crate::render::Cancelled;

/// Reason for which a benchmark ends without a result.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// Cancellation by the observer's flag.
    #[error("interrupted")]
    Cancelled(#[from] Cancelled),
    /// Failure to build an acceleration structure.
    #[error(transparent)]
    Accel(#[from] AccelError),
    /// Failure to start the thread that renders frames.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] rayon::ThreadPoolBuildError),
}

/// Returns an error if the measurement is to stop.
pub(super) fn check(observer: &Observer) -> Result<(), BenchError> {
    if observer.is_cancelled() {
        return Err(Cancelled.into());
    }
    Ok(())
}
