//! Memory mapping of files: the only `unsafe` of this module.
//!
//! A mapped file must not be truncated during rendering: the operating system raises SIGBUS at the next read beyond its
//! end, which ends the process. Changes of its bytes change the image, but every index was copied or checked.

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use memmap2::Mmap;

use super::GltfError;

/// Maps the whole of a regular file that is not empty.
pub(super) fn map_file(file: &Path) -> Result<Arc<Mmap>, GltfError> {
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
    // SAFETY: the map is private and only ever read. That the file is not shortened or rewritten while it is mapped is
    // a condition of `load`, stated in its documentation: indices are checked once and then trusted.
    let map = unsafe { Mmap::map(&handle) }.map_err(|e| unreadable(reason(&e)))?;
    Ok(Arc::new(map))
}

/// Returns the operating system's error message without the number of the error.
fn reason(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => "there is no such file".into(),
        std::io::ErrorKind::PermissionDenied => "reading it is not permitted".into(),
        _ => error.to_string(),
    }
}
