//! Texture slots of a material: the material input that each texture modifies, its coordinates and its strength.
//!
//! A texture without effect ([`crate::scene::Material::is_affected_by`]) is not decoded, such as a normal map
//! on an unlit surface, or a texture that multiplies a factor of zero.

use gltf::json;
use serde_json::{Map, Value};

use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::material::image_source::ImageConversion;
use crate::gltf::material::specular_glossiness::SpecularGlossiness;
use crate::scene::{MaterialInput, UvTransform};

/// A texture of a material, by the file's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::gltf) struct TextureSlot {
    pub(in crate::gltf) parameter: MaterialInput,
    pub(in crate::gltf) texture: usize,
    pub(in crate::gltf) tex_coord: u32,
    pub(in crate::gltf) transform: UvTransform,
    pub(in crate::gltf) strength: f32,
    /// Conversion of the texture's image.
    pub(in crate::gltf) conversion: ImageConversion,
}

/// Returns the textures of a material, with or without effect.
pub(in crate::gltf) fn slots(material: &json::Material, corrections: &mut Corrections) -> Vec<TextureSlot> {
    let pbr = &material.pbr_metallic_roughness;
    let extensions = material.extensions.as_ref().map(|e| &e.others);
    let is_unlit = Extension::of(extensions, "KHR_materials_unlit", corrections).is_present();
    let specular_glossiness = SpecularGlossiness::read(extensions, corrections).filter(|_| !is_unlit);
    let mut slots = Vec::new();
    if let Some(source) = &specular_glossiness {
        slots.extend(specular_glossiness_slots(source, corrections));
    } else {
        slots.extend(slot(
            MaterialInput::BaseColor,
            &pbr.base_color_texture,
            corrections,
        ));
    }
    // An unlit surface has only a base colour
    if is_unlit {
        return slots;
    }
    // Read the slots of glTF itself, then those of the extensions
    if specular_glossiness.is_none() {
        slots.extend(slot(
            MaterialInput::MetallicRoughness,
            &pbr.metallic_roughness_texture,
            corrections,
        ));
    }
    slots.extend(slot(
        MaterialInput::Emission,
        &material.emissive_texture,
        corrections,
    ));
    slots.extend(normal_slot(material, corrections));
    slots.extend(occlusion_slot(material, corrections));
    slots.extend(extension_slots(extensions, corrections));
    slots
}

fn slot(
    parameter: MaterialInput,
    info: &Option<json::texture::Info>,
    corrections: &mut Corrections,
) -> Option<TextureSlot> {
    let info = info.as_ref()?;
    let extensions = info.extensions.as_ref().map(|e| &e.others);
    let (transform, tex_coord) = transform(extensions, info.tex_coord, corrections);
    Some(TextureSlot {
        parameter,
        texture: info.index.value(),
        tex_coord,
        transform,
        strength: 1.0,
        conversion: ImageConversion::None,
    })
}

/// Returns the textures of the specular-glossiness workflow. One image has both the specular colour and the glossiness,
/// whose alpha channel is converted to roughness.
fn specular_glossiness_slots(source: &SpecularGlossiness, corrections: &mut Corrections) -> Vec<TextureSlot> {
    let packed = &source.specular_glossiness_texture;
    let mut slots = Vec::new();
    slots.extend(slot(
        MaterialInput::BaseColor,
        &source.diffuse_texture,
        corrections,
    ));
    slots.extend(slot(MaterialInput::SpecularColor, packed, corrections));
    let roughness = slot(MaterialInput::Roughness, packed, corrections);
    slots.extend(roughness.map(|slot| TextureSlot {
        conversion: source.roughness_conversion(),
        ..slot
    }));
    slots
}

