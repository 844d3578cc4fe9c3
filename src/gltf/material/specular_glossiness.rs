//! Materials of specular-glossiness workflow: `KHR_materials_pbrSpecularGlossiness`.
//!
//! Such a material is a dielectric whose reflectance at normal incidence is the specular colour itself: metalness 0, an
//! index of refraction whose reflectance is 1, and that colour as its specular colour. Roughness is 1 - glossiness.

use gltf::json;
use serde_json::{Map, Value};

use crate::gltf::extension::{Corrections, Extension};
use crate::gltf::material::image_source::ImageConversion;
use crate::gltf::material::medium::REFLECTING_IOR;
use crate::optics::{Absorption, Dispersion};
use crate::scene::{Medium, MediumKind, MetallicRoughness};

/// Factors and textures of a specular-glossiness material.
pub(in crate::gltf) struct SpecularGlossiness {
    /// Diffuse colour and coverage.
    pub(in crate::gltf) diffuse: [f32; 4],
    pub(in crate::gltf) diffuse_texture: Option<json::texture::Info>,
    /// Specular colour in RGB, encoded as sRGB, and glossiness in A.
    pub(in crate::gltf) specular_glossiness_texture: Option<json::texture::Info>,
    specular: [f32; 3],
    glossiness: f64,
}

impl SpecularGlossiness {
    /// Reads the extension of a material; `None` if it is absent.
    pub(in crate::gltf) fn read(
        extensions: Option<&Map<String, Value>>,
        corrections: &mut Corrections,
    ) -> Option<SpecularGlossiness> {
        let extension = Extension::of(extensions, "KHR_materials_pbrSpecularGlossiness", corrections);
        let unit = 0.0..=1.0;
        extension.is_present().then(|| SpecularGlossiness {
            diffuse: extension
                .vector("diffuseFactor", [1.0; 4], unit.clone(), corrections)
                .map(|x| x as f32),
            diffuse_texture: extension.texture("diffuseTexture", corrections),
            specular_glossiness_texture: extension.texture("specularGlossinessTexture", corrections),
            specular: extension
                .vector("specularFactor", [1.0; 3], unit.clone(), corrections)
                .map(|x| x as f32),
            glossiness: extension.number("glossinessFactor", 1.0, unit, corrections),
        })
    }

    /// Returns the parameters of the metallic-roughness model.
    pub(in crate::gltf) fn model(&self) -> MetallicRoughness {
        MetallicRoughness {
            metallic: 0.0,
            // The texture holds the roughness itself, which includes the factor
            roughness: match self.specular_glossiness_texture {
                Some(_) => 1.0,
                None => (1.0 - self.glossiness) as f32,
            },
            specular_color: self.specular,
            ..MetallicRoughness::DEFAULT
        }
    }

    /// Returns the interior, whose index of refraction gives the reflectance 1.
    pub(in crate::gltf) fn interior(&self) -> Medium {
        Medium {
            ior: Dispersion::Constant(REFLECTING_IOR),
            absorption: Absorption::NONE,
            priority: 0,
            kind: MediumKind::ThinFace,
        }
    }

    /// Returns the conversion of the texture's image to an image of roughness.
    pub(in crate::gltf) fn roughness_conversion(&self) -> ImageConversion {
        ImageConversion::RoughnessFromAlpha {
            glossiness: (self.glossiness * f64::from(u16::MAX)).round() as u16,
        }
    }
}
