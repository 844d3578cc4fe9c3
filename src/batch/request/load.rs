//! Loading of scenes from scene files and glTF files.

use std::path::Path;

use super::error::RequestError;
use crate::gltf::{self, LoadOptions};
use crate::scene_file::{self, Edit, Output, SceneFile};

/// Returns whether the path names a scene file, which may contain image settings.
pub fn is_scene_file(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// Loads a scene file with edits if the name ends in `.toml`, else a glTF file, which has no image settings.
///
/// # Errors
///
/// If a file cannot be read or is invalid, and for edits of a glTF file.
pub fn load_scene(path: &Path, edits: &[Edit], options: &LoadOptions) -> Result<SceneFile, RequestError> {
    if is_scene_file(path) {
        let mut loaded = scene_file::load_edited(path, edits, options)?;
        // The glTF loader warns of each file without animations; a scene without glTF files is handled here.
        if options.pose.is_some() && loaded.gltf_count == 0 {
            let warning = "it includes no glTF files and thus has no animations: the time has no effect";
            loaded.scene.warnings.push(warning.into());
        }
        return Ok(loaded);
    }
    // glTF files have no keys that a sweep could change
    if let Some(edit) = edits.first() {
        return Err(RequestError::EditedGltf {
            path: path.to_owned(),
            edit: edit.to_string(),
        });
    }
    Ok(SceneFile {
        scene: gltf::load(path, options)?,
        output: Output::default(),
        group_count: 0,
        include_count: 0,
        gltf_count: 0,
    })
}
