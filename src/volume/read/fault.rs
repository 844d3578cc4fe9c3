//! Faults of files that cannot be read as a grid.

use std::path::{Path, PathBuf};

use crate::volume::VolumeError;

/// Reasons that a file could not be read as a grid. Each message is one sentence: the fault, its location and the
/// remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
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
pub(super) struct VolumeFault {
    pub(super) fault: String,
    pub(super) remedy: &'static str,
}

impl VolumeFault {
    /// Creates a fault with its remedy.
    pub(super) fn new(fault: impl Into<String>, remedy: &'static str) -> VolumeFault {
        VolumeFault {
            fault: fault.into(),
            remedy,
        }
    }
}

/// Remedy for a damaged header.
pub(super) const SAVE_AGAIN: &str = "save the file again";
/// Remedy for arrays of an unsupported rank.
pub(super) const THREE_AXES: &str = "give an array of three axes, or of four with 1 to 4 channels";

/// Adds the path of a file to a fault of its content.
pub(super) fn content(path: &Path, fault: VolumeFault) -> ReadError {
    ReadError::Content {
        file: path.to_owned(),
        fault: fault.fault,
        remedy: fault.remedy,
    }
}

/// Returns the fault of an array that exceeds the memory limit.
pub(super) fn too_big(bytes: u64, max_bytes: u64) -> VolumeFault {
    let fault = format!("takes {bytes} bytes of memory where {max_bytes} are allowed");
    VolumeFault::new(fault, "give a smaller array or allow more memory")
}
