//! Validation of materials and procedural textures.

use std::ops::{Range, RangeInclusive};

use super::validate_value::is_radiance;
use super::{
    MAX_ROUGH_RAYS, Material, MaterialInput, Model, Pattern, Procedural, Scene, Texels, Texture,
    TextureBinding,
};
use crate::optics::subsurface::Dipole;
use crate::optics::{LINE_D, MAX_WAVELENGTH, MIN_WAVELENGTH};

/// Largest number of noise octaves: each halves the height, so sixteen reach the last bits of a display value.
const MAX_OCTAVES: u32 = 16;

/// Checks a procedural texture.
pub(crate) fn check_procedural(procedural: &Procedural) -> Result<(), String> {
    let is_octaves = |octaves: u32| (1..=MAX_OCTAVES).contains(&octaves);
    let pattern = match procedural.pattern {
        Pattern::Checker | Pattern::Gradient => true,
        Pattern::Noise { octaves } => is_octaves(octaves),
        Pattern::Marble { octaves, turbulence } => is_octaves(octaves) && turbulence.is_finite(),
        Pattern::Wood { turbulence } => turbulence.is_finite(),
    };
    let colors = procedural.colors.as_flattened().iter();
    let is_sound = pattern
        && colors.into_iter().all(|c| (0.0..f32::INFINITY).contains(c))
        && procedural.scale.iter().all(|s| s.is_finite());
    if is_sound {
        Ok(())
    } else {
        Err("its colours, scale, octaves or turbulence are not finite or out of range: correct them".into())
    }
}

/// Checks the factors that textures are multiplied by. The base colour of an unlit surface is the radiance that it emits.
pub(crate) fn check_factors(material: &Material) -> Result<(), String> {
    let [r, g, b, coverage] = material.base_color;
    let is_fraction = |x: f32| (0.0..=1.0).contains(&x);
    if material.model == Model::Unlit && !is_radiance(&[r, g, b]) {
        return Err("its base colour is negative or not finite: correct the colour".into());
    }
    if material.model != Model::Unlit && ![r, g, b].into_iter().all(is_fraction) || !is_fraction(coverage) {
        return Err("its base colour is outside [0, 1]: correct the colour".into());
    }
    if !is_radiance(&material.emission) {
        return Err("its emission is negative or not finite: correct the emission".into());
    }
    check_layers(material)?;
    check_model(&material.model)
}

/// Checks the factors of layers and lobes of glTF's extensions.
fn check_layers(material: &Material) -> Result<(), String> {
    let is_fraction = |x: &f32| (0.0..=1.0).contains(x);
    let is_length = |x: &f32| (0.0..f32::INFINITY).contains(x);
    let coat = material
        .clearcoat
        .iter()
        .all(|coat| is_fraction(&coat.factor) && is_fraction(&coat.roughness));
    let sheen = material
        .sheen
        .iter()
        .all(|sheen| sheen.color.iter().chain([&sheen.roughness]).all(is_fraction));
    let lobe = material
        .anisotropy
        .iter()
        .all(|lobe| is_fraction(&lobe.strength) && lobe.rotation.is_finite());
    let film = material.iridescence.iter().all(|film| {
        is_fraction(&film.factor) && (1.0..=16.0).contains(&film.ior) && film.thickness.iter().all(is_length)
    });
    let checks = [
        (coat, "clear coat"),
        (sheen, "sheen"),
        (lobe, "anisotropy"),
        (film, "iridescence"),
    ];
    // Report the first that is out of range
    match checks.into_iter().find(|(is_sound, _)| !is_sound) {
        Some((_, name)) => Err(format!("a factor of its {name} is out of range: correct it")),
        None => Ok(()),
    }
}

fn check_model(model: &Model) -> Result<(), String> {
    let is_fraction = |x: f32| (0.0..=1.0).contains(&x);
    match model {
        Model::MetallicRoughness(model) => {
            if !(is_fraction(model.metallic) && is_fraction(model.roughness)) {
                return Err("its metallic or roughness factor is outside [0, 1]: correct the factor".into());
            }
            if !(is_fraction(model.specular) && is_fraction(model.transmission)) {
                return Err(
                    "its specular or transmission factor is outside [0, 1]: correct the factor".into(),
                );
            }
            if model.rough_rays > MAX_ROUGH_RAYS {
                return Err(format!(
                    "it has {} rough rays: give 0 to {MAX_ROUGH_RAYS}",
                    model.rough_rays
                ));
            }
            if !is_radiance(&model.specular_color) {
                return Err("its specular colour is negative or not finite: correct the colour".into());
            }
        }
        Model::Phong(phong) => {
            let colors = [phong.ambient, phong.diffuse, phong.specular];
            let shares = [phong.reflection, phong.transmission];
            if !colors.iter().all(is_radiance) || !(0.0..f32::INFINITY).contains(&phong.exponent) {
                return Err("a coefficient or the exponent is negative or not finite: correct it".into());
            }
            if !shares.as_flattened().iter().all(|x| is_fraction(*x)) {
                return Err("its reflection or transmission is outside [0, 1]: correct it".into());
            }
        }
        Model::Unlit => {}
    }
    Ok(())
}

