//! Merging of all frames whose pieces are present, whichever processes rendered them.

use std::path::Path;

use crate::batch::error::BatchError;
use crate::batch::manifest::Manifest;
use crate::batch::ongoing_writes::OngoingWrites;
use crate::batch::pieces::{self, ChunkDirectory, MergeError};
use crate::batch::shard::Shard;

/// Returns the piece folders of all frames in the output folder `out`, with the manifest of the folder.
///
/// # Errors
///
/// If there is no such folder, or it cannot be read.
pub fn frames_with_pieces(out: &Path) -> Result<Option<(Vec<ChunkDirectory>, Manifest)>, BatchError> {
    let unreadable = |error| BatchError::Read(out.to_owned(), error);
    if !out.is_dir() {
        return Err(BatchError::NoFolder(out.to_owned()));
    }
    let folders = ChunkDirectory::all(out).map_err(unreadable)?;
    if folders.is_empty() {
        return Ok(None);
    }
    let manifest = Manifest::open(out, Shard::ALL).map_err(unreadable)?;
    Ok(Some((folders, manifest)))
}

/// Merges a frame and adds it to the manifest; returns whether it did. Removes the pieces of a frame that is done
/// already.
///
/// # Errors
///
/// If pieces are missing or unreadable, or the image cannot be written.
pub fn merge_frame(
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
