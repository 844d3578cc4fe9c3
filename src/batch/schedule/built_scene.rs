//! Scene ready for rendering, shared by consecutive frames: loaded once, acceleration structure built once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use glam::DVec3;

use super::observer::BatchObserver;
use super::row_schedule::Film;
use crate::accel::{self, Accel, AccelOptions, Backend, MeshCache, MeshCounts};
use crate::batch::error::BatchError;
use crate::batch::memory::{MemoryForecast, available_bytes};
use crate::batch::plan::PlannedFrame;
use crate::batch::request::{self, RenderRequest, RequestError, check, choose_camera};
use crate::gltf::{AnimationTime, LoadOptions};
use crate::render::RenderSettings;
use crate::scene::{CacheStats, Camera, ImageCache, ValidScene};
use crate::scene_file::SceneFile;

/// A scene is large if it takes more than one part in this many of the free memory.
const LARGE_PART: u64 = 8;

/// Caches that scenes leave for the next: only the contents of the last scene remain.
pub(super) struct SceneCaches {
    images: ImageCache,
    /// Cache of built meshes, present only for more than one scene.
    meshes: Option<MeshCache>,
}

impl SceneCaches {
    /// Returns empty caches for the scenes of these frames.
    pub(super) fn for_frames(plans: &[PlannedFrame]) -> SceneCaches {
        let differ = plans.windows(2).any(|pair| !pair[0].shares_scene_with(&pair[1]));
        SceneCaches {
            images: ImageCache::new(),
            meshes: differ.then(MeshCache::default),
        }
    }

    /// Returns the bytes of the caches that are not part of any scene.
    pub(super) fn bytes(&self) -> u64 {
        self.meshes.as_ref().map_or(0, MeshCache::byte_count)
    }

    /// Returns the numbers of look-ups and of hits among images and built meshes.
    pub(super) fn counts(&self) -> (CacheStats, MeshCounts) {
        let meshes = self.meshes.as_ref();
        (
            self.images.counts(),
            meshes.map_or_else(MeshCounts::default, MeshCache::counts),
        )
    }
}

/// Loaded scene with its loading time.
pub(super) struct LoadedScene {
    pub(super) file: SceneFile,
    pub(super) seconds: f64,
    /// Centre of the scene's bounds, about which turntables rotate.
    pub(super) middle: DVec3,
}

impl LoadedScene {
    pub(super) fn new(
        plan: &PlannedFrame,
        kept: &SceneCaches,
        observer: &BatchObserver,
    ) -> Result<LoadedScene, BatchError> {
        let start = Instant::now();
        let frame = &plan.frame;
        let options = LoadOptions {
            pose: frame.moment.as_ref().map(|moment| AnimationTime {
                animation: moment.animation.clone(),
                seconds: moment.seconds,
            }),
            image_cache: kept.images.clone(),
            ..LoadOptions::default()
        };
        let source = (&*frame.scene, &frame.edits[..]);
        let file = request::load(&plan.request, source, options, observer.cancel)?;
        kept.images.evict_unused();
        // Report the loader's warnings once per scene
        for warning in &file.scene.warnings {
            (observer.warn)(&format!("{}: {warning}", frame.scene.display()));
        }
        let bounds = file.scene.bounds();
        let middle = if bounds.is_empty() {
            DVec3::ZERO
        } else {
            bounds.center()
        };
        Ok(LoadedScene {
            middle,
            seconds: start.elapsed().as_secs_f64(),
            file,
        })
    }

    /// Returns the camera of a frame, placed according to its view.
    pub(super) fn camera(&self, plan: &PlannedFrame) -> Result<Camera, BatchError> {
        let scene = &self.file.scene;
        let requested = plan.frame.camera.as_deref();
        let camera = choose_camera(scene, &plan.frame.scene, requested)?;
        Ok(plan.frame.view.of(camera, scene, self.middle))
    }

    /// Returns the forecast memory of the scene and its acceleration structure.
    pub(super) fn forecast(&self, request: &RenderRequest) -> MeshBytes {
        let forecast = MemoryForecast::of(&self.file.scene);
        let tree = match request.for_output(&self.file.output).backend() {
            Backend::Embree => forecast.embree_bytes,
            Backend::Native => forecast.native_bytes,
            Backend::Auto => forecast.native_bytes + forecast.embree_bytes,
            Backend::Bsp => forecast.bsp_bytes,
            Backend::Brute => 0,
        };
        MeshBytes {
            loaded: forecast.scene_bytes,
            to_come: tree + forecast.subsurface_bytes + forecast.photon_bytes,
        }
    }

    /// Returns whether the scene is too large to be processed beside another.
    pub(super) fn is_large(&self, request: &RenderRequest) -> bool {
        let MeshBytes { loaded, to_come } = self.forecast(request);
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
pub(super) struct MeshBytes {
    /// Bytes that the scene takes already.
    pub(super) loaded: u64,
    /// Bytes that the acceleration structure and the preparations before the first ray will take.
    pub(super) to_come: u64,
}

/// Loaded scene with its acceleration structure.
pub(super) struct BuiltScene<'s> {
    pub(super) loaded: &'s LoadedScene,
    pub(super) scene: ValidScene<'s>,
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) build_seconds: f64,
    /// Set once the times of loading and building are attributed to a frame.
    is_attributed: AtomicBool,
}

impl<'s> BuiltScene<'s> {
    pub(super) fn new(
        plan: &PlannedFrame,
        (loaded, kept): (&'s LoadedScene, &SceneCaches),
        observer: &BatchObserver,
    ) -> Result<BuiltScene<'s>, BatchError> {
        let start = Instant::now();
        let scene = loaded.file.scene.validate().map_err(RequestError::from)?;
        let request = plan.request.for_output(&loaded.file.output);
        let settings = request.resolved(&loaded.file.output)?.settings;
        let options = AccelOptions {
            mesh_cache: kept.meshes.as_ref(),
            ..request.tracing.options_for(scene, &settings)
        };
        let accel = accel::build(scene, request.backend(), &options).map_err(RequestError::from)?;
        check(observer.cancel)?;
        if let Some(meshes) = &kept.meshes {
            meshes.evict_unused();
        }
        Ok(BuiltScene {
            loaded,
            scene,
            accel,
            build_seconds: start.elapsed().as_secs_f64(),
            is_attributed: AtomicBool::new(false),
        })
    }

    /// Returns the seconds of loading and building at the first call, zeros at later calls.
    pub(super) fn seconds_once(&self) -> [f64; 2] {
        match self.is_attributed.swap(true, Ordering::Relaxed) {
            false => [self.loaded.seconds, self.build_seconds],
            true => [0.0; 2],
        }
    }
}
