//! Materials and their textures: glTF's metallic-roughness parameters and their extensions. Only what the scene uses is
//! read.

mod factors;
mod image;
pub(super) mod image_source;
mod ktx2;
pub(super) mod medium;
mod specular_glossiness;
mod texture_slot;
mod texture_source;
mod variant;

use std::collections::HashMap;

use gltf::json;

use crate::gltf::GltfError;
use crate::gltf::document::GltfDocument;
use crate::gltf::extension::Corrections;
use crate::gltf::material::factors::surface;
use crate::gltf::material::image_source::{ImageConversion, ImageSource};
use crate::gltf::material::texture_slot::{TextureSlot, slots};
use crate::gltf::material::texture_source::image_of;
use crate::scene::{Material, MaterialInput, Texture, TextureBinding, TextureUse};

/// Collector of the materials, textures and images that the scene's meshes use, in the order of their first use.
pub(in crate::gltf) struct Materials<'a> {
    document: &'a GltfDocument,
    pub(in crate::gltf) materials: Vec<Material>,
    pub(in crate::gltf) textures: Vec<Texture>,
    /// Images that textures refer to.
    pub(in crate::gltf) images: Vec<ImageSource>,
    pub(in crate::gltf) warnings: Vec<String>,
    material_index: HashMap<MaterialKey, u32>,
    texture_index: HashMap<TextureKey, u32>,
}

/// Key of a texture: its number in the file, and the conversion of its image.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct TextureKey {
    number: usize,
    conversion: ImageConversion,
}

/// Key of a material: its number in the file (`None` for the default one), and the texture coordinate sets that the
/// mesh lacks.
#[derive(Clone, PartialEq, Eq, Hash)]
struct MaterialKey {
    number: Option<usize>,
    lacks: Vec<u32>,
}

impl<'a> Materials<'a> {
    pub(in crate::gltf) fn new(document: &'a GltfDocument) -> Materials<'a> {
        Materials {
            document,
            materials: Vec::new(),
            textures: Vec::new(),
            images: Vec::new(),
            warnings: Vec::new(),
            material_index: HashMap::new(),
            texture_index: HashMap::new(),
        }
    }

    /// Returns the scene's index of a material of the file for a mesh with certain texture coordinate sets. Textures
    /// whose set the mesh lacks are left out.
    pub(in crate::gltf) fn index_of(
        &mut self,
        number: Option<usize>,
        has_set: impl Fn(u32) -> bool,
    ) -> Result<u32, GltfError> {
        // Materials are distinct by the sets that a mesh lacks, as the textures on these are left out
        let mut lacks = self.document.texture_coordinate_sets(number)?;
        lacks.retain(|&set| !has_set(set));
        let key = MaterialKey { number, lacks };
        if let Some(&index) = self.material_index.get(&key) {
            return Ok(index);
        }
        let material = match number {
            Some(number) => self.read(number, &key.lacks)?,
            None => Material::default(),
        };
        let index = self.materials.len() as u32;
        self.materials.push(material);
        self.material_index.insert(key, index);
        Ok(index)
    }

    fn read(&mut self, number: usize, lacks: &[u32]) -> Result<Material, GltfError> {
        let document = self.document;
        let source = document.material(number)?;
        let name = match &source.name {
            Some(name) if !name.is_empty() => name.clone(),
            _ => format!("material {number}"),
        };
        // Warn about what is left out
        for set in lacks {
            self.warnings.push(format!(
                "material `{name}` looks up TEXCOORD_{set}, which a mesh lacks: it is rendered there \
                 without those textures"
            ));
        }
        let mut corrections = Corrections::default();
        // Read the factors
        let mut material = Material {
            name,
            ..surface(source, &mut corrections)
        };
        // Bind the textures that can have an effect
        for slot in slots(source, &mut corrections) {
            if lacks.contains(&slot.tex_coord) || !material.is_affected_by(slot.parameter, slot.strength) {
                continue;
            }
            if let Some(texture) = self.texture_use(&slot)? {
                material.layers.push(TextureBinding {
                    parameter: slot.parameter,
                    texture,
                    strength: slot.strength,
                });
            }
        }
        // Report corrected factors
        if !corrections.names.is_empty() {
            let (name, factors) = (&material.name, corrections.names.join(", "));
            self.warnings.push(format!(
                "material `{name}` has factors outside their range ({factors}): clamped to it"
            ));
        }
        Ok(material)
    }

    fn texture_use(&mut self, slot: &TextureSlot) -> Result<Option<TextureUse>, GltfError> {
        let number = slot.texture;
        let textures = &self.document.root.textures;
        let Some(source) = textures.get(number) else {
            return Err(self.document.missing("texture", number, textures.len()));
        };
        let key = TextureKey {
            number,
            conversion: slot.conversion,
        };
        let texture = match self.texture_index.get(&key) {
            Some(&index) => index,
            None => {
                // Add the texture on first use, with its image and its sampler
                let Some(image) = image_of(source) else {
                    self.warnings.push(format!(
                        "texture {number} has no PNG, JPEG or WebP image and was ignored"
                    ));
                    return Ok(None);
                };
                let image_count = self.document.root.images.len();
                if image >= image_count {
                    return Err(self.document.missing("image", image, image_count));
                }
                let sampler = self.document.sampler(source.sampler.map(|s| s.value()))?;
                let image = self.image_index(ImageSource {
                    number: image,
                    conversion: slot.conversion,
                });
                let index = self.textures.len() as u32;
                self.textures.push(Texture::Image { image, sampler });
                self.texture_index.insert(key, index);
                index
            }
        };
        Ok(Some(TextureUse {
            texture,
            tex_coord: slot.tex_coord,
            transform: slot.transform,
        }))
    }

    fn image_index(&mut self, image: ImageSource) -> u32 {
        let known = self.images.iter().position(|&known| known == image);
        known.unwrap_or_else(|| {
            self.images.push(image);
            self.images.len() - 1
        }) as u32
    }
}

impl GltfDocument {
    /// Returns the texture coordinate sets that a material uses, each once.
    pub(in crate::gltf) fn texture_coordinate_sets(
        &self,
        material: Option<usize>,
    ) -> Result<Vec<u32>, GltfError> {
        let Some(number) = material else {
            return Ok(Vec::new());
        };
        let slots = slots(self.material(number)?, &mut Corrections::default());
        let mut sets: Vec<u32> = slots.iter().map(|slot| slot.tex_coord).collect();
        sets.sort_unstable();
        sets.dedup();
        Ok(sets)
    }

