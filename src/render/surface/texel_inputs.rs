//! Multiplication of texels into the inputs of materials, by lanes.

use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{MaterialInput, TextureBinding};
use crate::shading::{ExtendedMaterialLanes, MaterialPacket};

/// Multiplies colours by the RGB of texels in the lanes in `mask`.
#[inline(always)]
pub(super) fn tint(colors: &mut Lanes3<f32>, texels: &Lanes<[f32; 4]>, mask: &Lanes<bool>) {
    for (channel, lanes) in colors.iter_mut().enumerate() {
        scale(lanes, texels, channel, mask);
    }
}

/// Multiplies values by one channel of texels in the lanes in `mask`.
#[inline(always)]
pub(super) fn scale(lanes: &mut Lanes<f32>, texels: &Lanes<[f32; 4]>, channel: usize, mask: &Lanes<bool>) {
    for l in 0..LANES {
        let factor = texels[l][channel];
        lanes[l] *= if mask[l] { factor } else { 1.0 };
    }
}

/// Applies texels to a material input of the extended set, which few materials use.
#[inline(never)]
pub(super) fn apply_extended(
    layer: &TextureBinding,
    texels: &Lanes<[f32; 4]>,
    mask: &Lanes<bool>,
    extended: &mut ExtendedMaterialLanes,
) {
    match layer.parameter {
        MaterialInput::Specular => scale(&mut extended.specular, texels, 3, mask),
        MaterialInput::SpecularColor => tint(&mut extended.specular_color, texels, mask),
        MaterialInput::Reflection => tint(&mut extended.reflection, texels, mask),
        MaterialInput::Transmission => {
            for (channel, lanes) in extended.transmission.iter_mut().enumerate() {
                for l in (0..LANES).filter(|&l| mask[l]) {
                    lanes[l] *= texels[l][if extended.is_phong[l] { channel } else { 0 }];
                }
            }
        }
        MaterialInput::Occlusion => {
            for l in (0..LANES).filter(|&l| mask[l]) {
                extended.occlusion[l] = 1.0 + layer.strength * (texels[l][0] - 1.0);
            }
        }
        MaterialInput::Translucency => {
            for l in (0..LANES).filter(|&l| mask[l]) {
                let share = texels[l][3];
                extended.same_side_diffuse[l] = 1.0 - share * (1.0 - extended.same_side_diffuse[l]);
                (0..3).for_each(|c| extended.translucency[c][l] *= share);
            }
        }
        MaterialInput::TranslucencyColor => tint(&mut extended.translucency, texels, mask),
        MaterialInput::Iridescence => scale(&mut extended.film, texels, 0, mask),
        _ => {}
    }
}

/// Applies texels to a parameter of a layer.
#[inline(never)]
pub(super) fn apply_layer(
    layer: &TextureBinding,
    texels: &Lanes<[f32; 4]>,
    mask: &Lanes<bool>,
    materials: &mut MaterialPacket,
) {
    let Some(layers) = &mut materials.layers else {
        return;
    };
    match layer.parameter {
        MaterialInput::Clearcoat => scale(&mut layers.coat, texels, 0, mask),
        MaterialInput::ClearcoatRoughness => scale(&mut layers.coat_roughness, texels, 1, mask),
        MaterialInput::SheenColor => tint(&mut layers.sheen.color, texels, mask),
        MaterialInput::SheenRoughness => scale(&mut layers.sheen.roughness, texels, 3, mask),
        _ => {}
    }
}

/// Texels of a material without a texture of directions: along the tangent, with full strength.
pub(super) const DEFAULT_DIRECTIONS: Lanes<[f32; 4]> = [[1.0, 0.5, 1.0, 1.0]; LANES];
