//! Materials: surface models, material inputs with their textures, and the media inside surfaces.
//!
//! A material input is a factor times the textures that are bound to it.

use std::collections::HashSet;

use super::effect::{Effect, EffectSet};
use super::material_layer::{Anisotropy, Clearcoat, Iridescence, Sheen};
use super::texture::MaterialInput;
use super::{Scene, TextureBinding};
use crate::optics::subsurface::Scattering;
use crate::optics::{Absorption, DiffuseTransmission, Dispersion};

/// Description of a surface and of the medium behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name of the material in messages.
    pub name: String,
    /// Illumination model of the surface.
    pub model: Model,
    /// Linear RGBA base colour: it tints the diffuse and ambient light of either model, the reflection of a metal, and
    /// transmitted light; the fourth channel is the coverage.
    pub base_color: [f32; 4],
    /// Emitted radiance, linear RGB.
    pub emission: [f32; 3],
    /// Interpretation of the coverage.
    pub alpha: AlphaMode,
    /// Textures bound to material inputs; each input at most once.
    pub layers: Vec<TextureBinding>,
    /// Medium behind the surface, if light enters it.
    pub interior: Option<Medium>,
    /// Subsurface scattering from which the diffuse light comes, per unit of length of the scene. Only with glTF's
    /// model, and without transmission or translucency. The base colour tints the light that leaves.
    pub subsurface: Option<Scattering>,
    /// Diffuse transmission of a thin surface with glTF's model.
    pub translucency: Option<Translucency>,
    /// Clear coat over a surface of glTF's model.
    pub clearcoat: Option<Clearcoat>,
    /// Sheen of a surface of glTF's model.
    pub sheen: Option<Sheen>,
    /// Anisotropy of the specular lobe of glTF's model.
    pub anisotropy: Option<Anisotropy>,
    /// Thin film on a surface of glTF's model.
    pub iridescence: Option<Iridescence>,
}

/// Diffuse transmission of a thin surface (`KHR_materials_diffuse_transmission`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Translucency {
    /// Fraction of the diffuse light that leaves on the other side, 0 to 1.
    pub factor: f32,
    /// Colour of the transmitted light, linear RGB, 0 to 1.
    pub color: [f32; 3],
}

impl Translucency {
    /// Returns the diffuse reflection and transmission under a white base colour.
    pub(crate) fn diffuse_transmission(&self) -> DiffuseTransmission {
        DiffuseTransmission::from_diffuse_transmission(
            [1.0; 3],
            self.factor.into(),
            self.color.map(f64::from),
        )
    }
}

/// Illumination model of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// Metallic-roughness model of glTF.
    MetallicRoughness(MetallicRoughness),
    /// Model of Phong and Whitted: `I = Ia ra + sum of Il (rd (s.m) + rsp (r.v)^f) + kr I(reflected) + kt
    /// I(transmitted)`.
    Phong(Phong),
    /// Constant colour: the base colour, whatever the light (`KHR_materials_unlit`).
    Unlit,
}

/// Metallic-roughness parameters of glTF 2.0, 3.9.2, with `KHR_materials_specular` and `KHR_materials_transmission`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetallicRoughness {
    /// Metalness: 0 for a dielectric, 1 for a metal.
    pub metallic: f32,
    /// Perceptual roughness, from 0 for a mirror to 1 for chalk.
    pub roughness: f32,
    /// Strength of a dielectric's reflection, 0 to 1.
    pub specular: f32,
    /// Colour of a dielectric's reflection at normal incidence, linear RGB.
    pub specular_color: [f32; 3],
    /// Fraction of the light that is not reflected which is transmitted instead of scattered diffusely, 0 to 1.
    pub transmission: f32,
    /// Rays into the lobe of a rough surface at a hit of a camera ray, up to [`MAX_ROUGH_RAYS`]; one at hits of
    /// secondary rays. With 0 the surface reflects as a mirror up to [`MIRROR_ROUGHNESS`], only lights beyond it, and
    /// refracts as a smooth one.
    pub rough_rays: u32,
}

impl MetallicRoughness {
    /// Default parameters of glTF: metallic 1, roughness 1.
    pub const DEFAULT: MetallicRoughness = MetallicRoughness {
        metallic: 1.0,
        roughness: 1.0,
        specular: 1.0,
        specular_color: [1.0; 3],
        transmission: 0.0,
        rough_rays: 0,
    };
}

