//! Materials: what surfaces are made of, by one of two lighting models, and what is inside them.
//!
//! A parameter is a factor times whatever textures are layered on it.

use super::texture::MaterialInput;
use super::{Scene, TextureBinding};
use crate::optics::subsurface::Scattering;
use crate::optics::{Absorption, DiffuseTransmission, Dispersion};

/// A surface description.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// What messages call it.
    pub name: String,
    /// How it answers light.
    pub model: Model,
    /// Linear RGBA: the colour of the diffuse and ambient light of either model, of a metal, and of what is let
    /// through; and the coverage.
    pub base_color: [f32; 4],
    /// Emitted radiance, linear RGB.
    pub emission: [f32; 3],
    /// What the coverage means.
    pub alpha: AlphaMode,
    /// What textures do to the parameters; each parameter at most once.
    pub layers: Vec<TextureBinding>,
    /// What light meets that enters, where any enters.
    pub interior: Option<Interior>,
    /// What scatters beneath the surface, where the diffuse light comes from there: per unit of length of the scene. Of
    /// glTF's model, and not with transmission or translucency. The base colour tints what leaves.
    pub subsurface: Option<Scattering>,
    /// Of a thin sheet of glTF's model, the diffuse light that leaves on its other side.
    pub translucency: Option<Translucency>,
}

/// How a thin sheet shares its diffuse light with its other side (`KHR_materials_diffuse_transmission`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Translucency {
    /// How much of it leaves there, 0 to 1.
    pub factor: f32,
    /// In what colour, linear RGB, 0 to 1.
    pub color: [f32; 3],
}

impl Translucency {
    /// The sheet under a base colour of white.
    pub fn leaf(&self) -> DiffuseTransmission {
        DiffuseTransmission::from_diffuse_transmission(
            [1.0; 3],
            self.factor.into(),
            self.color.map(f64::from),
        )
    }
}

/// A lighting model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Model {
    /// glTF's metallic-roughness model.
    MetallicRoughness(MetallicRoughness),
    /// The lecture's: `I = Ia ra + sum of Il (rd (s.m) + rsp (r.v)^f) + kr I(reflected) + kt I(transmitted)`.
    Lecture(Lecture),
    /// The base colour, whatever the light (`KHR_materials_unlit`).
    Unlit,
}

/// glTF 2.0, 3.9.2, with `KHR_materials_specular` and `KHR_materials_transmission`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetallicRoughness {
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 a mirror, 1 chalk.
    pub roughness: f32,
    /// Strength of a dielectric's reflection, 0 to 1.
    pub specular: f32,
    /// Its colour at normal incidence, linear RGB.
    pub specular_color: [f32; 3],
    /// How much of what is not reflected goes through rather than being scattered, 0 to 1.
    pub transmission: f32,
    /// Rays that the lobe of a rough surface is looked into by where the eye sees it, up to [`MAX_ROUGH_RAYS`]; one
    /// where other rays meet it. With 0 it reflects as a mirror up to [`MIRROR_ROUGHNESS`] and only lights beyond, and
    /// refracts as a smooth one.
    pub rough_rays: u32,
}

impl MetallicRoughness {
    /// glTF's defaults: metallic 1, roughness 1.
    pub const DEFAULT: MetallicRoughness = MetallicRoughness {
        metallic: 1.0,
        roughness: 1.0,
        specular: 1.0,
        specular_color: [1.0; 3],
        transmission: 0.0,
        rough_rays: 0,
    };
}

/// The lecture's reflection coefficients. The base colour multiplies `ambient` and `diffuse`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lecture {
    /// ra, linear RGB.
    pub ambient: [f32; 3],
    /// rd, linear RGB.
    pub diffuse: [f32; 3],
    /// rsp, linear RGB.
    pub specular: [f32; 3],
    /// f, the exponent of the highlight; at least 0.
    pub exponent: f32,
    /// kr, the share of the reflected ray, linear RGB.
    pub reflection: [f32; 3],
    /// kt, the share of the transmitted ray, linear RGB.
    pub transmission: [f32; 3],
    /// Whether Fresnel's equations divide the light between the two rays, on top of kr and kt.
    pub fresnel: bool,
}

impl Lecture {
    /// A chalky surface: ambient and diffuse 1, nothing else.
    pub const DEFAULT: Lecture = Lecture {
        ambient: [1.0; 3],
        diffuse: [1.0; 3],
        specular: [0.0; 3],
        exponent: 1.0,
        reflection: [0.0; 3],
        transmission: [0.0; 3],
        fresnel: false,
    };
}

/// What the fourth channel of the base colour means (glTF 2.0, 3.9.4).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Nothing.
    #[default]
    Opaque,
    /// The surface is there where the coverage is at least this.
    Mask(f32),
    /// The surface covers that part of what is behind it.
    Blend,
}

impl AlphaMode {
    /// The part of a surface that is there, by the fourth channel of its base colour.
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

/// What is inside a surface, for light that goes through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interior {
    /// Index of refraction.
    pub ior: Dispersion,
    /// What a metre of it swallows.
    pub absorption: Absorption,
    /// Where bodies overlap, the one of the highest priority is there (Schmidt and Budge, 2002).
    pub priority: i32,
    /// Whether the surface is a wall without an inside: light passes straight on.
    pub is_thin: bool,
}

