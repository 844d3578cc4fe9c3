//! Inputs of a frame, hashed before its scene is loaded: files, settings, and the backend that renders it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::accel;
use crate::batch::dependencies::Sources;
use crate::batch::error::BatchError;
use crate::batch::fingerprint::{Fingerprint, FingerprintHasher};
use crate::batch::plan::PlannedFrame;
use crate::batch::request::{EnvironmentSource, RenderRequest, RequestError};
use crate::jobs::FlagValue;

/// Hash and list of a frame's inputs.
#[derive(Clone)]
pub(super) struct FrameFingerprint {
    /// Hash of all inputs of the frame.
    pub(super) key: Fingerprint,
    /// Hashes and names of the input files, in readable form.
    pub(super) files: String,
}

impl FrameFingerprint {
    /// Hashes the inputs of a frame.
    pub(super) fn of(plan: &PlannedFrame, sources: &mut Sources) -> Result<FrameFingerprint, BatchError> {
        let frame = &plan.frame;
        // Find and hash the scene's files, including those that edits name
        let words: Vec<&str> = frame
            .edits
            .iter()
            .filter_map(|edit| edit.value.as_str())
            .collect();
        let unreadable = |path: &Path, error| BatchError::Read(path.to_owned(), error);
        let files = sources
            .of(&frame.scene, &words)
            .map_err(|error| unreadable(&frame.scene, error))?;
        let mut hasher = FingerprintHasher::default();
        // Hash the program's version and the backend
        hasher.add("version", env!("CARGO_PKG_VERSION"));
        hasher.add("backend", backend_identity(&plan.request)?);
        for (path, key) in &files {
            let name = path.file_name().unwrap_or_default();
            hasher
                .add("file", name.as_encoded_bytes())
                .add("holds", key.digits());
        }
        // Hash the edits, the settings and the settings file
        for edit in &frame.edits {
            hasher.add("edit", edit.to_string());
        }
        for (name, value) in &frame.settings.flags {
            hasher.add(name, format!("{value:?}"));
        }
        if let Some(file) = settings_file(plan) {
            let text = std::fs::read(&file).map_err(|error| unreadable(&file, error))?;
            hasher.add("settings file", text);
        }
        if let Some(file) = environment_file(plan) {
            let key = Fingerprint::of_file(file).map_err(|error| unreadable(file, error))?;
            hasher.add("environment file", key.digits());
        }
        // Hash the camera, the time and the number of shares, which the rounding of sums depends on
        hasher.add("camera", frame.camera.as_deref().unwrap_or_default());
        hasher.add("view", format!("{:?}", frame.view));
        hasher.add("moment", format!("{:?}", frame.moment));
        hasher.add("shares", frame.settings.shares.to_string());
        // The name of the image keeps the pieces of otherwise identical frames apart.
        hasher.add("image", plan.frame.image.as_os_str().as_encoded_bytes());
        Ok(FrameFingerprint {
            key: hasher.key(),
            files: listed(&files, &frame.scene),
        })
    }
}

/// Returns hashes and names of files, one per line, in the format of the program `b3sum`; names are relative to the
/// scene's folder.
fn listed(files: &[(PathBuf, Fingerprint)], scene: &Path) -> String {
    let folder = scene.parent().unwrap_or(Path::new(""));
    let name = |path: &Path| match path.strip_prefix(folder) {
        Ok(within) => within.display().to_string(),
        Err(_) => path.file_name().unwrap_or_default().display().to_string(),
    };
    let lines: BTreeSet<(String, String)> = files
        .iter()
        .map(|(path, key)| (name(path), key.digits()))
        .collect();
    lines.into_iter().fold(String::new(), |text, (name, digits)| {
        text + &format!("{digits}  {name}\n")
    })
}

/// Returns the path of the environment map of a job, if it has one that is read from a file.
fn environment_file(plan: &PlannedFrame) -> Option<&Path> {
    match &plan.request.environment.as_ref()?.source {
        EnvironmentSource::File(path) => Some(path),
        EnvironmentSource::BuiltIn(_) => None,
    }
}

/// Returns the path of the settings file of a job, if it has one.
fn settings_file(plan: &PlannedFrame) -> Option<PathBuf> {
    let flags = &plan.frame.settings.flags;
    flags.iter().find_map(|(name, value)| match value {
        FlagValue::Word(file) if name == "settings" => Some(plan.jobs_folder.join(file)),
        _ => None,
    })
}

/// Returns the backend with its version and instruction set, which the bits of an image depend on.
fn backend_identity(request: &RenderRequest) -> Result<String, BatchError> {
    let identity = accel::identity(request.backend(), request.tracing.isa.as_deref());
    let identity = identity.map_err(RequestError::from)?;
    Ok(format!("{:?} {identity:?}", request.backend()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_listed_by_name_relative_to_the_scene_folder() {
        let key = |text: &str| FingerprintHasher::default().add("", text).key();
        let files = [
            ("scenes/b.toml".into(), key("b")),
            ("scenes/textures/a.png".into(), key("a")),
            ("/elsewhere/c.glb".into(), key("c")),
        ];
        let text = listed(&files, Path::new("scenes/b.toml"));
        let names: Vec<&str> = text.lines().map(|line| &line[66..]).collect();
        assert_eq!(names, ["b.toml", "c.glb", "textures/a.png"]);
        assert!(text.starts_with(&key("b").digits()));
    }
}
