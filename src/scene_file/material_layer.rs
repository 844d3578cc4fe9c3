//! Keys of materials of scene files for layers and lobes: clear coat, sheen, anisotropy and iridescence.

use schemars::JsonSchema;
use serde::Deserialize;

use super::material_form::MaterialForm;
use super::value::Color;
use crate::scene::{Anisotropy, Clearcoat, Iridescence, Material, Sheen};

/// Index of refraction of a thin film; glTF's default.
const FILM_IOR: f32 = 1.3;

/// A transparent layer of its own roughness over all else, which reflects as a dielectric of index 1.5.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ClearcoatForm {
    /// Fraction of the surface that is coated, 0 to 1; 1 if absent.
    factor: Option<f32>,
    /// Roughness of the coat, 0 to 1; 0 if absent.
    roughness: Option<f32>,
}

/// Light that the fibres of cloth scatter.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SheenForm {
    /// Colour of the fibres.
    color: Color,
    /// Roughness of the fibres, 0 to 1; 0.5 if absent.
    roughness: Option<f32>,
}

/// A lobe that is wider along one direction, as of brushed metal.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AnisotropyForm {
    /// Strength, 0 to 1.
    strength: f32,
    /// Angle in degrees from the direction of growing u to the wider one, counter-clockwise; 0 if absent.
    rotation: Option<f32>,
}

/// A thin film whose reflections interfere, as of soap bubbles and oil.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct IridescenceForm {
    /// Thickness of the film in nanometres.
    thickness: f32,
    /// Index of refraction of the film; 1.3 if absent.
    ior: Option<f32>,
    /// Weight of the film, 0 to 1; 1 if absent.
    factor: Option<f32>,
}

impl MaterialForm {
    /// Adds the layers and lobes to `material`. Their ranges are checked with the material.
    pub(super) fn add_layers(&self, material: &mut Material) {
        material.clearcoat = self.clearcoat.map(|form| Clearcoat {
            factor: form.factor.unwrap_or(1.0),
            roughness: form.roughness.unwrap_or(0.0),
        });
        material.sheen = self.sheen.map(|form| Sheen {
            color: form.color.0,
            roughness: form.roughness.unwrap_or(0.5),
        });
        material.anisotropy = self.anisotropy.map(|form| Anisotropy {
            strength: form.strength,
            rotation: form.rotation.unwrap_or(0.0).to_radians(),
        });
        material.iridescence = self.iridescence.map(|form| Iridescence {
            factor: form.factor.unwrap_or(1.0),
            ior: form.ior.unwrap_or(FILM_IOR),
            thickness: [form.thickness; 2],
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_have_stated_factors_and_defaults() {
        let form: MaterialForm = toml::from_str(
            "clearcoat = { roughness = 0.25 }\nsheen = { color = [1, 0.5, 0] }\n\
             anisotropy = { strength = 0.5, rotation = 180 }\niridescence = { thickness = 400 }",
        )
        .unwrap();
        // Compare stated factors and defaults
        let material = form.material("paint").unwrap();
        let coat = Clearcoat {
            factor: 1.0,
            roughness: 0.25,
        };
        assert_eq!(material.clearcoat, Some(coat));
        let sheen = Sheen {
            color: [1.0, 0.5, 0.0],
            roughness: 0.5,
        };
        assert_eq!(material.sheen, Some(sheen));
        assert_eq!(material.anisotropic().unwrap().rotation, std::f32::consts::PI);
        assert_eq!(material.iridescent().unwrap().ior, FILM_IOR);
    }

    #[test]
    fn layers_of_other_models_are_rejected() {
        // A coat belongs to glTF's model alone
        let form: MaterialForm = toml::from_str("model = 'unlit'\nclearcoat = {}").unwrap();
        assert!(form.material("paint").unwrap_err().contains("has no `clearcoat`"));
    }
}
