//! At most one process a shard and folder, as far as that can be known.
//!
//! The system holds the lock and lets go of it when the process ends, however it ends. A process on another machine may
//! not see it, and may be a ghost: a task that its scheduler has given up and started anew elsewhere. So a lock only
//! spares work that is done already; that nothing is harmed rests on outputs that are the same whoever makes them, and
//! that appear whole.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::Path;

/// Held as long as it lives.
#[derive(Debug)]
pub struct Lock {
    _file: File,
}

/// Who has what was asked for.
#[derive(Debug)]
pub enum LockError {
    /// Another process; what it says of itself.
    Held(String),
    /// The system could not tell.
    Unknown(io::Error),
}

impl Lock {
    /// Takes the lock of this name, saying `who` has it.
    pub fn take(path: &Path, who: &str) -> Result<Lock, LockError> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(LockError::Unknown)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                // Who it is is only for people.
                let _ = file.read_to_string(&mut holder);
                return Err(LockError::Held(holder.trim().to_owned()));
            }
            Err(TryLockError::Error(error)) => return Err(LockError::Unknown(error)),
        }
        let write = |file: &mut File| {
            file.set_len(0)?;
            file.rewind()?;
            file.write_all(who.as_bytes())
        };
        // The same: on a full disk the lock holds all the same.
        let _ = write(&mut file);
        Ok(Lock { _file: file })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_is_held_by_one_and_free_when_that_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.lock");
        let first = Lock::take(&path, "process 1").unwrap();
        match Lock::take(&path, "process 2") {
            Err(LockError::Held(who)) => assert_eq!(who, "process 1"),
            other => panic!("{other:?}"),
        }
        drop(first);
        Lock::take(&path, "process 2").unwrap();
        let missing = folder.path().join("no/a.lock");
        assert!(matches!(Lock::take(&missing, ""), Err(LockError::Unknown(_))));
    }
}
