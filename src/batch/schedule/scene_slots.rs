//! Admission of scenes: small scenes with a single frame are processed concurrently, so that one is loaded or written
//! while another uses the processors; large scenes, and those with several frames, which run concurrently themselves,
//! are exclusive.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Admission lock of the scenes: shared for small ones, exclusive for large ones.
#[derive(Default)]
pub(super) struct SceneSlots(RwLock<()>);

/// Admission of a scene, released when dropped.
pub(super) enum SlotGuard<'p> {
    Shared { _others: RwLockReadGuard<'p, ()> },
    Exclusive { _none: RwLockWriteGuard<'p, ()> },
}

impl SceneSlots {
    /// Waits until the scene is admitted; `alone` requests exclusive admission.
    pub(super) fn enter(&self, alone: bool) -> SlotGuard<'_> {
        match alone {
            true => SlotGuard::Exclusive {
                _none: self.0.write().unwrap_or_else(PoisonError::into_inner),
            },
            false => SlotGuard::Shared {
                _others: self.0.read().unwrap_or_else(PoisonError::into_inner),
            },
        }
    }

    /// Waits until all other scenes are finished and returns an exclusive admission.
    pub(super) fn clear<'p>(&'p self, guard: SlotGuard<'p>) -> SlotGuard<'p> {
        match guard {
            SlotGuard::Exclusive { .. } => guard,
            SlotGuard::Shared { .. } => {
                // Release the shared lock first: two scenes that wait for each other would deadlock.
                drop(guard);
                self.enter(true)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Barrier, Mutex};

    use super::*;

    #[test]
    fn small_scenes_run_concurrently_and_large_scenes_run_alone() {
        let (place, both) = (SceneSlots::default(), Barrier::new(2));
        let (alone, most) = (Mutex::new(()), AtomicUsize::new(0));
        let set_up = || {
            let guard = place.enter(false);
            // The barrier shows that both scenes are admitted at the same time.
            both.wait();
            let _standing = place.clear(guard);
            let _alone = alone.try_lock().unwrap();
            most.fetch_add(1, Ordering::Relaxed);
        };
        std::thread::scope(|scope| {
            scope.spawn(set_up);
            scope.spawn(set_up);
        });
        assert_eq!(most.into_inner(), 2);
    }
}