/// Coefficients of Phong and Whitted's model. The base colour multiplies `ambient` and `diffuse`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phong {
    /// Ambient coefficient ra, linear RGB.
    pub ambient: [f32; 3],
    /// Diffuse coefficient rd, linear RGB.
    pub diffuse: [f32; 3],
    /// Specular coefficient rsp, linear RGB.
    pub specular: [f32; 3],
    /// Exponent f of the highlight; at least 0.
    pub exponent: f32,
    /// Coefficient kr of the reflected ray, linear RGB.
    pub reflection: [f32; 3],
    /// Coefficient kt of the transmitted ray, linear RGB.
    pub transmission: [f32; 3],
    /// Flag for Fresnel's equations, which then divide the light between the two rays, in addition to kr and kt.
    pub fresnel: bool,
}

impl Phong {
    /// A chalky surface: ambient and diffuse 1, all else 0.
    pub const DEFAULT: Phong = Phong {
        ambient: [1.0; 3],
        diffuse: [1.0; 3],
        specular: [0.0; 3],
        exponent: 1.0,
        reflection: [0.0; 3],
        transmission: [0.0; 3],
        fresnel: false,
    };
}

/// Interpretation of the fourth channel of the base colour (glTF 2.0, 3.9.4).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// No meaning: the surface is opaque.
    #[default]
    Opaque,
    /// Threshold: the surface exists where the coverage is at least this value.
    Mask(f32),
    /// Blending: the surface covers that fraction of what is behind it.
    Blend,
}

impl AlphaMode {
    /// Returns whether the fourth channel of the base colour counts, with these effects.
    #[inline(always)]
    pub fn is_simulated(self, effects: EffectSet) -> bool {
        match self {
            AlphaMode::Opaque => false,
            AlphaMode::Mask(_) => effects.has(Effect::AlphaTest),
            AlphaMode::Blend => effects.has(Effect::AlphaBlend),
        }
    }

    /// Returns the opacity of the surface for the fourth channel of its base colour.
    #[inline(always)]
    pub fn coverage(self, alpha: f32) -> f32 {
        match self {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask(cutoff) if alpha >= cutoff => 1.0,
            AlphaMode::Mask(_) => 0.0,
            AlphaMode::Blend => alpha.clamp(0.0, 1.0),
        }
    }
}

/// Medium inside a surface, for light that passes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Index of refraction as a function of the wavelength.
    pub ior: Dispersion,
    /// Absorption coefficients per metre of the medium.
    pub absorption: Absorption,
    /// Priority of the medium: where interiors overlap, that of the highest priority is effective (Schmidt and Budge,
    /// 2002).
    pub priority: i32,
    /// Kind of the medium: an interior, or a thin wall.
    pub kind: MediumKind,
}

/// Kind of a medium inside a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MediumKind {
    /// Interior that the surface bounds, and that light crosses.
    Solid,
    /// Thin wall of two faces without an interior, with all reflections between them: light passes straight on.
    ThinSlab,
    /// Thin wall of one face without an interior, as in `KHR_materials_transmission`: light passes straight on, less
    /// one Fresnel reflectance.
    ThinFace,
}

impl Medium {
    /// Returns whether the medium is a thin wall without an interior, so that light passes straight on.
    pub fn is_thin(&self) -> bool {
        self.kind != MediumKind::Solid
    }
}

impl Default for Material {
    /// Returns glTF's default material: white, metallic 1, roughness 1.
    fn default() -> Material {
        Material {
            name: "default".into(),
            model: Model::MetallicRoughness(MetallicRoughness::DEFAULT),
            base_color: [1.0; 4],
            emission: [0.0; 3],
            alpha: AlphaMode::Opaque,
            layers: Vec::new(),
            interior: None,
            subsurface: None,
            translucency: None,
            clearcoat: None,
            sheen: None,
            anisotropy: None,
            iridescence: None,
        }
    }
}

/// Largest perceptual roughness at which surfaces reflect an image: the width of their lobe (alpha = 0.01, about half a
/// degree) is that of a few pixels. Rougher surfaces need many rays for one reflection, which `rough_rays` enables.
pub const MIRROR_ROUGHNESS: f32 = 0.1;

/// Largest perceptual roughness at which reflections in metal show shapes as large as a soft box: the lobe (alpha = 0.36)
/// is about 40 degrees wide.
const GLOSSY_METAL: f32 = 0.6;

