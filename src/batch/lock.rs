//! File lock that keeps two processes from working on the same shard of an output folder.
//!
//! The operating system holds the lock and releases it when the process ends, for any reason. A process on another
//! machine may not see the lock, and may be a leftover: a task that its scheduler has given up and restarted elsewhere.
//! The lock therefore only avoids duplicate work; correctness relies on outputs that are identical for every process
//! and that appear whole.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::Path;

use super::error::BatchError;
use super::options::BatchOptions;
use super::shard::Shard;

/// Exclusive lock on a file, released when dropped.
#[derive(Debug)]
pub(crate) struct Lock {
    _file: File,
}

/// Reasons why a lock could not be taken.
#[derive(Debug)]
pub(crate) enum LockError {
    /// Another process holds the lock; its description of itself.
    Held(String),
    /// The operating system reported an error.
    Unknown,
}

impl Lock {
    /// Takes the lock file `path` and writes the description `who` of the holder into it.
    pub(crate) fn take(path: &Path, who: &str) -> Result<Lock, LockError> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(|_| LockError::Unknown)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                // The description is informational, so an unreadable one is ignored.
                let _ = file.read_to_string(&mut holder);
                return Err(LockError::Held(holder.trim().to_owned()));
            }
            Err(TryLockError::Error(_)) => return Err(LockError::Unknown),
        }
        let write = |file: &mut File| {
            file.set_len(0)?;
            file.rewind()?;
            file.write_all(who.as_bytes())
        };
        // The description is informational: on a full disk the lock is still held.
        let _ = write(&mut file);
        Ok(Lock { _file: file })
    }
}

/// Takes the lock that keeps other processes of this machine from rendering the same shard. Returns `None` where
/// another process holds it without harm, with a warning, or where the file system has no locks.
pub(super) fn lock_shard(options: &BatchOptions, warn: &dyn Fn(&str)) -> Result<Option<Lock>, BatchError> {
    let BatchOptions { out, shard, .. } = options;
    let name = format!(".whit-batch.{}-of-{}.lock", shard.number, shard.count);
    match Lock::take(&out.join(name), &describe_process()) {
        Ok(lock) => Ok(Some(lock)),
        // On this machine, a batch without shards must not run twice
        Err(LockError::Held(holder))
            if *shard == Shard::ALL && holder.ends_with(&format!(" on {}", host())) =>
        {
            Err(BatchError::Locked(out.clone(), holder))
        }
        // The holder may be the leftover of a restarted task and may never end; two processes do no harm.
        Err(LockError::Held(holder)) => {
            warn(&format!(
                "another whit ({holder}) renders the same shard: both continue and write the same bytes"
            ));
            Ok(None)
        }
        // Some network file systems do not support locks.
        Err(LockError::Unknown) => Ok(None),
    }
}

/// Returns the description of this process in locks and manifests.
pub(super) fn describe_process() -> String {
    format!("process {} on {}", std::process::id(), host())
}

/// Returns the host name of this machine.
fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    name.trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lock_has_one_holder_and_is_free_after_release() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.lock");
        let first = Lock::take(&path, "process 1").unwrap();
        // The second process learns who holds the lock
        match Lock::take(&path, "process 2") {
            Err(LockError::Held(who)) => assert_eq!(who, "process 1"),
            other => panic!("{other:?}"),
        }
        drop(first);
        Lock::take(&path, "process 2").unwrap();
        let missing = folder.path().join("no/a.lock");
        assert!(matches!(Lock::take(&missing, ""), Err(LockError::Unknown)));
    }
}
