//! Text of scene and job files, read within a limit of size, and edited for sweeps.

use std::path::Path;

use super::SceneFileError;
use super::edit::Edit;
use super::fault::{Source, file_error};

/// Largest scene file in bytes; a mesh of that size belongs into a glTF file.
const MAX_BYTES: u64 = 1 << 26;

/// Returns the file's source after the edits.
pub(super) fn edited(source: Source, edits: &[Edit]) -> Result<Source, SceneFileError> {
    if edits.is_empty() {
        return Ok(source);
    }
    // Edit the parsed table and print it again
    let table = source.text.parse::<toml::Table>();
    let mut table = table.map_err(|error| source.toml_error(&error.into()))?;
    for edit in edits {
        edit.apply(&mut table).map_err(|sentence| {
            file_error(&source.path, format!("cannot have the swept {edit}: {sentence}"))
        })?;
    }
    Ok(Source {
        text: table.to_string(),
        ..source
    })
}

/// Reads the text of the file at `path`.
pub(crate) fn read(path: &Path) -> Result<Source, SceneFileError> {
    let unreadable = |e: std::io::Error| file_error(path, format!("cannot be read ({e}): check the path"));
    // Check the size before reading
    let size = std::fs::metadata(path).map_err(unreadable)?.len();
    if size > MAX_BYTES {
        return Err(file_error(
            path,
            format!("has {size} bytes: put its meshes into a glTF file and give it as `gltf`"),
        ));
    }
    let bytes = std::fs::read(path).map_err(unreadable)?;
    match String::from_utf8(bytes) {
        Ok(text) => Ok(Source {
            path: path.to_owned(),
            text,
        }),
        Err(_) => Err(file_error(path, "is not text: give a scene file in TOML")),
    }
}
