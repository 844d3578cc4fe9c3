//! Constant folding of textures: when a scene is loaded, textures of one colour are multiplied into the factors of
//! their materials.
//!
//! Multiplying by one number at load time gives the product that every lookup would give, so no bit of an image
//! changes; but the lookup is saved, and an effect that a texture of zeros disables is not enabled at all.

use crate::scene::{
    AlphaMode, Image, Material, MaterialInput, MetallicRoughness, Model, Scene, Texels, Texture,
    TextureBinding, check_factors,
};

use super::{constant, encoding_index};

/// Folds the constant textures of a validated scene into its materials.
pub fn fold_constant_textures(scene: &mut Scene) {
    // An image that was not read may have any colours.
    let color_of = |image: &Image| match image.texels {
        Texels::Unread => None,
        _ => constant(image),
    };
    let images: Vec<Option<[[f32; 4]; 2]>> = scene.images.iter().map(color_of).collect();
    // Find the textures of one colour
    let color = |texture: &Texture| match texture {
        Texture::Image { image, .. } => images[*image as usize],
        Texture::Procedural(rule) => (rule.colors[0] == rule.colors[1]).then_some([rule.colors[0]; 2]),
    };
    let colors: Vec<_> = scene.textures.iter().map(color).collect();
    // Find the materials on meshes and point clouds with vertex colours
    let mut varies = vec![false; scene.materials.len()];
    for instance in &scene.instances {
        let geometry = &scene.geometries[instance.geometry as usize];
        varies[instance.material as usize] |= geometry.has_colors();
    }
    // Fold constant textures and drop their bindings
    for (material, has_vertex_colors) in scene.materials.iter_mut().zip(varies) {
        let layers = std::mem::take(&mut material.layers);
        material.layers = layers
            .into_iter()
            .filter(|layer| {
                let color = colors[layer.texture.texture as usize];
                let Some(color) = color else {
                    return true;
                };
                // Keep a texture whose product with the factor is out of the factor's range
                let mut folded = material.clone();
                let texel = color[encoding_index(layer.parameter.encoding())];
                let is_folded = fold(&mut folded, layer, texel) && check_factors(&folded).is_ok();
                if is_folded {
                    *material = folded;
                }
                !is_folded
            })
            .collect();
        // A material that is opaque everywhere needs no alpha test
        let is_even = material.layer(MaterialInput::BaseColor).is_none() && !has_vertex_colors;
        if is_even && material.alpha.coverage(material.base_color[3]) == 1.0 {
            material.alpha = AlphaMode::Opaque;
        }
    }
    // Shrink the images of one colour to a single texel
    for (image, color) in scene.images.iter_mut().zip(images) {
        if color.is_some() {
            shrink(image);
        }
    }
}

/// Shrinks an image of one colour to a single texel.
fn shrink(image: &mut Image) {
    match &mut image.texels {
        Texels::Bytes(texels) => *texels = texels[..1].to_vec().into(),
        Texels::Floats(texels) => *texels = texels[..1].to_vec().into(),
        Texels::Unread => return,
    }
    (image.width, image.height) = (1, 1);
}

/// Multiplies `texel` into the parameter of `layer`. Returns whether the layer has no effect left.
fn fold(material: &mut Material, layer: &TextureBinding, texel: [f32; 4]) -> bool {
    let tint = |color: &mut [f32; 3]| (0..3).for_each(|c| color[c] *= texel[c]);
    match (layer.parameter, &mut material.model) {
        (MaterialInput::BaseColor, _) => (0..4).for_each(|c| material.base_color[c] *= texel[c]),
        (MaterialInput::Emission, _) => tint(&mut material.emission),
        // A constant height has no slope.
        (MaterialInput::Bump, _) => {}
        (MaterialInput::Normal, _) => return [0, 1, 2].map(|c| 2.0 * texel[c] - 1.0) == [0.0, 0.0, 1.0],
        (MaterialInput::Occlusion, _) => return layer.strength * (texel[0] - 1.0) == 0.0,
        (parameter, Model::MetallicRoughness(model)) => fold_metallic_roughness(model, parameter, texel),
        (MaterialInput::SpecularColor, Model::Phong(phong)) => tint(&mut phong.specular),
        (MaterialInput::Reflection, Model::Phong(phong)) => tint(&mut phong.reflection),
        (MaterialInput::Transmission, Model::Phong(phong)) => tint(&mut phong.transmission),
        // The model does not have this parameter.
        _ => {}
    }
    true
}

