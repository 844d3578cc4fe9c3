//! Scene ready for rendering, shared by consecutive frames: loaded once, acceleration structure built once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;

use crate::accel::{Accel, AccelOptions, Backend, MeshCache, MeshCounts};
use crate::gltf::Pose;
use crate::render::RenderSettings;
use crate::report::memory::{MemoryForecast, available_bytes};
use crate::scene::{Camera, ImageCache, Scene};
use crate::scene_file::SceneFile;

use super::super::failure::Failure;
use super::super::job::{RenderJob, choose_camera};
use super::super::progress::Progress;
use super::super::render;
use super::plan::Plan;
use super::rows::Film;

/// A scene is large if it takes more than one part in this many of the free memory.
const LARGE_PART: u64 = 8;

/// Caches that scenes leave for the next: only the contents of the last scene remain.
pub(super) struct Kept {
    images: ImageCache,
    /// Cache of built meshes, present only for more than one scene.
    meshes: Option<MeshCache>,
}

impl Kept {
    /// Returns empty caches for the scenes of these frames.
    pub(super) fn for_frames(plans: &[Plan]) -> Kept {
        let differ = plans.windows(2).any(|pair| !pair[0].shares_scene_with(&pair[1]));
        Kept {
            images: ImageCache::new(),
            meshes: differ.then(MeshCache::default),
        }
    }

    /// Returns the bytes of the caches that are not part of any scene.
    pub(super) fn bytes(&self) -> u64 {
        self.meshes.as_ref().map_or(0, MeshCache::byte_count)
    }

    /// Returns a report of the cache hits, one line each; empty without hits.
    pub(super) fn tell(&self) -> String {
        let images = self.images.counts();
        let meshes = self
            .meshes
            .as_ref()
            .map_or_else(MeshCounts::default, MeshCache::counts);
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

/// Loaded scene with its loading time.
pub(super) struct Loaded {
    pub(super) file: SceneFile,
    pub(super) seconds: f64,
    /// Centre of the scene's bounds, about which turntables rotate.
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
        kept.images.evict_unused();
        // Report the loader's warnings once per scene
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

    /// Returns the camera of a frame, placed according to its view.
    pub(super) fn camera(&self, plan: &Plan) -> Result<Camera, Failure> {
        let scene = &self.file.scene;
        let wish = plan.frame.camera.as_deref();
        let camera = choose_camera(scene, &plan.frame.scene, wish)?;
        Ok(plan.frame.view.of(camera, scene, self.middle))
    }

    /// Returns the forecast memory of the scene and its acceleration structure.
    pub(super) fn forecast(&self, job: &RenderJob) -> Bytes {
        let forecast = MemoryForecast::of(&self.file.scene);
        let tree = match job.backend {
            Backend::Embree => forecast.embree_bytes,
            Backend::Bsp => forecast.bsp_bytes,
            Backend::Brute => 0,
        };
        Bytes {
            loaded: forecast.scene_bytes,
            to_come: tree + forecast.subsurface_bytes,
        }
    }

    /// Returns whether the scene is too large to be processed beside another.
    pub(super) fn is_large(&self, job: &RenderJob) -> bool {
        let Bytes { loaded, to_come } = self.forecast(job);
        available_bytes().is_some_and(|free| loaded + to_come > free / LARGE_PART)
    }

    /// Returns the memory parameters of a frame of this scene.
    pub(super) fn film(&self, settings: &RenderSettings) -> Film {
        Film {
            settings: *settings,
            light_count: self.file.scene.lights.len(),
        }
    }
}

/// Forecast memory of a loaded scene in bytes.
#[derive(Clone, Copy)]
pub(super) struct Bytes {
    /// Bytes that the scene takes already.
    pub(super) loaded: u64,
    /// Bytes that the acceleration structure and the preparations before the first ray will take.
    pub(super) to_come: u64,
}

/// Loaded scene with its acceleration structure.
pub(super) struct Stage<'s> {
    pub(super) loaded: &'s Loaded,
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) build_seconds: f64,
    /// Set once the times of loading and building are attributed to a frame.
    is_told: AtomicBool,
}

impl<'s> Stage<'s> {
    pub(super) fn new(plan: &Plan, loaded: &'s Loaded, kept: &Kept) -> Result<Stage<'s>, Failure> {
        let start = Instant::now();
        let options = AccelOptions {
            mesh_cache: kept.meshes.as_ref(),
            ..plan.job.tracing.options()
        };
        let accel = render::build_with(&plan.job, &loaded.file.scene, &options)?;
        if let Some(meshes) = &kept.meshes {
            meshes.evict_unused();
        }
        Ok(Stage {
            loaded,
            accel,
            build_seconds: start.elapsed().as_secs_f64(),
            is_told: AtomicBool::new(false),
        })
    }

    /// Returns the seconds of loading and building at the first call, zeros at later calls.
    pub(super) fn seconds_once(&self) -> [f64; 2] {
        match self.is_told.swap(true, Ordering::Relaxed) {
            false => [self.loaded.seconds, self.build_seconds],
            true => [0.0; 2],
        }
    }

    pub(super) fn scene(&self) -> &'s Scene {
        &self.loaded.file.scene
    }
}
