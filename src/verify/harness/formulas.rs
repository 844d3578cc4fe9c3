//! Functions of the renderer that cases test.

use glam::{DAffine3, DVec3};

use super::homogeneous_march::march;
use crate::accel::Accel;
use crate::numeric::Lanes;
use crate::optics::{Fresnel, Refraction};
use crate::render::{Cancelled, Monitor, RenderSettings, Rendering};
use crate::scene::{Camera, Scene, SceneError, ValidScene};

/// Functions of the renderer that cases test; a test may replace any of them by a careless one.
#[derive(Clone, Copy)]
pub struct Formulas {
    /// Fresnel reflectance, see [`crate::optics::dielectric`].
    pub dielectric: fn(f64, f64, f64) -> Fresnel,
    /// Refracted direction, see [`crate::optics::refract`].
    pub refract: fn(DVec3, DVec3, f64, f64) -> Option<Refraction>,
    /// Opacity correction for a step length, see [`crate::volume::composite::corrected_opacity`].
    pub corrected_opacity: fn(f64, f64) -> f64,
    /// Transmittance of a number of layers of one optical depth, see [`crate::volume::transmittance_of`].
    pub transmittance: fn(f64, u64) -> f64,
    /// White radiance and transmittance of a homogeneous medium from its extinction, a length of at most 2 and the step
    /// length, computed with [`crate::volume::March`].
    pub march: fn(f64, f64, f64) -> [f64; 2],
    /// Sum of a number of packets of samples, see [`crate::render::pixel_sum`].
    pub pixel_sum: fn(&dyn Fn(u64) -> Lanes<f32>, u64) -> f64,
    /// Test whether a geometry can be instanced with a transform, see [`crate::scene::Instance::new`].
    pub is_invertible: fn(&DAffine3) -> bool,
    /// Offset origin of a spawned ray, see [`crate::numeric::spawn_point`].
    pub spawn_point: fn(DVec3, DVec3, f64) -> glam::Vec3,
    /// Scene validation, see [`Scene::validate`].
    pub validate: fn(&Scene) -> Result<(), SceneError>,
    /// Scene normalisation, see [`Scene::normalise`].
    pub normalise: fn(&mut Scene),
    /// Renderer of whole images, see [`crate::render::render`].
    pub render: Render,
}

/// Function that renders an image of a scene.
pub type Render = fn(&Scene, &Camera, &dyn Accel, &RenderSettings, &Monitor) -> Result<Rendering, Cancelled>;

impl Formulas {
    /// Functions of the renderer itself.
    pub const RENDERER: Formulas = Formulas {
        dielectric: crate::optics::dielectric,
        refract: crate::optics::refract,
        corrected_opacity: crate::volume::composite::corrected_opacity,
        transmittance: |layer, count| crate::volume::transmittance_of((0..count).map(|_| layer)),
        march,
        pixel_sum: |packet, count| crate::render::pixel_sum((0..count).map(packet)),
        is_invertible: |map| crate::scene::Instance::new("", 0, 0, *map).is_ok(),
        spawn_point: crate::numeric::spawn_point,
        validate: |scene| scene.validate().map(|_| ()),
        normalise: Scene::normalise,
        render: |scene, camera, accel, settings, monitor| {
            crate::render::render(ValidScene::assume(scene), camera, accel, settings, monitor)
        },
    };
}