/// Largest perceptual roughness at which a dielectric shows them, which reflects 4 percent of the light. It is below the 0.5
/// that modelling programs give to new materials.
const GLOSSY_DIELECTRIC: f32 = 0.4;

/// Largest number of rays into one lobe. For more, samples per pixel serve as well.
pub const MAX_ROUGH_RAYS: u32 = 256;

/// Rays into the lobe of each rough surface that an environment map lights, unless the user or the material gives a
/// number: with one, the samples of a pixel resolve the reflection, and smooth and rough surfaces cost the same.
const ENVIRONMENT_ROUGH_RAYS: u32 = 1;

/// Default index of refraction of a material, from glTF: that of window glass.
pub const DEFAULT_IOR: f64 = 1.5;

impl Scene {
    /// Sets the number of rays into the lobe of every material of the metallic-roughness model.
    pub fn set_rough_rays(&mut self, rays: u32) {
        for material in &mut self.materials {
            if let Model::MetallicRoughness(model) = &mut material.model {
                model.rough_rays = rays;
            }
        }
    }

    /// Lets surfaces that show shapes in their reflections reflect the background, like [`Scene::reflect_environment`];
    /// returns whether there are any.
    pub(crate) fn reflect_background_in_gloss(&mut self) -> bool {
        let dull = |(_, material): &(usize, &Material)| !material.may_show_reflections();
        let dull: HashSet<u32> = self
            .materials
            .iter()
            .enumerate()
            .filter(dull)
            .map(|(index, _)| index as u32)
            .collect();
        self.reflect_environment(&dull);
        dull.len() < self.materials.len()
    }

    /// Lets rough surfaces reflect the environment map: materials that send no rays into their lobes send one. Those whose
    /// indices are in `exact` keep their number.
    pub(crate) fn reflect_environment(&mut self, exact: &HashSet<u32>) {
        for (index, material) in self.materials.iter_mut().enumerate() {
            if let Model::MetallicRoughness(model) = &mut material.model
                && model.rough_rays == 0
                && !exact.contains(&(index as u32))
            {
                model.rough_rays = ENVIRONMENT_ROUGH_RAYS;
            }
        }
    }
}

impl Material {
    /// Returns whether a texture of `strength` on `parameter` can have an effect: a factor of zero stays zero.
    pub(crate) fn is_affected_by(&self, parameter: MaterialInput, strength: f32) -> bool {
        let [r, g, b, a] = self.base_color;
        match (parameter, &self.model) {
            // Coverage only counts unless the surface is opaque
            (MaterialInput::BaseColor, _) => {
                [r, g, b] != [0.0; 3] || (a != 0.0 && self.alpha != AlphaMode::Opaque)
            }
            (MaterialInput::Emission, _) => self.emission != [0.0; 3],
            // These replace or scale something that every material has
            (MaterialInput::Normal | MaterialInput::Bump | MaterialInput::Occlusion, _) => strength != 0.0,
            // All others multiply a factor of the model
            (parameter, Model::MetallicRoughness(model)) => match parameter {
                MaterialInput::Roughness => model.roughness != 0.0,
                MaterialInput::Metallic => model.metallic != 0.0,
                MaterialInput::MetallicRoughness => model.roughness != 0.0 || model.metallic != 0.0,
                MaterialInput::Specular => model.specular != 0.0,
                MaterialInput::SpecularColor => model.specular_color != [0.0; 3],
                MaterialInput::Transmission => model.transmission != 0.0,
                MaterialInput::Translucency | MaterialInput::TranslucencyColor => {
                    self.translucent().is_some()
                }
                MaterialInput::Clearcoat | MaterialInput::ClearcoatNormal => self.coated().is_some(),
                MaterialInput::ClearcoatRoughness => self.coated().is_some_and(|coat| coat.roughness != 0.0),
                MaterialInput::SheenColor => self.sheening().is_some(),
                MaterialInput::SheenRoughness => self.sheening().is_some_and(|sheen| sheen.roughness != 0.0),
                MaterialInput::Anisotropy => self.anisotropic().is_some(),
                MaterialInput::Iridescence | MaterialInput::IridescenceThickness => {
                    self.iridescent().is_some()
                }
                _ => true,
            },
            (MaterialInput::SpecularColor, Model::Phong(phong)) => phong.specular != [0.0; 3],
            (MaterialInput::Reflection, Model::Phong(phong)) => phong.reflection != [0.0; 3],
            (MaterialInput::Transmission, Model::Phong(phong)) => phong.transmission != [0.0; 3],
            _ => true,
        }
    }

