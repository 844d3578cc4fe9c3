//! Count of the files being written, so that an interrupted process ends between files.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Count of the files being written.
///
/// The count is not a lock held during the write: a thread that writes may wait for threads of a pool, take up another
/// frame meanwhile, and write that one too.
#[derive(Debug, Default)]
pub struct OngoingWrites {
    count: Mutex<usize>,
    /// Signalled when the count becomes zero.
    none: Condvar,
}

impl OngoingWrites {
    /// Returns a count of zero.
    pub const fn new() -> OngoingWrites {
        OngoingWrites {
            count: Mutex::new(0),
            none: Condvar::new(),
        }
    }

    /// Runs `write` while it counts as a file being written.
    pub fn during<T>(&self, write: impl FnOnce() -> T) -> T {
        *self.lock() += 1;
        let _writer = Writer(self);
        write()
    }

    /// Waits until no file is being written. While the caller holds the guard, no thread can start writing.
    pub fn wait_for_none(&self) -> MutexGuard<'_, usize> {
        self.none
            .wait_while(self.lock(), |count| *count > 0)
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Guard that counts as one file until it is dropped.
struct Writer<'w>(&'w OngoingWrites);

impl Drop for Writer<'_> {
    fn drop(&mut self) {
        let mut count = self.0.lock();
        *count -= 1;
        if *count == 0 {
            self.0.none.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writers_may_be_nested() {
        let writes = OngoingWrites::new();
        assert_eq!(writes.during(|| writes.during(|| *writes.lock())), 2);
        assert_eq!(*writes.wait_for_none(), 0);
    }
}
