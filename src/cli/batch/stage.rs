//! A scene that is ready to be rendered, for all frames of it in a row: loaded once, its structure built once.

use std::path::PathBuf;
use std::time::Instant;

use glam::DVec3;

use crate::accel::{Accel, AccelOptions, MeshCounts, MeshLarder};
use crate::batch::{Key, Keyring, Sources};
use crate::gltf::Pose;
use crate::render::RenderSettings;
use crate::report::memory::MemoryForecast;
use crate::scene::{Camera, Larder, Scene};
use crate::scene_file::SceneFile;

use super::super::failure::Failure;
use super::super::job::{RenderJob, choose_camera};
use super::super::progress::Progress;
use super::super::render;
use super::plan::Plan;
use super::rows::Film;

/// What scenes leave for those that come next: of the last one only what was in it.
pub(super) struct Kept {
    images: Larder,
    /// Where there is more than one scene.
    meshes: Option<MeshLarder>,
}

impl Kept {
    /// Nothing yet, for the scenes of these frames.
    pub(super) fn for_frames(plans: &[Plan]) -> Kept {
        let differ = plans.windows(2).any(|pair| !pair[0].shares_scene_with(&pair[1]));
        Kept {
            images: Larder::new(),
            meshes: differ.then(MeshLarder::default),
        }
    }

    /// What it has spared, in words.
    pub(super) fn tell(&self) -> String {
        let images = self.images.counts();
        let meshes = self
            .meshes
            .as_ref()
            .map_or_else(MeshCounts::default, MeshLarder::counts);
        let mut lines = String::new();
        if images.found > 0 {
            let (found, asked) = (images.found, images.asked);
            lines += &format!("{found} of {asked} images were decoded already for a scene before\n");
        }
        if meshes.found > 0 {
            let (found, asked) = (meshes.found, meshes.asked);
            lines +=
                &format!("{found} of {asked} meshes were made ready for rays already for a scene before\n");
        }
        lines
    }
}

/// A loaded scene.
pub(super) struct Loaded {
    pub(super) file: SceneFile,
    pub(super) seconds: f64,
    /// The middle of what there is, about which cameras turn.
    pub(super) middle: DVec3,
}

impl Loaded {
    pub(super) fn new(plan: &Plan, kept: &Kept, progress: &Progress) -> Result<Loaded, Failure> {
        let start = Instant::now();
        let frame = &plan.frame;
        let pose = frame.moment.as_ref().map(|moment| Pose {
            animation: moment.animation.clone(),
            seconds: moment.seconds,
        });
        let file = render::load(
            &plan.job,
            (&frame.scene, &frame.edits, pose.as_ref()),
            &kept.images,
        )?;
        kept.images.clear_out();
        for warning in &file.scene.warnings {
            progress.warn(&format!("{}: {warning}", frame.scene.display()));
        }
        let bounds = file.scene.bounds();
        let middle = if bounds.is_empty() {
            DVec3::ZERO
        } else {
            bounds.center()
        };
        Ok(Loaded {
            middle,
            seconds: start.elapsed().as_secs_f64(),
            file,
        })
    }

    /// The camera of a frame.
    pub(super) fn camera(&self, plan: &Plan) -> Result<Camera, Failure> {
        let scene = &self.file.scene;
        let wish = plan.frame.camera.as_deref();
        let camera = choose_camera(scene, &plan.frame.scene, wish)?;
        Ok(plan.frame.view.of(camera, scene, self.middle))
    }

    /// Bytes that the scene and what finds the hits in it take, about.
    fn bytes(&self, job: &RenderJob) -> u64 {
        let forecast = MemoryForecast::of(&self.file.scene);
        let tree = match job.backend {
            crate::accel::Backend::Embree => forecast.embree_bytes,
            crate::accel::Backend::Bsp => forecast.bsp_bytes,
            crate::accel::Backend::Brute => 0,
        };
        forecast.scene_bytes + tree + forecast.subsurface_bytes
    }
}

/// A loaded scene with what finds the hits in it.
pub(super) struct Stage<'s> {
    pub(super) loaded: &'s Loaded,
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) build_seconds: f64,
    /// What is kept for the scenes that come next.
    kept_bytes: u64,
}

impl<'s> Stage<'s> {
    pub(super) fn new(
        plan: &Plan,
        loaded: &'s Loaded,
        kept: &Kept,
        progress: &Progress,
    ) -> Result<Stage<'s>, Failure> {
        let start = Instant::now();
        let options = AccelOptions {
            larder: kept.meshes.as_ref(),
            ..plan.job.tracing.options()
        };
        let accel = render::build_with(&plan.job, &loaded.file.scene, progress, options)?;
        let kept_bytes = kept.meshes.as_ref().map_or(0, |meshes| {
            meshes.clear_out();
            meshes.byte_count()
        });
        Ok(Stage {
            loaded,
            kept_bytes,
            accel,
            build_seconds: start.elapsed().as_secs_f64(),
        })
    }

    pub(super) fn scene(&self) -> &'s Scene {
        &self.loaded.file.scene
    }

    /// Bytes that all of it takes, about.
    pub(super) fn bytes(&self, job: &RenderJob) -> u64 {
        self.loaded.bytes(job) + self.kept_bytes
    }

    /// What is kept of a picture of it.
    pub(super) fn film(&self, settings: &RenderSettings) -> Film {
        Film {
            settings: *settings,
            light_count: self.scene().lights.len(),
        }
    }
}

/// What a frame is made of: its files, what is said of it, and what makes it. Known before its scene is loaded.
pub(super) fn key(plan: &Plan, sources: &mut Sources) -> Result<Key, Failure> {
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
    Ok(ring.key())
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
