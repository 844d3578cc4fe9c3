//! Grids that a file contains, from its bytes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::DAffine3;

use super::dtype::ArrayLayout;
use super::fault::{ReadError, content, too_big};
use crate::volume::Grid;

/// Grids and placement that a file contains.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadVolume {
    /// One to four grids of one size: density; or red, green, blue, and optionally density.
    pub channels: Vec<Grid>,
    /// Placement of the cube [-1, 1]³ of the samples, in the file's units; `None` if the file gives none.
    pub world_from_cube: Option<DAffine3>,
}

/// Returns all bytes of a file, at most `max_bytes`.
pub(super) fn bytes_of(path: &Path, max_bytes: u64) -> Result<Vec<u8>, ReadError> {
    let unreadable = |error: std::io::Error| ReadError::Unreadable {
        file: path.to_owned(),
        fault: error.to_string(),
    };
    // Reject by the length in the metadata, before anything is read
    let file = File::open(path).map_err(unreadable)?;
    let length = file.metadata().map_err(unreadable)?.len();
    let too_long = |length: u64| content(path, too_big(length, max_bytes));
    if length > max_bytes {
        return Err(too_long(length));
    }
    let mut bytes = Vec::new();
    // Limit the read too: a pipe has no length, and a file may grow.
    let read = file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes);
    read.map_err(unreadable)?;
    if bytes.len() as u64 > max_bytes {
        return Err(too_long(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Builds the grids of the numbers in `data`, which may have trailing bytes.
pub(super) fn grids(
    path: &Path,
    layout: &ArrayLayout,
    data: &[u8],
    max_bytes: u64,
    world_from_cube: Option<DAffine3>,
) -> Result<ReadVolume, ReadError> {
    layout
        .check(data.len() as u64, max_bytes)
        .map_err(|fault| content(path, fault))?;
    let channels = (0..layout.channels).map(|channel| Grid::new(layout.size, layout.decode(channel, data)));
    let channels = channels
        .collect::<Result<_, _>>()
        .map_err(|source| ReadError::Grid {
            file: path.to_owned(),
            source,
        })?;
    Ok(ReadVolume {
        channels,
        world_from_cube,
    })
}