    /// Returns the texture coordinate set by which tangents of a material are computed, if it needs tangents: that of its
    /// normal map, else of its anisotropy texture or the normal map of its coat, else the first set if its lobe is
    /// anisotropic.
    pub(in crate::gltf) fn tangent_set(&self, material: Option<usize>) -> Result<Option<u32>, GltfError> {
        let Some(number) = material else {
            return Ok(None);
        };
        let (source, corrections) = (self.material(number)?, &mut Corrections::default());
        let slots = slots(source, corrections);
        let set_of = |input| {
            let slot = slots.iter().find(|slot| slot.parameter == input);
            slot.map(|slot| slot.tex_coord)
        };
        // Prefer the set of the input that needs tangents most often
        let inputs = [
            MaterialInput::Normal,
            MaterialInput::Anisotropy,
            MaterialInput::ClearcoatNormal,
        ];
        let set = inputs.into_iter().find_map(set_of);
        let is_anisotropic = surface(source, corrections).anisotropic().is_some();
        Ok(set.or(is_anisotropic.then_some(0)))
    }

    fn material(&self, number: usize) -> Result<&json::Material, GltfError> {
        let materials = &self.root.materials;
        materials
            .get(number)
            .ok_or_else(|| self.missing("material", number, materials.len()))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use crate::gltf::document::of_json;
    use crate::optics::{Cauchy, Dispersion};
    use crate::scene::{
        AlphaMode, Anisotropy, Clearcoat, Iridescence, MetallicRoughness, Model, Sheen, Translucency,
        UvTransform,
    };

    struct Found {
        material: Material,
        warnings: Vec<String>,
        /// Numbers of the images that would be decoded.
        images: Vec<usize>,
    }

    /// Reads a material in a file with ten textures, each of the image of the same number.
    fn read(material: Value) -> Found {
        let textures: Vec<Value> = (0..10).map(|i| json!({"source": i})).collect();
        let images: Vec<Value> = (0..10).map(|i| json!({"uri": format!("{i}.png")})).collect();
        let root = json!({"asset": {"version": "2.0"}, "materials": [material], "textures": textures, "images": images});
        let document = of_json(&root);
        let mut materials = Materials::new(&document);
        assert_eq!(materials.index_of(Some(0), |_| true), Ok(0));
        Found {
            material: materials.materials.remove(0),
            warnings: materials.warnings,
            images: materials.images.iter().map(|image| image.number).collect(),
        }
    }

    fn with_extensions(extensions: Value) -> Found {
        read(json!({"extensions": extensions}))
    }

    fn model(found: &Found) -> MetallicRoughness {
        match found.material.model {
            Model::MetallicRoughness(model) => model,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn core_textures_keep_their_coordinate_set_and_strength() {
        let found = read(json!({
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1, "texCoord": 1}},
            "normalTexture": {"index": 2, "texCoord": 2, "scale": -0.5,
                "extensions": {"KHR_texture_transform": {"offset": [1, 2], "texCoord": 4}}},
            "occlusionTexture": {"index": 3, "texCoord": 3, "strength": 0.25,
                "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}},
            "emissiveTexture": {"index": 3}, "emissiveFactor": [1, 0, 0]
        }));
        // Check the coordinates and the transform of each texture
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let layer = |parameter| *found.material.layer(parameter).unwrap();
        let identity = TextureUse::new(0);
        assert_eq!(layer(MaterialInput::BaseColor).texture, identity);
        let metallic = TextureUse {
            texture: 1,
            tex_coord: 1,
            ..identity
        };
        assert_eq!(layer(MaterialInput::MetallicRoughness).texture, metallic);
        let normal = layer(MaterialInput::Normal);
        assert_eq!((normal.strength, normal.texture.tex_coord), (-0.5, 4));
        assert_eq!(normal.texture.transform.offset, [1.0, 2.0]);
        let occlusion = layer(MaterialInput::Occlusion);
        assert_eq!((occlusion.strength, occlusion.texture.tex_coord), (0.25, 3));
        assert_eq!(occlusion.texture.transform.matrix, [[2.0, 0.0], [0.0, 2.0]]);
        assert_eq!(
            layer(MaterialInput::Emission).texture.transform,
            UvTransform::IDENTITY
        );
        assert_eq!(
            layer(MaterialInput::Emission).texture.texture,
            occlusion.texture.texture
        );
        // Images are numbered in the order of their first use
        assert_eq!(found.images, [0, 1, 3, 2]);
    }

    #[test]
    fn specular_glossiness_becomes_a_dielectric_of_that_reflectance() {
        let found = with_extensions(json!({"KHR_materials_pbrSpecularGlossiness": {
            "diffuseFactor": [0.5, 0.25, 1, 0.75], "specularFactor": [0.75, 0.5, 0.25], "glossinessFactor": 0.25
        }}));
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        let model = model(&found);
        assert_eq!((model.metallic, model.roughness), (0.0, 0.75));
        assert_eq!(model.specular_color, [0.75, 0.5, 0.25]);
        assert_eq!(found.material.base_color, [0.5, 0.25, 1.0, 0.75]);
        // The reflectance ((n - 1) / (n + 1))^2 is 1 in f32.
        let ior = found.material.ior(crate::optics::LINE_D);
        assert_eq!(((ior - 1.0) / (ior + 1.0)).powi(2) as f32, 1.0);
        assert!(ior <= crate::scene::MAX_OPAQUE_IOR);
    }

    #[test]
    fn glossiness_texture_becomes_roughness() {
        let found = with_extensions(json!({"KHR_materials_pbrSpecularGlossiness": {
            "diffuseTexture": {"index": 3}, "specularGlossinessTexture": {"index": 5}, "glossinessFactor": 0.5
        }}));
        assert_eq!(model(&found).roughness, 1.0);
        let layer = |parameter| found.material.layer(parameter).unwrap().texture.texture;
        assert_eq!(layer(MaterialInput::BaseColor), 0);
        assert_eq!(layer(MaterialInput::SpecularColor), 1);
        assert_eq!(layer(MaterialInput::Roughness), 2);
        // The same image twice, as it is and converted.
        assert_eq!(found.images, [3, 5, 5]);
    }

    #[test]
    fn alpha_mode_is_opaque_mask_or_blend() {
        let alpha = |material: Value| read(material).material.alpha;
        assert_eq!(alpha(json!({})), AlphaMode::Opaque);
        assert_eq!(alpha(json!({"alphaMode": "MASK"})), AlphaMode::Mask(0.5));
        assert_eq!(
            alpha(json!({"alphaMode": "MASK", "alphaCutoff": 2})),
            AlphaMode::Mask(2.0)
        );
        assert_eq!(
            alpha(json!({"alphaMode": "BLEND", "alphaCutoff": 2})),
            AlphaMode::Blend
        );
        let odd = read(json!({"alphaMode": "SOLID"}));
        assert_eq!(odd.material.alpha, AlphaMode::Opaque);
        assert!(odd.warnings[0].contains("alphaMode"), "{:?}", odd.warnings);
    }

    #[test]
    fn unlit_material_keeps_only_its_base_colour() {
        let found = read(json!({
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0, 0.75], "baseColorTexture": {"index": 4}},
            "normalTexture": {"index": 5}, "emissiveFactor": [1, 1, 1], "alphaMode": "BLEND",
            "extensions": {"KHR_materials_unlit": {}, "KHR_materials_transmission": {"transmissionFactor": 1}}
        }));
        assert_eq!(found.material.model, Model::Unlit);
        assert_eq!(found.material.base_color, [0.5, 0.25, 0.0, 0.75]);
        assert_eq!(
            (found.material.emission, found.material.alpha),
            ([0.0; 3], AlphaMode::Blend)
        );
        assert_eq!((found.images, found.material.interior), (vec![4], None));
    }