impl Default for Material {
    /// glTF's default material: white, metallic 1, roughness 1.
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
        }
    }
}

/// Surfaces up to this perceptual roughness reflect an image: their lobe's width (alpha = 0.01, about half a degree)
/// is that of a few pixels. Rougher ones need many rays for one reflection, which they send if they are told how many.
pub const MIRROR_ROUGHNESS: f32 = 0.1;

/// Most rays into one lobe. Samples of a pixel serve as well beyond.
pub const MAX_ROUGH_RAYS: u32 = 256;

/// Index of refraction where a material states none: glTF's, that of window glass.
pub const DEFAULT_IOR: f64 = 1.5;

impl Scene {
    /// Has every material of the metallic-roughness model send so many rays into its lobe.
    pub fn set_rough_rays(&mut self, rays: u32) {
        for material in &mut self.materials {
            if let Model::MetallicRoughness(model) = &mut material.model {
                model.rough_rays = rays;
            }
        }
    }
}

impl Material {
    /// Whether a texture on `parameter` that is taken by `strength` can change anything: nothing times zero stays zero.
    pub fn heeds(&self, parameter: MaterialInput, strength: f32) -> bool {
        let [r, g, b, a] = self.base_color;
        match (parameter, &self.model) {
            (MaterialInput::BaseColor, _) => {
                [r, g, b] != [0.0; 3] || (a != 0.0 && self.alpha != AlphaMode::Opaque)
            }
            (MaterialInput::Emission, _) => self.emission != [0.0; 3],
            (MaterialInput::Normal | MaterialInput::Bump | MaterialInput::Occlusion, _) => strength != 0.0,
            (parameter, Model::MetallicRoughness(model)) => match parameter {
                MaterialInput::Roughness => model.roughness != 0.0,
                MaterialInput::Metallic => model.metallic != 0.0,
                MaterialInput::MetallicRoughness => model.roughness != 0.0 || model.metallic != 0.0,
                MaterialInput::Specular => model.specular != 0.0,
                MaterialInput::SpecularColor => model.specular_color != [0.0; 3],
                MaterialInput::Transmission => model.transmission != 0.0,
                _ => true,
            },
            (MaterialInput::SpecularColor, Model::Lecture(lecture)) => lecture.specular != [0.0; 3],
            (MaterialInput::Reflection, Model::Lecture(lecture)) => lecture.reflection != [0.0; 3],
            (MaterialInput::Transmission, Model::Lecture(lecture)) => lecture.transmission != [0.0; 3],
            _ => true,
        }
    }

    /// A material of the metallic-roughness model without textures.
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

    /// Whether it differs from point to point.
    pub fn is_textured(&self) -> bool {
        !self.layers.is_empty()
    }

    /// The texture on a parameter, if there is one.
    pub fn layer(&self, parameter: MaterialInput) -> Option<&TextureBinding> {
        self.layers.iter().find(|layer| layer.parameter == parameter)
    }

    /// Whether light may pass through the surface itself. Coverage is another matter.
    pub fn transmits(&self) -> bool {
        match &self.model {
            Model::MetallicRoughness(model) => model.transmission > 0.0,
            Model::Lecture(lecture) => lecture.transmission != [0.0; 3],
            Model::Unlit => false,
        }
    }

    /// Rays that are sent into the lobes of its rough places where the eye sees them; 0 if it has none or sends none.
    pub fn rough_rays(&self) -> u32 {
        match &self.model {
            // A texture multiplies the factor: what is smooth stays smooth.
            Model::MetallicRoughness(model) if model.roughness > 0.0 => model.rough_rays,
            _ => 0,
        }
    }

    /// What scatters light beneath the surface, if the model has that.
    pub fn scatters(&self) -> Option<&Scattering> {
        let has_inside = matches!(self.model, Model::MetallicRoughness(_));
        self.subsurface.as_ref().filter(|_| has_inside)
    }

    /// How the surface shares its diffuse light with its other side, if it does.
    pub fn translucent(&self) -> Option<&Translucency> {
        let has_two_sides = matches!(self.model, Model::MetallicRoughness(_));
        self.translucency
            .as_ref()
            .filter(|sheet| has_two_sides && sheet.factor > 0.0)
    }

    /// Whether it may reflect an image. A texture multiplies the factor, so it can only make a surface smoother.
    pub fn may_mirror(&self) -> bool {
        match &self.model {
            Model::MetallicRoughness(model) => {
                let smoother = [MaterialInput::MetallicRoughness, MaterialInput::Roughness];
                model.roughness <= MIRROR_ROUGHNESS || smoother.into_iter().any(|p| self.layer(p).is_some())
            }
            Model::Lecture(lecture) => lecture.reflection != [0.0; 3],
            Model::Unlit => false,
        }
    }

    /// Index of refraction at `wavelength` nanometres.
    pub fn ior(&self, wavelength: f64) -> f64 {
        self.interior
            .map_or(DEFAULT_IOR, |inside| inside.ior.ior(wavelength))
    }
}
