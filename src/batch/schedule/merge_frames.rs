//! Merging of all frames whose pieces are present, whichever processes rendered them.

use std::path::Path;

use crate::batch::error::BatchError;
use crate::batch::manifest::Manifest;
use crate::batch::ongoing_writes::OngoingWrites;
use crate::batch::pieces::{self, ChunkDirectory, MergeError};
use crate::batch::shard::Shard;

/// Merges all frames in the output folder `out` whose pieces are present. After each, `report` receives its image, and
/// whether it was merged or was done already; an error of `report` ends the work.
///
/// # Errors
///
/// If the folder cannot be read, or any frame cannot be merged.
pub fn merge_frames<E: From<BatchError>>(
    out: &Path,
    writes: &OngoingWrites,
    mut report: impl FnMut(&Path, Result<bool, BatchError>) -> Result<(), E>,
) -> Result<(), E> {
    // Find all frames with pieces
    let unreadable = |error| BatchError::Read(out.to_owned(), error);
    if !out.is_dir() {
        return Err(BatchError::NoFolder(out.to_owned()).into());
    }
    let folders = ChunkDirectory::all(out).map_err(unreadable)?;
    if folders.is_empty() {
        return Ok(());
    }
    let mut manifest = Manifest::open(out, Shard::ALL).map_err(unreadable)?;
    let mut failed = 0;
    // Merge each frame; one failure does not stop the others
    for folder in &folders {
        let merged = merge_frame(out, folder, &mut manifest, writes);
        failed += usize::from(merged.is_err());
        report(&folder.head().image, merged)?;
    }
    match failed {
        0 => Ok(()),
        _ => Err(BatchError::UnmergedFrames(failed, folders.len()).into()),
    }
}

/// Merges a frame and adds it to the manifest; returns whether it did. Removes the pieces of a frame that is done
/// already.
fn merge_frame(
    out: &Path,
    folder: &ChunkDirectory,
    manifest: &mut Manifest,
    writes: &OngoingWrites,
) -> Result<bool, BatchError> {
    let head = folder.head();
    if manifest.find(&head.image, head.key).is_some() {
        folder.remove();
        return Ok(false);
    }
    // Merge, then record the image in the manifest
    match pieces::merge(out, folder, writes) {
        Ok(()) => {
            manifest.add_image(head, f64::from(head.spp), [0.0; 2], writes)?;
            Ok(true)
        }
        // A process of the batch may have merged the frame meanwhile.
        Err(_) if manifest.read_again().is_ok() && manifest.find(&head.image, head.key).is_some() => {
            Ok(false)
        }
        Err(error @ MergeError::Missing { .. }) => {
            Err(BatchError::Unfinished(error, folder.folder().to_owned()))
        }
        Err(error) => Err(error.into()),
    }
}
