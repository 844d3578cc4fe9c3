//! Scenes of the folder `scenes`, and small images of them.

use std::path::{Path, PathBuf};

use whit::accel::{self, AccelOptions, Backend};
use whit::gltf::{self, LoadOptions};
use whit::image::LinearImage;
use whit::render::{Monitor, RenderSettings, render};
use whit::scene::Scene;
use whit::scene_file::{self, Output};

/// Scene with its file's output settings and name, without the extension.
pub struct FiledScene {
    pub name: String,
    pub scene: Scene,
    pub output: Output,
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")
}

/// Returns the scene files, sorted by name. Job files, which only refer to scenes, are excluded.
pub fn files() -> Vec<PathBuf> {
    let entries = folder().read_dir().unwrap().map(|entry| entry.unwrap().path());
    let is_scene = |path: &PathBuf| {
        path.extension().is_some_and(|e| e == "toml" || e == "gltf")
            && !path.to_string_lossy().ends_with(".jobs.toml")
    };
    let mut files: Vec<PathBuf> = entries.filter(is_scene).collect();
    files.sort();
    files
}

/// Loads the scene file of this name.
pub fn named(name: &str) -> FiledScene {
    load(&folder().join(name))
}

pub fn load(file: &Path) -> FiledScene {
    let options = LoadOptions::default();
    let (scene, output) = if file.extension().is_some_and(|e| e == "toml") {
        let loaded = scene_file::load(file, &options).unwrap_or_else(|fault| panic!("{fault}"));
        (loaded.scene, loaded.output)
    } else {
        let scene = gltf::load(file, &options).unwrap_or_else(|fault| panic!("{fault}"));
        (scene, Output::default())
    };
    FiledScene {
        name: file.file_stem().unwrap().to_string_lossy().into_owned(),
        scene,
        output,
    }
}

impl FiledScene {
    /// Returns the file's settings with `width` pixels per row, rows in the file's proportion, and `spp` samples per
    /// pixel.
    pub fn settings(&self, width: u32, spp: u32) -> RenderSettings {
        let [w, h] = self.output.size.unwrap_or([4, 3]);
        let defaults = RenderSettings::default();
        RenderSettings {
            width,
            height: (f64::from(width) * f64::from(h) / f64::from(w)).round() as u32,
            spp,
            depth: self.output.depth.unwrap_or(defaults.depth),
            ..defaults
        }
    }

    /// Renders the view of the first camera with `backend`.
    pub fn rendered(&self, backend: Backend, settings: &RenderSettings) -> LinearImage {
        let accel = accel::build(self.scene.validate().unwrap(), backend, &AccelOptions::default()).unwrap();
        let monitor = Monitor::default();
        render(
            self.scene.validate().unwrap(),
            &self.scene.cameras[0],
            &*accel,
            settings,
            &monitor,
        )
        .unwrap()
        .image
    }
}