    /// Returns a material of the metallic-roughness model without textures.
    pub fn metallic_roughness(base_color: [f32; 3], metallic: f32, roughness: f32) -> Material {
        Material {
            model: Model::MetallicRoughness(MetallicRoughness {
                metallic,
                roughness,
                ..MetallicRoughness::DEFAULT
            }),
            base_color: [base_color[0], base_color[1], base_color[2], 1.0],
            ..Material::default()
        }
    }

    /// Returns the texture bound to `parameter`, if there is one.
    pub fn layer(&self, parameter: MaterialInput) -> Option<&TextureBinding> {
        self.layers.iter().find(|layer| layer.parameter == parameter)
    }

    /// Returns whether the surface itself may transmit light; holes by partial coverage do not count.
    pub fn transmits(&self) -> bool {
        match &self.model {
            Model::MetallicRoughness(model) => model.transmission > 0.0,
            Model::Phong(phong) => phong.transmission != [0.0; 3],
            Model::Unlit => false,
        }
    }

    /// Returns the number of rays into the material's rough lobes at hits of camera rays; 0 if it has no lobe or sends
    /// none.
    pub fn rough_rays(&self) -> u32 {
        match &self.model {
            // A texture multiplies the factor, so a factor of 0 stays smooth.
            Model::MetallicRoughness(model) => {
                let has_rough_coat = self.coated().is_some_and(|coat| coat.roughness > 0.0);
                let is_rough = model.roughness > 0.0 || self.anisotropic().is_some() || has_rough_coat;
                if is_rough { model.rough_rays } else { 0 }
            }
            _ => 0,
        }
    }

    /// Returns the subsurface scattering, if the model supports it.
    pub fn scatters(&self) -> Option<&Scattering> {
        // Only the metallic-roughness model has subsurface scattering
        let has_inside = matches!(self.model, Model::MetallicRoughness(_));
        self.subsurface.as_ref().filter(|_| has_inside)
    }

    /// Returns the diffuse transmission, if the model supports it and its factor is positive.
    pub fn translucent(&self) -> Option<&Translucency> {
        let has_two_sides = matches!(self.model, Model::MetallicRoughness(_));
        self.translucency
            .as_ref()
            .filter(|diffuse_transmission| has_two_sides && diffuse_transmission.factor > 0.0)
    }

    /// Returns whether the surface may reflect an image, or refracts and is no thin wall.
    pub(crate) fn is_sharp(&self) -> bool {
        let is_body = self.interior.is_some_and(|inside| !inside.is_thin());
        self.may_mirror() || self.transmits() && is_body
    }

    /// Returns whether the surface may reflect an image. A texture multiplies the roughness factor, so it can only make
    /// a surface smoother.
    pub(crate) fn may_mirror(&self) -> bool {
        match &self.model {
            Model::MetallicRoughness(model) => {
                // Inputs whose textures may make the surface smoother
                let smoother = [MaterialInput::MetallicRoughness, MaterialInput::Roughness];
                // A smooth coat mirrors over any base
                let has_smooth_coat = self.coated().is_some_and(|coat| {
                    coat.roughness <= MIRROR_ROUGHNESS
                        || self.layer(MaterialInput::ClearcoatRoughness).is_some()
                });
                model.roughness <= MIRROR_ROUGHNESS
                    || has_smooth_coat
                    || smoother.into_iter().any(|p| self.layer(p).is_some())
            }
            Model::Phong(phong) => phong.reflection != [0.0; 3],
            Model::Unlit => false,
        }
    }

    /// Returns whether reflections in the surface may show shapes, sharp or blurred.
    fn may_show_reflections(&self) -> bool {
        // Metal reflects all light, so that it shows shapes at a larger roughness
        let is_glossy = match &self.model {
            Model::MetallicRoughness(model) if model.metallic > 0.0 => model.roughness <= GLOSSY_METAL,
            Model::MetallicRoughness(model) => model.roughness <= GLOSSY_DIELECTRIC,
            Model::Phong(_) | Model::Unlit => false,
        };
        is_glossy || self.may_mirror()
    }

    /// Returns the index of refraction at `wavelength` nanometres.
    pub fn ior(&self, wavelength: f64) -> f64 {
        self.interior
            .map_or(DEFAULT_IOR, |inside| inside.ior.ior(wavelength))
    }
}
