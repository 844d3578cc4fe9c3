//! Where scenes are set up: small ones of a frame each side by side, so that one is loaded or written while the other has
//! the processors; large ones, and those of several frames, which go on together themselves, alone.

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Room for scenes.
#[derive(Default)]
pub(super) struct Place(RwLock<()>);

/// A scene's part of the place, as long as it lives.
pub(super) enum Standing<'p> {
    Beside { _others: RwLockReadGuard<'p, ()> },
    Alone { _none: RwLockWriteGuard<'p, ()> },
}

impl Place {
    /// Waits until there is room, for a scene that is to stand alone or not.
    pub(super) fn enter(&self, alone: bool) -> Standing<'_> {
        match alone {
            true => Standing::Alone {
                _none: self.0.write().unwrap_or_else(PoisonError::into_inner),
            },
            false => Standing::Beside {
                _others: self.0.read().unwrap_or_else(PoisonError::into_inner),
            },
        }
    }

    /// Waits until all others are gone.
    pub(super) fn clear<'p>(&'p self, standing: Standing<'p>) -> Standing<'p> {
        match standing {
            Standing::Alone { .. } => standing,
            Standing::Beside { .. } => {
                // Two that wait for each other to go would wait for ever.
                drop(standing);
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
    fn small_scenes_stand_beside_each_other_and_two_that_turn_out_to_be_large_after_each_other() {
        let (place, both) = (Place::default(), Barrier::new(2));
        let (alone, most) = (Mutex::new(()), AtomicUsize::new(0));
        let set_up = || {
            let standing = place.enter(false);
            // Neither gets here unless the other does.
            both.wait();
            let _standing = place.clear(standing);
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
