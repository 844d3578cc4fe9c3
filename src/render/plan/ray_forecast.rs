//! Forecast of the rays of a render from its plan, for the choice of a backend.

use super::Plan;
use crate::accel::RayForecast;
use crate::render::lighting::LightDivision;
use crate::render::settings::RenderSettings;
use crate::scene::{Effect, LightKind, ValidScene};

/// Share of the largest number of samples that is expected where pixels get different numbers.
const ADAPTIVE_SHARE: f64 = 0.25;
/// Share of hits that are expected to lie on a surface that reflects or refracts, where some material does.
const BOUNCE_SHARE: f64 = 0.5;

/// Number of rays that are expected of a path of diffuse bounces, for surfaces that reflect half of the light.
const DIFFUSE_BOUNCES: f64 = 2.0;

/// Forecasts the rays of an image of a scene as seen from its first camera.
///
/// All camera rays are taken to hit a surface, and rays to bounce once: the forecast is for the choice of a backend,
/// not for the duration of a render.
pub fn forecast_rays(scene: ValidScene, settings: &RenderSettings) -> RayForecast {
    let scene = scene.get();
    let Some(camera) = scene.cameras.first() else {
        return RayForecast::default();
    };
    let plan = Plan::new(scene, camera, &settings.effects);
    let effects = plan.effects();
    // Count camera rays
    let pixels = f64::from(settings.width) * f64::from(settings.height);
    let share = match settings.adaptive.is_some() || settings.edge_contrast.is_some() {
        true => ADAPTIVE_SHARE,
        false => 1.0,
    };
    let samples = pixels * (share * f64::from(settings.spp)).max(1.0);
    let has_eye = camera.view(settings.width, settings.height).eye().is_some();
    let is_pinhole = has_eye && camera.lens_radius() == 0.0 && camera.motion().is_none();
    // Count the shadow rays of a hit
    let (mut to_end, mut to_area) = (0.0, 0.0);
    for (light, _) in scene
        .lights
        .iter()
        .zip(&plan.casts_shadows)
        .filter(|(_, casts)| **casts)
    {
        match light.kind {
            LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => to_end += 1.0,
            LightKind::Area { samples, .. } => to_area += f64::from(samples),
        }
    }
    // Rays to an environment that start next to each other may point anywhere
    let to_environment = f64::from(u8::from(effects.has(Effect::Environment)));
    // Transparent shadows take the nearest hits from surface to surface, which are not traced in groups
    if effects.has(Effect::TransparentShadow) {
        to_area += std::mem::take(&mut to_end);
    }
    // Count the rays of a bounce
    let mut bounces = 0.0;
    for effect in [Effect::Reflection, Effect::Refraction] {
        bounces += f64::from(u8::from(effects.has(effect)));
    }
    if effects.has(Effect::RoughReflection) || effects.has(Effect::RoughRefraction) {
        let rays = scene.materials.iter().map(|material| material.rough_rays());
        bounces += f64::from(rays.max().unwrap_or(0));
    }
    bounces *= BOUNCE_SHARE * samples;
    // Count the rays of a path of diffuse bounces, which may sample one of many lights
    let mut incoherent = bounces * (1.0 + to_end + to_area + to_environment);
    if effects.has(Effect::Interreflection) {
        let to_lights = match LightDivision::of(scene, effects) {
            Some(division) => division.others.len() as f64 + 1.0,
            None => to_end + to_area,
        };
        incoherent += DIFFUSE_BOUNCES * samples * (1.0 + to_lights + to_environment);
    }
    let from_point = if is_pinhole { samples } else { 0.0 };
    RayForecast {
        from_point,
        to_end: samples * to_end,
        coherent: samples - from_point + samples * to_area,
        incoherent: incoherent + samples * to_environment,
    }
}
