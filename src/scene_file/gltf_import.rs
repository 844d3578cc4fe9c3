//! Imports of glTF files by the objects of a scene file.

use std::path::{Path, PathBuf};

use super::document::ObjectForm;
use super::fault::Diagnostic;

/// Identity of an imported glTF file: objects with other points need another copy of it.
#[derive(PartialEq, Eq, Hash)]
pub(super) struct ImportKey {
    file: PathBuf,
    /// Bits of the diameter of its points, if it is given.
    point_size: Option<u64>,
}

impl ImportKey {
    /// Creates the identity of the file at `path`, whose points get the diameter `point_size`.
    pub(super) fn new(path: &Path, point_size: Option<f64>) -> ImportKey {
        ImportKey {
            file: path.canonicalize().unwrap_or_else(|_| path.to_owned()),
            point_size: point_size.map(f64::to_bits),
        }
    }
}

/// Checks the diameter that an object gives its points, if it has points.
pub(super) fn check_point_size(form: &ObjectForm) -> Result<(), Diagnostic> {
    let Some(size) = &form.point_size else {
        return Ok(());
    };
    if form.gltf.is_none() {
        return Err(size.fault("belongs to an object without points: give `point_size` only to `gltf`"));
    }
    if !(**size > 0.0 && size.is_finite()) {
        return Err(size.fault("is no diameter of points: give a positive number"));
    }
    Ok(())
}
