//! Preparation of a scene for a requested image: loading and the acceleration structure.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use super::error::RequestError;
use super::render_request::RenderRequest;
use crate::accel::extents::{BoundingVolumeKind, ListLimits, TileCulledAccel};
use crate::accel::{Accel, Backend};
use crate::gltf::{self, DefaultLight, LoadOptions};
use crate::render::{Cancelled, RenderSettings};
use crate::scene::{Background, Camera, CameraRequest, Scene};
use crate::scene_file::{self, Edit, Output, SceneFile};

/// Number of camera rays per object from which on screen bounds pay: rays are traced in packets of sixteen, and a
/// packet saves about half the cost of projecting an object.
const SAMPLES_PER_OBJECT: f64 = 32.0;

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
        return Err(RequestError::EditedGltf(path.to_owned(), edit.to_string()));
    }
    Ok(SceneFile {
        scene: gltf::load(path, options)?,
        output: Output::default(),
        group_count: 0,
        include_count: 0,
        gltf_count: 0,
    })
}

/// Loads a scene for an image: reads its file, and changes it as requested.
///
/// # Errors
///
/// If the scene cannot be loaded, or `cancel` is set.
pub fn load(
    request: &RenderRequest,
    (path, edits): (&Path, &[Edit]),
    options: LoadOptions,
    cancel: &AtomicBool,
) -> Result<SceneFile, RequestError> {
    // Images used only by disabled effects are skipped
    let options = LoadOptions {
        without: request.effects.removed,
        camera: CameraRequest {
            placement: request.camera,
            image_size: request.output.size,
        },
        // An environment replaces the default light, ambient light only its background
        default_light: match (&request.environment, request.ambient) {
            (Some(_), _) => DefaultLight::None,
            (None, Some(_)) => DefaultLight::Sunlight,
            (None, None) => options.default_light,
        },
        ..options
    };
    let mut loaded = load_scene(path, edits, &options)?;
    let scene = &mut loaded.scene;
    if let Some(ambient) = request.ambient {
        scene.ambient = ambient;
        scene.background = Background::Uniform(ambient);
    }
    if let Some(environment) = &request.environment {
        environment.apply(scene, &options)?;
    }
    request.change.apply(scene);
    check(cancel)?;
    Ok(loaded)
}

/// Returns an error if `cancel` is set.
pub(in crate::batch) fn check(cancel: &AtomicBool) -> Result<(), Cancelled> {
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
