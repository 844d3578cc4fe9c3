//! What a frame is made of: its files, what is said of it, and what makes it. Known before its scene is loaded.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::batch::{Key, Keyring, Sources};

use super::super::failure::Failure;
use super::super::job::RenderJob;
use super::plan::Plan;

/// What a frame is made of.
#[derive(Clone)]
pub(super) struct Recipe {
    /// All of it.
    pub(super) key: Key,
    /// The files, with what they hold, for people.
    pub(super) files: String,
}

impl Recipe {
    /// Of a frame.
    ///
    /// # Errors
    ///
    /// Where a file that it needs cannot be read.
    pub(super) fn of(plan: &Plan, sources: &mut Sources) -> Result<Recipe, Failure> {
        let frame = &plan.frame;
        let words: Vec<&str> = frame
            .edits
            .iter()
            .filter_map(|edit| edit.value.as_str())
            .collect();
        let unreadable = |error| Failure::Input(format!("{} cannot be read: {error}", frame.scene.display()));
        let files = sources.of(&frame.scene, &words).map_err(unreadable)?;
        let mut ring = Keyring::default();
        ring.add("version", env!("CARGO_PKG_VERSION"));
        ring.add("backend", engine(&plan.job)?);
        for (path, key) in &files {
            let name = path.file_name().unwrap_or_default();
            ring.add("file", name.as_encoded_bytes())
                .add("holds", key.digits());
        }
        for edit in &frame.edits {
            ring.add("edit", edit.to_string());
        }
        for (name, value) in &frame.settings.flags {
            ring.add(name, format!("{value:?}"));
        }
        if let Some(file) = settings_file(plan) {
            let text = std::fs::read(&file)
                .map_err(|error| Failure::Input(format!("{} cannot be read: {error}", file.display())))?;
            ring.add("settings file", text);
        }
        ring.add("camera", frame.camera.as_deref().unwrap_or_default());
        ring.add("view", format!("{:?}", frame.view));
        ring.add("moment", format!("{:?}", frame.moment));
        ring.add("shares", frame.settings.shares.to_string());
        // Frames that differ in name alone keep their pieces apart.
        ring.add("image", plan.frame.image.as_os_str().as_encoded_bytes());
        Ok(Recipe {
            key: ring.key(),
            files: listed(&files, &frame.scene),
        })
    }
}

/// Hashes and names of files, a line each, as the program `b3sum` writes them: names from the scene's folder on.
fn listed(files: &[(PathBuf, Key)], scene: &Path) -> String {
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

/// A file of settings that a job takes.
fn settings_file(plan: &Plan) -> Option<PathBuf> {
    use crate::jobs::FlagValue;
    let flags = &plan.frame.settings.flags;
    flags.iter().find_map(|(name, value)| match value {
        FlagValue::Word(file) if name == "settings" => Some(plan.jobs_folder.join(file)),
        _ => None,
    })
}

/// What finds the hits, to the version and the instruction set, on which bits depend.
fn engine(job: &RenderJob) -> Result<String, Failure> {
    let identity = crate::accel::identity(job.backend, job.tracing.isa.as_deref())?;
    Ok(format!("{:?} {identity:?}", job.backend))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_listed_by_their_names_within_the_scenes_folder() {
        let key = |text: &str| Keyring::default().add("", text).key();
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
