//! Materials and the textures they use: glTF's metallic-roughness parameters, with only what is used carried over.

use std::collections::HashMap;
use std::f32;

use gltf::json;
use json::texture::{MagFilter, MinFilter, WrappingMode};
use json::validation::Checked;

use super::GltfError;
use super::document::{Document, NO_IMAGE};
use crate::scene::{
    Filter, Layer, Material, MetallicRoughness, Model, Parameter, Sampler, Texture, TextureUse, UvTransform,
    Wrap,
};

/// Collects the materials, textures and images that the scene's meshes use, in the order of their first use.
pub(super) struct Materials<'a> {
    document: &'a Document,
    pub(super) materials: Vec<Material>,
    pub(super) textures: Vec<Texture>,
    /// Numbers of the file's images that textures refer to.
    pub(super) images: Vec<usize>,
    pub(super) warnings: Vec<String>,
    material_index: HashMap<Key, u32>,
    texture_index: HashMap<usize, u32>,
}

/// A material of the file (none: the default one), and the texture coordinate sets that the mesh lacks.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Key {
    number: Option<usize>,
    lacks: Vec<u32>,
}

impl<'a> Materials<'a> {
    pub(super) fn new(document: &'a Document) -> Materials<'a> {
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

    /// The scene's index of a material of the file for a mesh with certain texture coordinate sets. Textures whose
    /// set the mesh lacks are left out.
    pub(super) fn index_of(
        &mut self,
        number: Option<usize>,
        has_set: impl Fn(u32) -> bool,
    ) -> Result<u32, GltfError> {
        let mut lacks = self.document.texture_coordinate_sets(number)?;
        lacks.retain(|&set| !has_set(set));
        let key = Key { number, lacks };
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
        for set in lacks {
            self.warnings.push(format!(
                "material `{name}` looks up TEXCOORD_{set}, which a mesh lacks: shown there without those textures"
            ));
        }
        let pbr = &source.pbr_metallic_roughness;
        let textures = [
            (Parameter::BaseColor, &pbr.base_color_texture),
            (Parameter::MetallicRoughness, &pbr.metallic_roughness_texture),
            (Parameter::Emission, &source.emissive_texture),
        ];
        let mut layers = Vec::new();
        for (parameter, info) in textures {
            let info = info.as_ref().filter(|info| !lacks.contains(&info.tex_coord));
            if let Some(texture) = info.map_or(Ok(None), |info| self.texture_use(info))? {
                layers.push(Layer {
                    parameter,
                    texture,
                    strength: 1.0,
                });
            }
        }
        let mut is_corrected = false;
        let mut corrected = |x: f32, most: f32| {
            let y = if x.is_nan() { 0.0 } else { x.clamp(0.0, most) };
            is_corrected |= y != x;
            y
        };
        let strength = emissive_strength(source);
        let material = Material {
            model: Model::MetallicRoughness(MetallicRoughness {
                metallic: corrected(pbr.metallic_factor.0, 1.0),
                roughness: corrected(pbr.roughness_factor.0, 1.0),
                ..MetallicRoughness::DEFAULT
            }),
            base_color: pbr.base_color_factor.0.map(|x| corrected(x, 1.0)),
            emission: source
                .emissive_factor
                .0
                .map(|x| corrected(x * strength, f32::MAX)),
            layers,
            name,
            ..Material::default()
        };
        if is_corrected {
            let name = &material.name;
            self.warnings.push(format!(
                "material `{name}` has factors outside their range: brought back into it"
            ));
        }
        Ok(material)
    }

    fn texture_use(&mut self, info: &json::texture::Info) -> Result<Option<TextureUse>, GltfError> {
        let number = info.index.value();
        let textures = &self.document.root.textures;
        let Some(source) = textures.get(number) else {
            return Err(self.document.missing("texture", number, textures.len()));
        };
        let texture = match self.texture_index.get(&number) {
            Some(&index) => index,
            None => {
                let image = source.source.value();
                if image == NO_IMAGE as usize {
                    self.warnings.push(format!(
                        "texture {number} has no PNG or JPEG image and was ignored"
                    ));
                    return Ok(None);
                }
                let image_count = self.document.root.images.len();
                if image >= image_count {
                    return Err(self.document.missing("image", image, image_count));
                }
                let sampler = self.document.sampler(source.sampler.map(|s| s.value()))?;
                let image = self.image_index(image);
                let index = self.textures.len() as u32;
                self.textures.push(Texture::Image { image, sampler });
                self.texture_index.insert(number, index);
                index
            }
        };
        Ok(Some(TextureUse {
            texture,
            tex_coord: info.tex_coord,
            transform: UvTransform::IDENTITY,
        }))
    }

    fn image_index(&mut self, number: usize) -> u32 {
        let known = self.images.iter().position(|&i| i == number);
        known.unwrap_or_else(|| {
            self.images.push(number);
            self.images.len() - 1
        }) as u32
    }
}

impl Document {
    /// The texture coordinate sets that a material looks up, each once.
    pub(super) fn texture_coordinate_sets(&self, material: Option<usize>) -> Result<Vec<u32>, GltfError> {
        let Some(number) = material else {
            return Ok(Vec::new());
        };
        let material = self.material(number)?;
        let pbr = &material.pbr_metallic_roughness;
        let infos = [
            &pbr.base_color_texture,
            &pbr.metallic_roughness_texture,
            &material.emissive_texture,
        ];
        let mut sets: Vec<u32> = infos.into_iter().flatten().map(|info| info.tex_coord).collect();
        sets.sort_unstable();
        sets.dedup();
        Ok(sets)
    }

    fn material(&self, number: usize) -> Result<&json::Material, GltfError> {
        let materials = &self.root.materials;
        materials
            .get(number)
            .ok_or_else(|| self.missing("material", number, materials.len()))
    }

    fn sampler(&self, number: Option<usize>) -> Result<Sampler, GltfError> {
        let samplers = &self.root.samplers;
        let sampler = match number {
            None => &json::texture::Sampler::default(),
            Some(number) => samplers
                .get(number)
                .ok_or_else(|| self.missing("sampler", number, samplers.len()))?,
        };
        let wrap = |mode: &Checked<WrappingMode>| match mode {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::ClampToEdge,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::MirroredRepeat,
            _ => Wrap::Repeat,
        };
        let nearest_min = [
            MinFilter::Nearest,
            MinFilter::NearestMipmapNearest,
            MinFilter::NearestMipmapLinear,
        ];
        let filter = match (sampler.mag_filter, sampler.min_filter) {
            (Some(Checked::Valid(MagFilter::Nearest)), _) => Filter::Nearest,
            (None, Some(Checked::Valid(min))) if nearest_min.contains(&min) => Filter::Nearest,
            _ => Filter::Linear,
        };
        Ok(Sampler {
            wrap_u: wrap(&sampler.wrap_s),
            wrap_v: wrap(&sampler.wrap_t),
            filter,
        })
    }
}

/// The factor of `KHR_materials_emissive_strength`, 1 where it is absent or senseless.
fn emissive_strength(material: &json::Material) -> f32 {
    material
        .extensions
        .as_ref()
        .and_then(|e| e.others.get("KHR_materials_emissive_strength"))
        .and_then(|e| e.get("emissiveStrength"))
        .and_then(|strength| strength.as_f64())
        .map(|strength| strength as f32)
        .filter(|strength| (0.0..f32::INFINITY).contains(strength))
        .unwrap_or(1.0)
}
