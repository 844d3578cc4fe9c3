//! Validation of lights and environment maps.

use glam::DVec3;

use super::area_light::{DiskLight, QuadLight, SphereLight};
use super::validate_value::{is_radiance, is_unit};
use super::{AreaShape, Falloff, Image, Light, LightKind, Scene, Texels};

/// Largest number of samples of a light per shading point: more is probably a typing error.
pub(crate) const MAX_LIGHT_SAMPLES: u32 = 4096;

/// Checks a light.
///
/// Coordinates outside the valid range are allowed, as a scene that is not normalised yet may have them.
pub(crate) fn check_light(light: &Light) -> Result<(), String> {
    if !is_radiance(&light.intensity) {
        return Err("its intensity is negative or not finite: correct the intensity".into());
    }
    let is_position = |p: DVec3| p.is_finite();
    let is_coefficient = |x: f64| (0.0..f64::INFINITY).contains(&x);
    let is_falloff = |falloff: Falloff| match falloff {
        Falloff::InverseSquare { range } => range.is_none_or(|r| r > 0.0),
        Falloff::Polynomial {
            constant,
            linear,
            quadratic,
        } => {
            [constant, linear, quadratic].into_iter().all(is_coefficient)
                && constant + linear + quadratic > 0.0
        }
    };
    // Check the parameters of the type
    let is_sound = match light.kind {
        LightKind::Directional { to_light } => is_unit(to_light),
        LightKind::Point { position, falloff } => is_position(position) && is_falloff(falloff),
        LightKind::Spot {
            position,
            direction,
            cos_inner,
            cos_outer,
            falloff,
        } => {
            // A positive penumbra keeps the attenuation between the cones finite
            let has_cone = -1.0 <= cos_outer && cos_outer < cos_inner && cos_inner <= 1.0;
            is_position(position) && is_falloff(falloff) && is_unit(direction) && has_cone
        }
        LightKind::Area { shape, samples } => return check_area(&shape, samples),
    };
    if is_sound {
        Ok(())
    } else {
        Err("its position, direction, range or cone is invalid: correct it".into())
    }
}

/// Returns the largest coordinate of a light's position; 0 if it has none of its own.
pub(super) fn max_light_coordinate(light: &Light) -> f64 {
    match &light.kind {
        LightKind::Directional { .. } => 0.0,
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => position.abs().max_element(),
        LightKind::Area { shape, .. } => shape.bounds().map_or(0.0, |bounds| bounds.magnitude()),
    }
}

/// Checks an area light.
fn check_area(shape: &AreaShape, samples: u32) -> Result<(), String> {
    if let Some(bounds) = shape.bounds() {
        let reach = bounds.min.abs().max(bounds.max.abs());
        if !reach.is_finite() {
            return Err("its position is invalid: correct it".into());
        }
    }
    check_samples(samples)?;
    // Construct the sampler, which checks the shape
    let made = match *shape {
        AreaShape::Quad {
            center,
            half_u,
            half_v,
        } => QuadLight::new(center, half_u, half_v).err(),
        AreaShape::Disk {
            center,
            half_u,
            half_v,
        } => DiskLight::new(center, half_u, half_v).err(),
        AreaShape::Sphere { center, radius } => SphereLight::new(center, radius).err(),
        // The instance is checked with the scene.
        AreaShape::Object { .. } => None,
    };
    made.map_or(Ok(()), |error| Err(error.to_string()))
}

/// Checks the object that a light lies on, if it is the light of an emissive object.
pub(super) fn check_emissive_light(scene: &Scene, light: &Light) -> Result<(), String> {
    light
        .emissive_instance()
        .map_or(Ok(()), |instance| scene.emissive_surface(instance).map(|_| ()))
}

fn check_samples(samples: u32) -> Result<(), String> {
    if (1..=MAX_LIGHT_SAMPLES).contains(&samples) {
        Ok(())
    } else {
        Err(format!("it has {samples} samples: give 1 to {MAX_LIGHT_SAMPLES}"))
    }
}

/// Checks an environment map.
pub(super) fn check_environment(
    image: Option<&Image>,
    (rotation, scale): (f64, f32),
    samples: u32,
) -> Result<(), String> {
    let Some(image) = image else {
        return Err("its image does not exist: give the number of an image of the scene".into());
    };
    // An image that is not simulated is not checked
    if image.texels == Texels::Unread {
        return Ok(());
    }
    let Texels::Floats(texels) = &image.texels else {
        return Err(format!(
            "{} has 8 bits a channel, too few for light: give an .hdr or .exr file",
            image.name
        ));
    };
    // Report the first texel that is not finite
    if let Some(index) = texels
        .iter()
        .position(|texel| !texel[..3].iter().all(|channel| channel.is_finite()))
    {
        let (x, y) = (index as u32 % image.width, index as u32 / image.width);
        return Err(format!(
            "{} is not finite in column {x}, row {y}: repair the image",
            image.name
        ));
    }
    if !(rotation.is_finite() && is_radiance(&[scale; 3])) {
        return Err("its rotation is not finite or its scale negative: correct them".into());
    }
    // A map without samples lights nothing
    match samples {
        0 => Ok(()),
        samples => check_samples(samples),
    }
}