    #[test]
    fn specular_and_emissive_strength_are_read_with_their_textures() {
        let found = read(json!({"emissiveFactor": [0.5, 0.25, 0], "extensions": {
            "KHR_materials_emissive_strength": {"emissiveStrength": 8},
            "KHR_materials_specular": {"specularFactor": 0.5, "specularTexture": {"index": 6},
                "specularColorFactor": [0.1, 2, 1], "specularColorTexture": {"index": 7, "texCoord": 1,
                "extensions": {"KHR_texture_transform": {"offset": [0, 1]}}}}
        }}));
        // Check the factors
        assert_eq!(found.material.emission, [4.0, 2.0, 0.0]);
        assert_eq!(
            (model(&found).specular, model(&found).specular_color),
            (0.5, [0.1, 2.0, 1.0])
        );
        // Check the textures
        let color = found
            .material
            .layer(MaterialInput::SpecularColor)
            .unwrap()
            .texture;
        assert_eq!(
            (color.texture, color.tex_coord, color.transform.offset),
            (1, 1, [0.0, 1.0])
        );
        assert_eq!(
            found
                .material
                .layer(MaterialInput::Specular)
                .unwrap()
                .texture
                .texture,
            0
        );
        assert_eq!(found.images, [6, 7]);
    }

    #[test]
    fn volume_that_scatters_replaces_diffuse_transmission() {
        let extensions = |thickness: f64| {
            json!({
                "KHR_materials_diffuse_transmission": {
                    "diffuseTransmissionFactor": 0.75, "diffuseTransmissionColorFactor": [1, 0.5, 0]
                },
                "KHR_materials_volume": {
                    "thicknessFactor": thickness, "attenuationColor": [0.5, 0.5, 0.5], "attenuationDistance": 1
                },
                "KHR_materials_volume_scatter": {"multiscatterColor": [0.9, 0.8, 0.7]}
            })
        };
        let wax = with_extensions(extensions(1.0)).material;
        assert!(wax.scatters().is_some() && wax.translucent().is_none());
        // Three quarters of the white base have the colour of the light that enters
        assert_eq!(wax.base_color, [1.0, 0.625, 0.25, 1.0]);
        let leaf = with_extensions(extensions(0.0)).material;
        assert!(leaf.scatters().is_none() && leaf.translucent().is_some());
    }

