//! Factors of glTF's materials and of their extensions.

use gltf::json;
use json::validation::Checked;
use serde_json::{Map, Value};

use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::material::medium::{interior, scattering};
use crate::gltf::material::specular_glossiness::SpecularGlossiness;
use crate::scene::{
    AlphaMode, Anisotropy, Clearcoat, Iridescence, Material, MetallicRoughness, Model, Sheen, Translucency,
};

/// Returns a material with the factors of `source`, without its name and its textures.
pub(super) fn surface(source: &json::Material, corrections: &mut Corrections) -> Material {
    // Read the base colour and the coverage, all that an unlit surface has
    let extensions = source.extensions.as_ref().map(|e| &e.others);
    let pbr = &source.pbr_metallic_roughness;
    let base_color = pbr
        .base_color_factor
        .0
        .map(|x| corrections.within("baseColorFactor", f64::from(x), 0.0..=1.0, 0.0) as f32);
    let alpha = alpha_mode(source, corrections);
    if Extension::of(extensions, "KHR_materials_unlit", corrections).is_present() {
        return Material {
            model: Model::Unlit,
            base_color,
            alpha,
            ..Material::default()
        };
    }
    // Read the model and the emission
    let specular_glossiness = SpecularGlossiness::read(extensions, corrections);
    let model = match &specular_glossiness {
        Some(source) => source.model(),
        None => metallic_roughness(pbr, extensions, corrections),
    };
    let extension = Extension::of(extensions, "KHR_materials_emissive_strength", corrections);
    let max = f64::from(f32::MAX);
    let strength = extension.number("emissiveStrength", 1.0, 0.0..=max, corrections);
    let emission = source.emissive_factor.0.map(|x| {
        let x = corrections.within("emissiveFactor", f64::from(x), 0.0..=max, 0.0);
        (x * strength).min(max) as f32
    });
    // Let light that enters an interior diffusely scatter below the surface
    let mut translucency = translucency(extensions, model.transmission, corrections);
    let mut base_color = specular_glossiness
        .as_ref()
        .map_or(base_color, |source| source.diffuse);
    let subsurface = translucency.and_then(|_| scattering(extensions, corrections));
    if let Some(Translucency { factor, color }) = translucency.take_if(|_| subsurface.is_some()) {
        (0..3).for_each(|c| base_color[c] += factor * (color[c] - base_color[c]));
    }
    Material {
        translucency,
        subsurface,
        interior: match &specular_glossiness {
            Some(source) => Some(source.interior()),
            None => interior(extensions, model.transmission > 0.0, corrections),
        },
        model: Model::MetallicRoughness(model),
        base_color,
        clearcoat: clearcoat(extensions, corrections),
        sheen: sheen(extensions, corrections),
        anisotropy: anisotropy(extensions, corrections),
        iridescence: iridescence(extensions, corrections),
        emission,
        alpha,
        ..Material::default()
    }
}

fn metallic_roughness(
    pbr: &json::material::PbrMetallicRoughness,
    extensions: Option<&Map<String, Value>>,
    corrections: &mut Corrections,
) -> MetallicRoughness {
    let mut core = |name, x: f32| corrections.within(name, f64::from(x), 0.0..=1.0, 0.0) as f32;
    // Read the factors of the core model
    let metallic = core("metallicFactor", pbr.metallic_factor.0);
    let roughness = core("roughnessFactor", pbr.roughness_factor.0);
    // Read the extensions of the reflection and the transmission
    let specular = Extension::of(extensions, "KHR_materials_specular", corrections);
    let transmission = Extension::of(extensions, "KHR_materials_transmission", corrections);
    let max = f64::from(f32::MAX);
    let specular_color = specular.vector("specularColorFactor", [1.0; 3], 0.0..=max, corrections);
    MetallicRoughness {
        metallic,
        roughness,
        specular: specular.number("specularFactor", 1.0, 0.0..=1.0, corrections) as f32,
        specular_color: specular_color.map(|x| x as f32),
        transmission: transmission.number("transmissionFactor", 0.0, 0.0..=1.0, corrections) as f32,
        ..MetallicRoughness::DEFAULT
    }
}

