//! Layers and lobes of glTF's material extensions: clear coat, sheen, anisotropy and iridescence.

use super::{Material, Model};

/// Clear coat: a transparent layer of its own roughness over all else (`KHR_materials_clearcoat`). It reflects as a
/// dielectric of index 1.5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearcoat {
    /// Fraction of the surface that is coated, 0 to 1.
    pub factor: f32,
    /// Perceptual roughness of the coat, 0 to 1.
    pub roughness: f32,
}

/// Sheen: light scattered by the fibres of cloth, over the base and below a coat (`KHR_materials_sheen`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheen {
    /// Colour of the fibres, linear RGB, 0 to 1.
    pub color: [f32; 3],
    /// Perceptual roughness of the fibres, 0 to 1: 0 for a narrow rim of light.
    pub roughness: f32,
}

/// Anisotropy of the specular lobe, as of brushed metal (`KHR_materials_anisotropy`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anisotropy {
    /// Strength, 0 to 1: along the direction of anisotropy, alpha is raised from roughness² towards 1 by its square.
    pub strength: f32,
    /// Angle from the tangent to the direction of anisotropy, in radians, counter-clockwise.
    pub rotation: f32,
}

/// Iridescence: interference of light in a thin film on the base (`KHR_materials_iridescence`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iridescence {
    /// Weight of the film's reflectance in place of the base's, 0 to 1.
    pub factor: f32,
    /// Index of refraction of the film, at least 1.
    pub ior: f32,
    /// Thicknesses of the film in nanometres where a texture of it is 0 and where it is 1.
    pub thickness: [f32; 2],
}

impl Material {
    /// Returns the clear coat, if there is one and the model supports it.
    pub fn coated(&self) -> Option<&Clearcoat> {
        self.clearcoat
            .as_ref()
            .filter(|coat| coat.factor > 0.0 && self.has_layers())
    }

    /// Returns the sheen, if there is one and the model supports it.
    pub fn sheening(&self) -> Option<&Sheen> {
        self.sheen
            .as_ref()
            .filter(|sheen| sheen.color != [0.0; 3] && self.has_layers())
    }

    /// Returns the anisotropy, if there is any and the model supports it.
    pub fn anisotropic(&self) -> Option<&Anisotropy> {
        self.anisotropy
            .as_ref()
            .filter(|lobe| lobe.strength > 0.0 && self.has_layers())
    }

    /// Returns the iridescence, if there is any and the model supports it.
    pub fn iridescent(&self) -> Option<&Iridescence> {
        self.iridescence
            .as_ref()
            .filter(|film| film.factor > 0.0 && self.has_layers())
    }

    /// Returns whether the model supports layers: glTF's metallic-roughness model does.
    fn has_layers(&self) -> bool {
        matches!(self.model, Model::MetallicRoughness(_))
    }
}