/// Rejects an image of floats whose values are invalid for its material input; 8-bit values are always in [0, 1].
pub(super) fn check_texels(scene: &Scene, material: &Material, layer: &TextureBinding) -> Result<(), String> {
    let Some(Texture::Image { image, .. }) = scene.textures.get(layer.texture.texture as usize) else {
        return Ok(());
    };
    let Some(image) = scene.images.get(*image as usize) else {
        return Ok(());
    };
    let Texels::Floats(texels) = &image.texels else {
        return Ok(());
    };
    // Report the first value out of range
    for (channels, values, range) in texel_ranges(material, layer.parameter) {
        let mut read = texels.iter().flat_map(|texel| &texel[channels.clone()]);
        if let Some(x) = read.find(|x| !values.contains(*x)) {
            return Err(format!(
                "the image {} on its {:?} holds {x}, which is {range}: save it within the range",
                image.name, layer.parameter
            ));
        }
    }
    Ok(())
}

/// Channels, the range of their values, and a description of values outside it.
type TexelRange = (Range<usize>, RangeInclusive<f32>, &'static str);

/// Returns the valid ranges of the texels of a float image on `parameter`.
fn texel_ranges(material: &Material, parameter: MaterialInput) -> Vec<TexelRange> {
    let fraction = |channels| (channels, 0.0..=1.0, "outside [0, 1]");
    let light = (0..3, 0.0..=f32::MAX, "below 0");
    let finite = |channels| (channels, f32::MIN..=f32::MAX, "not finite");
    match parameter {
        MaterialInput::Normal => vec![finite(0..3)],
        MaterialInput::Bump => vec![finite(0..1)],
        MaterialInput::Roughness | MaterialInput::Metallic | MaterialInput::Occlusion => vec![fraction(0..1)],
        MaterialInput::MetallicRoughness => vec![fraction(1..3)],
        MaterialInput::Specular => vec![fraction(3..4)],
        MaterialInput::Emission | MaterialInput::SpecularColor => vec![light],
        // Opaque surfaces ignore their coverage, so it may have any value.
        MaterialInput::BaseColor if material.model == Model::Unlit => vec![light, finite(3..4)],
        MaterialInput::BaseColor => vec![fraction(0..3), finite(3..4)],
        MaterialInput::Reflection
        | MaterialInput::Transmission
        | MaterialInput::TranslucencyColor
        | MaterialInput::SheenColor
        | MaterialInput::Anisotropy => vec![fraction(0..3)],
        MaterialInput::Translucency | MaterialInput::SheenRoughness => vec![fraction(3..4)],
        MaterialInput::Clearcoat | MaterialInput::Iridescence => vec![fraction(0..1)],
        MaterialInput::ClearcoatRoughness | MaterialInput::IridescenceThickness => vec![fraction(1..2)],
        MaterialInput::ClearcoatNormal => vec![finite(0..3)],
    }
}

/// Range that contains the index of refraction of every real material, over the whole visible range.
const IOR_RANGE: RangeInclusive<f64> = 1.0 / 16.0..=16.0;

/// Largest index of refraction of an opaque surface. Its reflectance at normal incidence is 1 - 4e-9, which rounds to 1
/// in f32: formats state a surface that reflects all light by an index of refraction.
pub(crate) const MAX_OPAQUE_IOR: f64 = 1e9;

pub(super) fn check_interior(material: &Material) -> Result<(), String> {
    let Some(interior) = &material.interior else {
        return Ok(());
    };
    let range = match material.transmits() {
        true => IOR_RANGE,
        false => *IOR_RANGE.start()..=MAX_OPAQUE_IOR,
    };
    // Evaluate the dispersion at both ends of the visible range and at the d line
    let is_sound = [MIN_WAVELENGTH, LINE_D, MAX_WAVELENGTH]
        .iter()
        .all(|&wavelength| range.contains(&interior.ior.ior(wavelength)));
    if !is_sound {
        return Err(
            "its index of refraction is not between 1/16 and 16 (1e9 if it is opaque): correct it".into(),
        );
    }
    let is_coefficient = |sigma: &f64| (0.0..f64::INFINITY).contains(sigma);
    if !interior.absorption.sigma_a.iter().all(is_coefficient) {
        return Err("its absorption is negative or not finite: correct it".into());
    }
    Ok(())
}

/// Checks the subsurface scattering and the diffuse transmission of a material.
pub(crate) fn check_scattering(material: &Material) -> Result<(), String> {
    // Check the combination with the model and with transmission
    let has_scattering = material.subsurface.is_some() || material.translucency.is_some();
    if has_scattering && !matches!(material.model, Model::MetallicRoughness(_)) {
        return Err(
            "has subsurface scattering, which only the metallic-roughness model supports: remove `subsurface` or \
             `translucency` or give that `model`"
                .into(),
        );
    }
    if has_scattering && material.transmits() {
        return Err(
            "both transmits light straight through and scatters it: give either `transmission` or one of \
             `subsurface` and `translucency`"
                .into(),
        );
    }
    if material.subsurface.is_some() && material.translucency.is_some() {
        return Err(
            "is both an interior with subsurface scattering and a thin surface: give `subsurface` or `translucency`"
                .into(),
        );
    }
    // Check the parameters
    if let Some(scattering) = &material.subsurface {
        Dipole::new(scattering).map_err(|error| error.to_string())?;
    }
    if let Some(translucency) = &material.translucency {
        let mut parts = translucency.color.iter().chain([&translucency.factor]);
        if !parts.all(|x| (0.0..=1.0).contains(x)) {
            return Err("its translucency or its translucent colour is outside [0, 1]: correct it".into());
        }
    }
    Ok(())
}