/// Multiplies `texel` into one parameter of the metallic-roughness model.
fn fold_metallic_roughness(model: &mut MetallicRoughness, parameter: MaterialInput, texel: [f32; 4]) {
    match parameter {
        MaterialInput::MetallicRoughness => {
            model.roughness *= texel[1];
            model.metallic *= texel[2];
        }
        MaterialInput::Roughness => model.roughness *= texel[0],
        MaterialInput::Metallic => model.metallic *= texel[0],
        MaterialInput::Specular => model.specular *= texel[3],
        MaterialInput::SpecularColor => (0..3).for_each(|c| model.specular_color[c] *= texel[c]),
        MaterialInput::Transmission => model.transmission *= texel[0],
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Filter, Sampler, TextureUse, Wrap};

    /// Creates a scene whose only material has a texture of `texel` on `parameter`, and another of two colours on its
    /// roughness.
    fn scene(parameter: MaterialInput, texel: [u8; 4]) -> Scene {
        // Define an image of two texels and a texture of it
        let image = |texels: Vec<[u8; 4]>| Image {
            name: "plain".into(),
            width: 2,
            height: 1,
            texels: Texels::Bytes(texels.into()),
        };
        let texture = |image| Texture::Image {
            image,
            sampler: Sampler {
                wrap_u: Wrap::Repeat,
                wrap_v: Wrap::Repeat,
                filter: Filter::Mipmap,
            },
        };
        let layer = |parameter, texture| TextureBinding {
            parameter,
            texture: TextureUse::new(texture),
            strength: 1.0,
        };
        // Assemble a scene of two textures on one material
        Scene {
            images: vec![image(vec![texel; 2]), image(vec![[0; 4], [255; 4]])],
            textures: vec![texture(0), texture(1)],
            materials: vec![Material {
                emission: [2.0; 3],
                alpha: AlphaMode::Blend,
                layers: vec![layer(parameter, 0), layer(MaterialInput::Roughness, 1)],
                ..Material::default()
            }],
            ..Scene::default()
        }
    }

    #[test]
    fn constant_texture_is_folded_into_its_factor() {
        let mut black = scene(MaterialInput::Emission, [0, 0, 0, 255]);
        fold_constant_textures(&mut black);
        assert_eq!(black.materials[0].emission, [0.0; 3]);
        let left: Vec<MaterialInput> = black.materials[0].layers.iter().map(|l| l.parameter).collect();
        assert_eq!(left, [MaterialInput::Roughness]);
        assert_eq!((black.images[0].width, black.images[0].texels.len()), (1, 1));
        assert_eq!((black.images[1].width, black.images[1].texels.len()), (2, 2));
        let mut white = scene(MaterialInput::BaseColor, [255; 4]);
        fold_constant_textures(&mut white);
        assert_eq!(white.materials[0].base_color, [1.0; 4]);
        assert_eq!(white.materials[0].alpha, AlphaMode::Opaque);
    }

    #[test]
    fn folded_scenes_stay_valid() {
        let bright = |model| {
            let mut scene = scene(MaterialInput::BaseColor, [255; 4]);
            scene.images[0].texels = Texels::Floats(vec![[512.0, 0.25, 7.5, 1.0]; 2].into());
            scene.materials[0].model = model;
            fold_constant_textures(&mut scene);
            scene.validate_structure(&[]).map(|()| scene.materials[0].clone())
        };
        let unlit = bright(Model::Unlit).unwrap();
        assert_eq!(unlit.base_color, [512.0, 0.25, 7.5, 1.0]);
        assert_eq!(unlit.layers.len(), 1);
        // A surface that reflects more light than it receives is refused whether or not its texture is folded
        assert!(bright(Material::default().model).is_err());
    }

    #[test]
    fn alpha_and_normal_textures_are_not_folded() {
        let mut half = scene(MaterialInput::BaseColor, [255, 255, 255, 128]);
        fold_constant_textures(&mut half);
        assert_eq!(half.materials[0].alpha, AlphaMode::Blend);
        let mut tilted = scene(MaterialInput::Normal, [128, 128, 255, 255]);
        fold_constant_textures(&mut tilted);
        assert_eq!(tilted.materials[0].layers.len(), 2);
    }
}