    #[test]
    fn diffuse_transmission_makes_a_thin_surface_without_specular_transmission() {
        let diffuse =
            json!({"diffuseTransmissionFactor": 0.25, "diffuseTransmissionColorFactor": [0, 1, 0.5]});
        let leaf = with_extensions(json!({ "KHR_materials_diffuse_transmission": diffuse }));
        let expected = Translucency {
            factor: 0.25,
            color: [0.0, 1.0, 0.5],
        };
        assert_eq!(
            (leaf.material.translucency, leaf.warnings),
            (Some(expected), vec![])
        );
        let pane = with_extensions(json!({
            "KHR_materials_diffuse_transmission": diffuse,
            "KHR_materials_transmission": {"transmissionFactor": 1}
        }));
        assert_eq!(pane.material.translucency, None);
        let veined = with_extensions(json!({
            "KHR_materials_diffuse_transmission": {
                "diffuseTransmissionFactor": 1, "diffuseTransmissionColorTexture": {"index": 1}
            }
        }));
        assert_eq!((veined.images, veined.warnings), (vec![1], vec![]));
        assert!(veined.material.layer(MaterialInput::TranslucencyColor).is_some());
    }

    #[test]
    fn layers_and_lobes_of_extensions_are_read_with_their_textures() {
        let found = with_extensions(json!({
            "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25,
                "clearcoatTexture": {"index": 0}, "clearcoatRoughnessTexture": {"index": 1},
                "clearcoatNormalTexture": {"index": 2, "scale": 2}},
            "KHR_materials_sheen": {"sheenColorFactor": [1, 0.5, 0], "sheenRoughnessFactor": 0.75,
                "sheenColorTexture": {"index": 3}, "sheenRoughnessTexture": {"index": 4}},
            "KHR_materials_anisotropy": {"anisotropyStrength": 0.5, "anisotropyRotation": -2,
                "anisotropyTexture": {"index": 5}},
            "KHR_materials_iridescence": {"iridescenceFactor": 1, "iridescenceIor": 1.5,
                "iridescenceThicknessMinimum": 200, "iridescenceThicknessMaximum": 600,
                "iridescenceTexture": {"index": 6}, "iridescenceThicknessTexture": {"index": 7}}
        }));
        assert_eq!((found.warnings, found.images), (vec![], (0..8).collect()));
        let material = found.material;
        assert_eq!(
            material.clearcoat,
            Some(Clearcoat {
                factor: 0.5,
                roughness: 0.25
            })
        );
        let sheen = Sheen {
            color: [1.0, 0.5, 0.0],
            roughness: 0.75,
        };
        assert_eq!(material.sheen, Some(sheen));
        assert_eq!(
            material.anisotropy,
            Some(Anisotropy {
                strength: 0.5,
                rotation: -2.0
            })
        );
        let film = Iridescence {
            factor: 1.0,
            ior: 1.5,
            thickness: [200.0, 600.0],
        };
        assert_eq!(material.iridescence, Some(film));
        let coat_normal = material.layer(MaterialInput::ClearcoatNormal).unwrap();
        assert_eq!(coat_normal.strength, 2.0);
    }

