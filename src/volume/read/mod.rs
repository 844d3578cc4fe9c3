//! Readers for 3-D arrays: NumPy `.npy`, NRRD, and raw numbers described by the caller.
//!
//! Files are untrusted: nothing is allocated before the size that a header claims was checked against the bytes present
//! and against the caller's limit; every fault is reported in one sentence with the file and a remedy.
//!
//! Axes: x runs fastest in NRRD and raw files; a NumPy array is indexed `[z, y, x]`, with `[z, y, x, c]` for two to
//! four channels, in C or Fortran order.
//!
//! OpenVDB files are rejected with the advice to convert them. The one crate that reads them in Rust, vdb-rs, has had
//! no release since January 2024, does not build its own documentation, panics on files that are damaged or of an older
//! version, drops background values and constant tiles, and decompresses untrusted bytes through C; the OpenVDB library
//! itself is C++ with a dozen dependencies.

mod dtype;
mod npy;
mod nrrd;
mod raw;

#[cfg(test)]
mod tests;

pub use dtype::{ByteOrder, Element};
pub use raw::{RawHeader, read_raw};

use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::DAffine3;

use super::{Grid, VolumeError};

/// Grids and placement that a file contains.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadVolume {
    /// One to four grids of one size: density; or red, green, blue, and optionally density.
    pub channels: Vec<Grid>,
    /// Placement of the cube [-1, 1]³ of the samples, in the file's units; `None` if the file gives none.
    pub world_from_cube: Option<DAffine3>,
}

/// Reasons that a file could not be read as a grid. Each message is one sentence: the fault, its location and the
/// remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReadError {
    /// File that the operating system cannot open or read.
    #[error("{}: cannot be read ({fault}): check the path and whether you may read the file", .file.display())]
    Unreadable {
        /// Path of the rejected file.
        file: PathBuf,
        /// Error message of the operating system.
        fault: String,
    },
    /// File whose content is invalid or unsupported.
    #[error("{}: {fault}: {remedy}", .file.display())]
    Content {
        /// Path of the rejected file.
        file: PathBuf,
        /// Description of the fault, as the predicate of a sentence.
        fault: String,
        /// Remedy, as a request to the user.
        remedy: &'static str,
    },
    /// File whose numbers form no valid grid.
    #[error("{}: {source}", .file.display())]
    Grid {
        /// Path of the rejected file.
        file: PathBuf,
        /// Reason from the grid's validation.
        source: VolumeError,
    },
}

/// Fault of a file's content with its remedy, before the path is added.
#[derive(Clone, Debug, PartialEq)]
struct Fault {
    fault: String,
    remedy: &'static str,
}

impl Fault {
    fn new(fault: impl Into<String>, remedy: &'static str) -> Fault {
        Fault {
            fault: fault.into(),
            remedy,
        }
    }
}

/// Remedy for a damaged header.
const SAVE_AGAIN: &str = "save the file again";
/// Remedy for arrays of an unsupported rank.
const THREE_AXES: &str = "give an array of three axes, or of four with 1 to 4 channels";

/// Reads the array at `path`, in the format of its extension: `.npy`, `.nrrd` or `.nhdr`.
///
/// Neither the file nor its decoded numbers may take more than `max_bytes` of memory.
pub fn read(path: &Path, max_bytes: u64) -> Result<ReadVolume, ReadError> {
    let ending = path.extension().and_then(OsStr::to_str).unwrap_or_default();
    match ending.to_ascii_lowercase().as_str() {
        "npy" => {
            let bytes = bytes_of(path, max_bytes)?;
            let array = npy::parse(&bytes).map_err(|fault| content(path, fault))?;
            let data = &bytes[array.data_start..];
            grids(path, &array.layout, data, max_bytes, None)
        }
        "nrrd" | "nhdr" => nrrd::read(path, max_bytes),
        "vdb" => {
            let remedy = "convert it, as by `copyToArray` of the Python module openvdb and `numpy.save`";
            let fault = "is an OpenVDB file, which is not supported";
            Err(content(path, Fault::new(fault, remedy)))
        }
        _ => {
            let fault = format!("its extension {ending:?} is not that of a known array format");
            let remedy = "give a .npy or .nrrd file, or describe it as raw numbers";
            Err(content(path, Fault::new(fault, remedy)))
        }
    }
}

/// Adds the path of a file to a fault of its content.
fn content(path: &Path, fault: Fault) -> ReadError {
    ReadError::Content {
        file: path.to_owned(),
        fault: fault.fault,
        remedy: fault.remedy,
    }
}

/// Returns all bytes of a file, at most `max_bytes`.
fn bytes_of(path: &Path, max_bytes: u64) -> Result<Vec<u8>, ReadError> {
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

/// Returns the fault of an array that exceeds the memory limit.
fn too_big(bytes: u64, max_bytes: u64) -> Fault {
    let fault = format!("takes {bytes} bytes of memory where {max_bytes} are allowed");
    Fault::new(fault, "give a smaller array or allow more memory")
}

/// Builds the grids of the numbers in `data`, which may have trailing bytes.
fn grids(
    path: &Path,
    layout: &dtype::Layout,
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