fn normal_slot(material: &json::Material, corrections: &mut Corrections) -> Option<TextureSlot> {
    let info = material.normal_texture.as_ref()?;
    let extensions = info.extensions.as_ref().map(|e| &e.others);
    let (transform, tex_coord) = transform(extensions, info.tex_coord, corrections);
    if !info.scale.is_finite() {
        corrections.note("scale");
    }
    Some(TextureSlot {
        parameter: MaterialInput::Normal,
        texture: info.index.value(),
        tex_coord,
        transform,
        strength: if info.scale.is_finite() { info.scale } else { 1.0 },
        conversion: ImageConversion::None,
    })
}

fn occlusion_slot(material: &json::Material, corrections: &mut Corrections) -> Option<TextureSlot> {
    let info = material.occlusion_texture.as_ref()?;
    let extensions = info.extensions.as_ref().map(|e| &e.others);
    let (transform, tex_coord) = transform(extensions, info.tex_coord, corrections);
    let strength = corrections.within("strength", f64::from(info.strength.0), 0.0..=1.0, 1.0);
    Some(TextureSlot {
        parameter: MaterialInput::Occlusion,
        texture: info.index.value(),
        tex_coord,
        transform,
        strength: strength as f32,
        conversion: ImageConversion::None,
    })
}

/// Returns the textures of the implemented extensions. The thickness texture of `KHR_materials_volume` stands in for
/// the path through an interior for renderers that cannot trace it; it is not needed here.
fn extension_slots(
    extensions: Option<&Map<String, Value>>,
    corrections: &mut Corrections,
) -> Vec<TextureSlot> {
    let mut slots = Vec::new();
    for (name, texture, parameter) in EXTENSION_TEXTURES {
        let extension = Extension::of(extensions, name, corrections);
        let info = extension.texture(texture, corrections);
        // A normal map of the coat has a scale of its own
        let scale = match parameter {
            MaterialInput::ClearcoatNormal => {
                extension
                    .nested(texture, corrections)
                    .number("scale", 1.0, FINITE, corrections)
            }
            _ => 1.0,
        };
        slots.extend(slot(parameter, &info, corrections).map(|slot| TextureSlot {
            strength: scale as f32,
            ..slot
        }));
    }
    slots
}

/// Range of all finite numbers of f32.
const FINITE: std::ops::RangeInclusive<f64> = -(f32::MAX as f64)..=f32::MAX as f64;

/// Textures of extensions: name of the extension, name of the texture, and material input.
const EXTENSION_TEXTURES: [(&str, &str, MaterialInput); 13] = [
    (
        "KHR_materials_specular",
        "specularTexture",
        MaterialInput::Specular,
    ),
    (
        "KHR_materials_transmission",
        "transmissionTexture",
        MaterialInput::Transmission,
    ),
    (
        "KHR_materials_specular",
        "specularColorTexture",
        MaterialInput::SpecularColor,
    ),
    (
        TRANSLUCENCY,
        "diffuseTransmissionTexture",
        MaterialInput::Translucency,
    ),
    (
        TRANSLUCENCY,
        "diffuseTransmissionColorTexture",
        MaterialInput::TranslucencyColor,
    ),
    (CLEARCOAT, "clearcoatTexture", MaterialInput::Clearcoat),
    (
        CLEARCOAT,
        "clearcoatRoughnessTexture",
        MaterialInput::ClearcoatRoughness,
    ),
    (
        CLEARCOAT,
        "clearcoatNormalTexture",
        MaterialInput::ClearcoatNormal,
    ),
    (
        "KHR_materials_sheen",
        "sheenColorTexture",
        MaterialInput::SheenColor,
    ),
    (
        "KHR_materials_sheen",
        "sheenRoughnessTexture",
        MaterialInput::SheenRoughness,
    ),
    (
        "KHR_materials_anisotropy",
        "anisotropyTexture",
        MaterialInput::Anisotropy,
    ),
    (IRIDESCENCE, "iridescenceTexture", MaterialInput::Iridescence),
    (
        IRIDESCENCE,
        "iridescenceThicknessTexture",
        MaterialInput::IridescenceThickness,
    ),
];