    #[test]
    fn transmissive_volume_material_has_an_interior() {
        let thin = with_extensions(json!({
            "KHR_materials_transmission": {"transmissionFactor": 0.5, "transmissionTexture": {"index": 8}}
        }));
        assert_eq!(model(&thin).transmission, 0.5);
        assert!(thin.material.interior.unwrap().is_thin() && thin.material.transmits());
        assert_eq!(thin.images, [8]);
        let glass = with_extensions(json!({
            "KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_ior": {"ior": 1.7},
            "KHR_materials_volume": {"thicknessFactor": 1, "thicknessTexture": {"index": 9}},
            "KHR_materials_dispersion": {"dispersion": 0.3}
        }));
        let interior = glass.material.interior.unwrap();
        assert!(!interior.is_thin());
        assert_eq!(interior.ior, Dispersion::Cauchy(Cauchy::from_gltf(1.7, 0.3)));
        assert!(glass.images.is_empty(), "the path through the interior is traced");
    }

    #[test]
    fn textures_without_effect_are_not_decoded() {
        let found = read(json!({
            "emissiveTexture": {"index": 0}, "occlusionTexture": {"index": 1, "strength": 0},
            "extensions": {
                "KHR_materials_clearcoat": {"clearcoatFactor": 0, "clearcoatTexture": {"index": 2}},
                "KHR_materials_transmission": {"transmissionTexture": {"index": 3}},
                "KHR_materials_specular": {"specularFactor": 0, "specularTexture": {"index": 4}}
            }
        }));
        assert!(found.images.is_empty() && found.material.layers.is_empty());
    }

    #[test]
    fn out_of_range_factors_are_clamped_with_one_warning() {
        let found = read(json!({
            "pbrMetallicRoughness": {"roughnessFactor": 7}, "normalTexture": {"index": 0, "scale": 1e39},
            "emissiveFactor": [-1, 0, 0], "occlusionTexture": {"index": 1, "strength": -1e39},
            "extensions": {
                "KHR_materials_specular": {"specularFactor": "much", "specularColorFactor": [-1, 1]},
                "KHR_materials_transmission": {"transmissionFactor": 3, "transmissionTexture": 5},
                "KHR_materials_volume": {"thicknessFactor": 1, "attenuationDistance": -2},
                "KHR_materials_ior": {"ior": 1e9}, "KHR_materials_emissive_strength": 4
            }
        }));
        // All corrections are in one warning
        let [warning] = &found.warnings[..] else {
            panic!("{:?}", found.warnings);
        };
        for name in [
            "roughnessFactor",
            "scale",
            "strength",
            "emissiveFactor",
            "specularFactor",
            "specularColorFactor",
            "transmissionFactor",
            "transmissionTexture",
            "attenuationDistance",
            "ior",
            "KHR_materials_emissive_strength",
        ] {
            assert!(warning.contains(name), "{name}: {warning}");
        }
        // Check the corrected factors
        assert_eq!(found.material.layer(MaterialInput::Normal).unwrap().strength, 1.0);
        assert_eq!((model(&found).roughness, model(&found).transmission), (1.0, 1.0));
        assert_eq!(found.material.emission, [0.0; 3]);
    }
}
