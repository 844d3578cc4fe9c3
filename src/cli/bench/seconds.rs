//! Seconds of each repetition of a measurement.

/// Seconds of each repetition of a measurement.
#[derive(Clone, Default)]
pub(super) struct Seconds {
    /// Seconds of builds with the requested number of threads, and of replays with one thread.
    pub(super) base: Vec<f64>,
    /// Seconds by thread count of the scaling measurement, then by repetition.
    pub(super) by_threads: Vec<Vec<f64>>,
}

impl Seconds {
    /// Returns the seconds of a single repetition.
    pub(super) fn of(base: f64) -> Seconds {
        Seconds {
            base: vec![base],
            by_threads: Vec::new(),
        }
    }
}
