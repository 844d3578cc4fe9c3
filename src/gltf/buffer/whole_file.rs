//! Reading of whole files into memory.
//!
//! Files are read, not mapped: a mapped file that another program shortens ends the process by SIGBUS, and one that it
//! rewrites changes indices after they were checked. The bytes lie in huge pages where
//! [`crate::buffer`] uses them, which makes up for the copy.

use std::fs::{self, File, Metadata};
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use memmap2::MmapMut;

use crate::buffer;
use crate::gltf::GltfError;
use crate::parallel;

/// Number of bytes that one task reads.
const CHUNK: usize = 4 << 20;

/// Reads the whole of a regular file that is not empty.
///
/// # Errors
/// The file cannot be read, is empty, or changed while it was read.
pub(in crate::gltf) fn read_file(file: &Path) -> Result<Arc<MmapMut>, GltfError> {
    let unreadable = |fault: String| GltfError::Unreadable {
        file: file.to_owned(),
        fault,
    };
    // Checked before opening, as opening a pipe would wait for its writer.
    let metadata = fs::metadata(file).map_err(|e| unreadable(reason(&e)))?;
    if !metadata.is_file() {
        return Err(unreadable("is not a file".into()));
    }
    if metadata.len() == 0 {
        return Err(GltfError::NotGltf {
            file: file.to_owned(),
            fault: "it is empty".into(),
        });
    }
    let handle = File::open(file).map_err(|e| unreadable(reason(&e)))?;
    let before = handle.metadata().map_err(|e| unreadable(reason(&e)))?;
    // Read chunks in parallel
    let size = usize::try_from(before.len()).unwrap_or(usize::MAX);
    let mut bytes = buffer::anonymous_map(size).map_err(|e| unreadable(reason(&e)))?;
    let failure = Mutex::new(None);
    parallel::for_each_chunk_mut(&mut bytes, CHUNK, &|chunk, bytes| {
        if let Err(error) = read_at(&handle, bytes, chunk * CHUNK) {
            *failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    });
    let changed = || unreadable("it changed while it was read".into());
    match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
        None => {}
        Some(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Err(changed()),
        Some(error) => return Err(unreadable(reason(&error))),
    }
    // Refuse a mixture of old and new bytes
    let after = handle.metadata().map_err(|e| unreadable(reason(&e)))?;
    match is_same(&before, &after) {
        true => Ok(Arc::new(bytes)),
        false => Err(changed()),
    }
}

/// Fills `bytes` from the file, from `offset` on.
#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], offset: usize) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset as u64)
}

/// Fills `bytes` from the file, from `offset` on.
#[cfg(not(unix))]
fn read_at(file: &File, bytes: &mut [u8], offset: usize) -> io::Result<()> {
    use std::io::{Read, Seek, SeekFrom};

    // A duplicate handle shares its place in the file with the first, so the reads take turns
    static TURN: Mutex<()> = Mutex::new(());
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let mut file = file;
    file.seek(SeekFrom::Start(offset as u64))?;
    file.read_exact(bytes)
}

/// Returns whether a file has the same size and time of its last change.
fn is_same(before: &Metadata, after: &Metadata) -> bool {
    before.len() == after.len() && before.modified().ok() == after.modified().ok()
}

/// Returns the operating system's error message without the number of the error.
fn reason(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "there is no such file".into(),
        io::ErrorKind::PermissionDenied => "reading it is not permitted".into(),
        _ => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_of_several_chunks_are_those_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bytes");
        let expected: Vec<u8> = (0..2 * CHUNK + 5).map(|i| (i * 31 % 251) as u8).collect();
        fs::write(&path, &expected).unwrap();
        let bytes = read_file(&path).unwrap();
        assert!(bytes[..] == expected[..]);
        // The bytes stay when the file is shortened
        fs::write(&path, b"short").unwrap();
        assert!(bytes[..] == expected[..]);
    }

    #[test]
    fn folders_and_empty_and_absent_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let empty = folder.path().join("empty");
        fs::write(&empty, b"").unwrap();
        assert!(matches!(read_file(&empty), Err(GltfError::NotGltf { .. })));
        for path in [folder.path().to_owned(), folder.path().join("absent")] {
            assert!(matches!(read_file(&path), Err(GltfError::Unreadable { .. })));
        }
    }

    #[test]
    fn file_of_another_size_or_time_is_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bytes");
        fs::write(&path, b"12").unwrap();
        let before = fs::metadata(&path).unwrap();
        assert!(is_same(&before, &fs::metadata(&path).unwrap()));
        let later = before.modified().unwrap() + std::time::Duration::from_secs(1);
        File::options()
            .write(true)
            .open(&path)
            .unwrap()
            .set_modified(later)
            .unwrap();
        assert!(!is_same(&before, &fs::metadata(&path).unwrap()));
    }
}