/// Reads the factors of `KHR_materials_diffuse_transmission`. Specular transmission overrides it, as the
/// extension defines for a factor of 1.
fn translucency(
    extensions: Option<&Map<String, Value>>,
    transmission: f32,
    corrections: &mut Corrections,
) -> Option<Translucency> {
    let diffuse = Extension::of(extensions, "KHR_materials_diffuse_transmission", corrections);
    let factor = diffuse.number("diffuseTransmissionFactor", 0.0, 0.0..=1.0, corrections);
    let color = diffuse.vector("diffuseTransmissionColorFactor", [1.0; 3], 0.0..=1.0, corrections);
    // Leave out a factor of zero, which has no effect
    (factor > 0.0 && transmission == 0.0).then(|| Translucency {
        factor: factor as f32,
        color: color.map(|x| x as f32),
    })
}

fn alpha_mode(source: &json::Material, corrections: &mut Corrections) -> AlphaMode {
    match source.alpha_mode {
        Checked::Valid(json::material::AlphaMode::Opaque) => AlphaMode::Opaque,
        Checked::Valid(json::material::AlphaMode::Mask) => {
            let cutoff = f64::from(source.alpha_cutoff.unwrap_or_default().0);
            let max = f64::from(f32::MAX);
            AlphaMode::Mask(corrections.within("alphaCutoff", cutoff, 0.0..=max, 0.5) as f32)
        }
        Checked::Valid(json::material::AlphaMode::Blend) => AlphaMode::Blend,
        Checked::Invalid => {
            corrections.note("alphaMode");
            AlphaMode::Opaque
        }
    }
}

/// Reads the factors of `KHR_materials_clearcoat`.
fn clearcoat(extensions: Option<&Map<String, Value>>, corrections: &mut Corrections) -> Option<Clearcoat> {
    let coat = Extension::of(extensions, "KHR_materials_clearcoat", corrections);
    let factor = coat.number("clearcoatFactor", 0.0, 0.0..=1.0, corrections);
    let roughness = coat.number("clearcoatRoughnessFactor", 0.0, 0.0..=1.0, corrections);
    // Leave out a coat that covers nothing
    (factor > 0.0).then_some(Clearcoat {
        factor: factor as f32,
        roughness: roughness as f32,
    })
}

/// Reads the factors of `KHR_materials_sheen`.
fn sheen(extensions: Option<&Map<String, Value>>, corrections: &mut Corrections) -> Option<Sheen> {
    let sheen = Extension::of(extensions, "KHR_materials_sheen", corrections);
    let color = sheen.vector("sheenColorFactor", [0.0; 3], 0.0..=1.0, corrections);
    let roughness = sheen.number("sheenRoughnessFactor", 0.0, 0.0..=1.0, corrections);
    // Leave out black fibres
    (color != [0.0; 3]).then(|| Sheen {
        color: color.map(|x| x as f32),
        roughness: roughness as f32,
    })
}

/// Reads the factors of `KHR_materials_anisotropy`.
fn anisotropy(extensions: Option<&Map<String, Value>>, corrections: &mut Corrections) -> Option<Anisotropy> {
    let max = f64::from(f32::MAX);
    let lobe = Extension::of(extensions, "KHR_materials_anisotropy", corrections);
    let strength = lobe.number("anisotropyStrength", 0.0, 0.0..=1.0, corrections);
    let rotation = lobe.number("anisotropyRotation", 0.0, -max..=max, corrections);
    // Leave out a round lobe
    (strength > 0.0).then_some(Anisotropy {
        strength: strength as f32,
        rotation: rotation as f32,
    })
}

/// Reads `KHR_materials_iridescence`. Without a texture of it, the film has its largest thickness everywhere.
fn iridescence(
    extensions: Option<&Map<String, Value>>,
    corrections: &mut Corrections,
) -> Option<Iridescence> {
    /// Largest thickness in nanometres: thicker films have no visible colours.
    const MAX_THICKNESS: f64 = 1e6;
    /// Largest index of refraction of a film.
    const MAX_IOR: f64 = 16.0;
    let film = Extension::of(extensions, "KHR_materials_iridescence", corrections);
    let factor = film.number("iridescenceFactor", 0.0, 0.0..=1.0, corrections);
    let ior = film.number("iridescenceIor", 1.3, 1.0..=MAX_IOR, corrections);
    let thin = film.number(
        "iridescenceThicknessMinimum",
        100.0,
        0.0..=MAX_THICKNESS,
        corrections,
    );
    let thick = film.number(
        "iridescenceThicknessMaximum",
        400.0,
        0.0..=MAX_THICKNESS,
        corrections,
    );
    // Leave out a film without weight
    (factor > 0.0).then_some(Iridescence {
        factor: factor as f32,
        ior: ior as f32,
        thickness: [thin as f32, thick as f32],
    })
}
