//! Preparation of a scene for a requested image: loading and the acceleration structure.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use super::error::RequestError;
use super::load::load_scene;
use super::render_request::RenderRequest;
use crate::accel::extents::{BoundingVolumeKind, ListLimits, TileCulledAccel};
use crate::accel::{self, Accel, AccelOptions, Backend};
use crate::gltf::{AnimationTime, LoadOptions};
use crate::render::{Cancelled, RenderSettings};
use crate::scene::{Background, Camera, ImageCache, Scene, ValidScene};
use crate::scene_file::{Edit, SceneFile};

/// Number of camera rays per object from which on screen bounds pay: rays are traced in packets of sixteen, and a
/// packet saves about half the cost of projecting an object.
const SAMPLES_PER_OBJECT: f64 = 32.0;

/// File of a scene, with the edits and the time that change it.
#[derive(Clone, Debug)]
pub struct SceneSource<'a> {
    /// Path of the scene file or glTF file.
    pub path: &'a Path,
    /// Overrides of keys in a scene file.
    pub edits: &'a [Edit],
    /// Animation and time at which the scene is posed; absent for a scene at rest.
    pub pose: Option<AnimationTime>,
    /// Cache of images that are already decoded.
    pub image_cache: ImageCache,
}

/// Loads a scene for an image: reads its file, and changes it as requested.
///
/// # Errors
///
/// If the scene cannot be loaded, or `cancel` is set.
pub fn load(
    request: &RenderRequest,
    source: SceneSource,
    cancel: &AtomicBool,
) -> Result<SceneFile, RequestError> {
    // Images used only by disabled effects are skipped, others come from the cache
    let options = LoadOptions {
        without: request.effects.removed,
        pose: source.pose,
        image_cache: source.image_cache,
        ..LoadOptions::default()
    };
    let mut loaded = load_scene(source.path, source.edits, &options)?;
    let scene = &mut loaded.scene;
    if let Some(ambient) = request.ambient {
        scene.ambient = ambient;
        scene.background = Background::Uniform(ambient);
    }
    request.change.apply(scene);
    check(cancel)?;
    Ok(loaded)
}

/// Builds the acceleration structure of a scene with the requested backend, and with `options` in place of the
/// request's.
///
/// # Errors
///
/// If the backend fails, or `cancel` is set.
pub fn build<'s>(
    request: &RenderRequest,
    scene: ValidScene<'s>,
    options: &AccelOptions,
    cancel: &AtomicBool,
) -> Result<Box<dyn Accel + 's>, RequestError> {
    let accel = accel::build(scene, request.backend, options)?;
    check(cancel)?;
    Ok(accel)
}

/// Returns an error if `cancel` is set.
fn check(cancel: &AtomicBool) -> Result<(), Cancelled> {
    match cancel.load(Ordering::Relaxed) {
        true => Err(Cancelled),
        false => Ok(()),
    }
}

/// Acceleration structure with screen bounds in front of it, except where the bounds cost more than the camera rays
/// save by them.
pub struct ProjectedAccel<'a> {
    accel: &'a dyn Accel,
    culled: Option<TileCulledAccel<'a, 'a>>,
}

impl<'a> ProjectedAccel<'a> {
    /// Projects the objects of a scene to the image of a camera, if that pays.
    pub fn new(
        (accel, backend): (&'a dyn Accel, Backend),
        (scene, camera): (&'a Scene, &Camera),
        settings: &RenderSettings,
    ) -> ProjectedAccel<'a> {
        let &RenderSettings {
            width, height, spp, ..
        } = settings;
        // Compare the number of objects with the number of camera rays
        let sample_count = f64::from(width) * f64::from(height) * f64::from(spp);
        let pays = scene.instances.len() as f64 * SAMPLES_PER_OBJECT <= sample_count;
        // Screen bounds assume rays from one point; rays through a lens start at several.
        if backend != Backend::Bsp || !pays || camera.lens_radius() > 0.0 {
            return ProjectedAccel { accel, culled: None };
        }
        let view = camera.view(width, height);
        let kind = BoundingVolumeKind::TightSphere;
        ProjectedAccel {
            accel,
            culled: TileCulledAccel::new(scene, &view, accel, kind, ListLimits::BESIDE_A_TREE),
        }
    }

    /// Returns the structure to trace rays through.
    pub fn accel(&self) -> &dyn Accel {
        self.culled
            .as_ref()
            .map_or(self.accel, |culled| culled as &dyn Accel)
    }
}
