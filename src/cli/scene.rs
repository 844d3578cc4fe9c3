//! Loading of scenes from scene files and glTF files.

use std::path::Path;

use whit::gltf::{self, AnimationTime, LoadOptions};
use whit::scene::{EffectSet, ImageCache};
use whit::scene_file::{self, Edit, Output, SceneFile};

use super::failure::Failure;

/// Returns whether the path names a scene file, which may contain image settings.
pub(super) fn is_scene_file(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

/// Loads a scene file with edits if the name ends in `.toml`, else a glTF file, which has no image settings. Images
/// used only by the effects `without` are not decoded.
pub(super) fn load(
    (path, edits, pose): (&Path, &[Edit], Option<&AnimationTime>),
    without: EffectSet,
) -> Result<SceneFile, Failure> {
    load_from((path, edits, pose), without, &ImageCache::default())
}

/// Loads a scene like [`load`], with a cache of decoded images.
pub(super) fn load_from(
    (path, edits, pose): (&Path, &[Edit], Option<&AnimationTime>),
    without: EffectSet,
    image_cache: &ImageCache,
) -> Result<SceneFile, Failure> {
    // Images used only by disabled effects are skipped, others come from the cache
    let options = LoadOptions {
        without,
        pose: pose.cloned(),
        image_cache: image_cache.clone(),
        ..LoadOptions::default()
    };
    if is_scene_file(path) {
        let mut loaded = scene_file::load_edited(path, edits, &options)?;
        // The glTF loader warns of each file without animations; a scene without glTF files is handled here.
        if pose.is_some() && loaded.gltf_count == 0 {
            let warning = "it includes no glTF files and thus has no animations: the time has no effect";
            loaded.scene.warnings.push(warning.into());
        }
        return Ok(loaded);
    }
    // glTF files have no keys that a sweep could change
    if let Some(edit) = edits.first() {
        let path = path.display();
        return Err(Failure::Input(format!(
            "{path} cannot have {edit}: sweeps change scene files only, so include it in a scene file"
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
