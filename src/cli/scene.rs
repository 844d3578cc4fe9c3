//! From a path to a scene, whatever kind of file it is.

use std::path::Path;

use crate::gltf::{self, LoadOptions, Pose};
use crate::scene::{EffectSet, ImageCache};
use crate::scene_file::{self, Edit, Output, SceneFile};

use super::failure::Failure;

/// Whether a name asks for a scene file, which may say something of the picture.
pub(super) fn is_scene_file(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// Loads a scene file if the name ends in `.toml`, after changes of it, else a glTF file, which says nothing of the
/// picture. Images that only the effects `without` look at are not decoded.
pub(super) fn load(
    (path, edits, pose): (&Path, &[Edit], Option<&Pose>),
    without: EffectSet,
) -> Result<SceneFile, Failure> {
    load_from((path, edits, pose), without, &ImageCache::default())
}

/// The same with images that need not be decoded again.
pub(super) fn load_from(
    (path, edits, pose): (&Path, &[Edit], Option<&Pose>),
    without: EffectSet,
    image_cache: &ImageCache,
) -> Result<SceneFile, Failure> {
    let options = LoadOptions {
        without,
        pose: pose.cloned(),
        image_cache: image_cache.clone(),
        ..LoadOptions::default()
    };
    if is_scene_file(path) {
        let mut loaded = scene_file::load_edited(path, edits, &options)?;
        // Each glTF file without animations says so itself.
        if pose.is_some() && loaded.gltf_count == 0 {
            let warning =
                "there are no glTF files in it, which could have animations: it is the same at all times";
            loaded.scene.warnings.push(warning.into());
        }
        return Ok(loaded);
    }
    if let Some(edit) = edits.first() {
        let path = path.display();
        return Err(Failure::Input(format!(
            "{path} cannot have {edit}: sweeps change scene files, so include it in one"
        )));
    }
    Ok(SceneFile {
        scene: gltf::load(path, &options)?,
        output: Output::default(),
        group_count: 0,
        include_count: 0,
        gltf_count: 0,
    })
}