const TRANSLUCENCY: &str = "KHR_materials_diffuse_transmission";
const CLEARCOAT: &str = "KHR_materials_clearcoat";
const IRIDESCENCE: &str = "KHR_materials_iridescence";

/// Returns the transform and the coordinate set of `KHR_texture_transform`: scale, then rotation, then offset.
///
/// Texture coordinates run to the right and down, so the extension's counter-clockwise rotation maps (u, v) to (u cos +
/// v sin, v cos - u sin). That is what its text, its test model and all viewers mean; the matrix that its text spells
/// out rotates the other way.
fn transform(
    extensions: Option<&Map<String, Value>>,
    tex_coord: u32,
    corrections: &mut Corrections,
) -> (UvTransform, u32) {
    let extension = Extension::of(extensions, "KHR_texture_transform", corrections);
    if !extension.is_present() {
        return (UvTransform::IDENTITY, tex_coord);
    }
    let offset = extension.vector("offset", [0.0; 2], FINITE, corrections);
    let [across, down] = extension.vector("scale", [1.0; 2], FINITE, corrections);
    let rotation = extension.number("rotation", 0.0, FINITE, corrections);
    let (sin, cos) = rotation.sin_cos();
    // Rotation times scale
    let matrix = [[cos * across, sin * down], [-sin * across, cos * down]];
    let transform = UvTransform {
        matrix: matrix.map(|row| row.map(|x| x as f32)),
        offset: offset.map(|x| x as f32),
    };
    let set = extension.index("texCoord", corrections);
    (transform, set.unwrap_or(tex_coord))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn transformed(members: Value, uv: [f32; 2]) -> [f32; 2] {
        let all = json!({"KHR_texture_transform": members});
        let (transform, _) = transform(all.as_object(), 0, &mut Corrections::default());
        transform.apply(uv)
    }

    #[test]
    fn coordinates_are_scaled_then_rotated_then_translated() {
        let eighth = std::f32::consts::FRAC_1_SQRT_2;
        let near = |[u, v]: [f32; 2], expected: [f32; 2]| {
            let error = (u - expected[0]).abs().max((v - expected[1]).abs());
            assert!(error <= 4.0 * f32::EPSILON, "{u} {v}, not {expected:?}");
        };
        near(
            transformed(json!({"scale": [2, 3], "offset": [0.5, -1]}), [1.0, 1.0]),
            [2.5, 2.0],
        );
        // An eighth of a turn: u runs to the right and up, that is, along (cos, -sin).
        let turn = json!({"rotation": std::f64::consts::FRAC_PI_4});
        near(transformed(turn.clone(), [1.0, 0.0]), [eighth, -eighth]);
        near(transformed(turn, [0.0, 1.0]), [eighth, eighth]);
        // (1, 1) scaled to (2, 4), rotated a quarter to (4, -2), moved to (5, -2).
        let all = json!({"rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 4], "offset": [1, 0]});
        near(transformed(all, [1.0, 1.0]), [5.0, -2.0]);
    }

    #[test]
    fn extension_coordinate_set_overrides_the_texture_info() {
        let all = json!({"KHR_texture_transform": {"texCoord": 3}});
        assert_eq!(transform(all.as_object(), 1, &mut Corrections::default()).1, 3);
        assert_eq!(transform(None, 1, &mut Corrections::default()).1, 1);
        let mut corrections = Corrections::default();
        let wrong = json!({"KHR_texture_transform": {"texCoord": "x", "offset": 1, "rotation": 1e300}});
        let (found, set) = transform(wrong.as_object(), 1, &mut corrections);
        assert_eq!((found.offset, set), ([0.0; 2], 1));
        assert!(found.matrix.as_flattened().iter().all(|x| x.is_finite()));
        assert_eq!(corrections.names, ["offset", "rotation", "texCoord"]);
    }
}
