//! Keys of a material in scene files: one serde type for the three surface models.

use schemars::JsonSchema;
use serde::Deserialize;

use super::material_layer::{AnisotropyForm, ClearcoatForm, IridescenceForm, SheenForm};
use super::medium::{CauchyForm, Glass, SellmeierForm};
use super::scattering::SubsurfaceForm;
use super::value::{Color, Located, NoValue, Param, Rgba, Textured};
use crate::optics::Conductor;

/// Description of a surface. Every parameter that may have a texture is a value, or `{ texture = "NAME", value = ...
/// }`, which multiplies the two.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MaterialForm {
    /// Surface model: the illumination model of Phong and Whitted (`lecture`), glTF's metallic-roughness, or unlit.
    #[serde(default)]
    pub(super) model: ModelName,
    /// A metal of known reflectance: sets the colour of the reflection and makes the surface a mirror; other keys
    /// override it.
    pub(super) metal: Option<Metal>,
    /// A medium of known index of refraction: makes the surface clear and smooth; other keys override it.
    pub(super) glass: Option<Glass>,
    /// Colour of the diffuse and ambient light of either model, of the reflection of a metal, and of transmitted light;
    /// and coverage.
    pub(super) base_color: Option<Param<Rgba>>,
    /// Emitted radiance; may exceed 1.
    pub(super) emission: Option<Param<Color>>,
    /// Interpretation of the coverage of the base colour.
    #[serde(default)]
    pub(super) alpha: AlphaName,
    /// Coverage from which a surface with `alpha = "mask"` exists.
    #[schemars(extend("default" = ALPHA_CUTOFF))]
    pub(super) alpha_cutoff: Option<f32>,
    /// Ambient coefficient ra of the model `lecture`.
    pub(super) ambient: Option<Color>,
    /// Diffuse coefficient rd of the model `lecture`.
    pub(super) diffuse: Option<Color>,
    /// Specular coefficient rsp of the model `lecture`; with metallic-roughness the strength of a dielectric's
    /// reflection, one number.
    pub(super) specular: Option<Param<Color>>,
    /// Exponent f of the highlight of the model `lecture`.
    pub(super) exponent: Option<f32>,
    /// Coefficient kr of the reflected ray in the model `lecture`.
    pub(super) reflection: Option<Param<Color>>,
    /// Coefficient kt of the transmitted ray in the model `lecture`; with metallic-roughness the fraction of the light
    /// that is not reflected which is transmitted, one number.
    pub(super) transmission: Option<Param<Color>>,
    /// Division of the light between the reflected and the transmitted ray of the model `lecture` by Fresnel's
    /// equations.
    pub(super) fresnel: Option<bool>,
    /// Metalness: 0 for a dielectric, 1 for a metal.
    #[schemars(extend("default" = METALLIC))]
    pub(super) metallic: Option<Param<f32>>,
    /// Roughness: 0 for a mirror, 1 for chalk.
    #[schemars(extend("default" = ROUGHNESS))]
    pub(super) roughness: Option<Param<f32>>,
    /// Rays that each camera ray spawns into the lobe of a rough surface, 0 to 256, for blurred reflections and frosted
    /// glass; other rays spawn one. With 0 a surface up to a roughness of 0.1 is a mirror, a rougher one reflects only
    /// lights, and any refracts sharply.
    #[schemars(extend("default" = 0))]
    pub(super) rough_rays: Option<u32>,
    /// Roughness in green and metalness in blue of one texture, as glTF packs them.
    pub(super) metallic_roughness: Option<Textured<NoValue>>,
    /// Colour of a dielectric's reflection.
    pub(super) specular_color: Option<Param<Color>>,
    /// Fraction of the ambient light that arrives, in red.
    pub(super) occlusion: Option<Textured<NoValue>>,
    /// A normal map, in tangent space.
    pub(super) normal: Option<Textured<NoValue>>,
    /// A height map, in red; `strength` is the height of white in metres.
    pub(super) bump: Option<Textured<NoValue>>,
    /// Index of refraction at the d line.
    pub(super) ior: Option<f64>,
    /// Speed of light in the medium as a fraction of that in vacuum; an alternative to `ior`.
    pub(super) speed: Option<f64>,
    /// Abbe number, which with `ior` or `speed` determines the dispersion.
    pub(super) abbe: Option<f64>,
    /// Index of refraction by Sellmeier's equation.
    pub(super) sellmeier: Option<SellmeierForm>,
    /// Index of refraction by Cauchy's equation.
    pub(super) cauchy: Option<CauchyForm>,
    /// Absorption coefficients per metre, by Beer and Lambert's law.
    pub(super) absorption: Option<Color>,
    /// Colour of white light after `attenuation_distance`.
    pub(super) attenuation_color: Option<Color>,
    /// Distance in metres after which white light has the colour `attenuation_color`.
    pub(super) attenuation_distance: Option<f64>,
    /// Priority of the medium: where interiors overlap, that of the highest priority is effective.
    pub(super) priority: Option<i32>,
    /// Treatment of the surface as a wall without an interior, with all reflections between its two faces.
    pub(super) thin: Option<bool>,
    /// Subsurface scattering: diffuse light that enters, is scattered inside and leaves elsewhere, as in milk, marble
    /// and wax; the base colour tints it.
    pub(super) subsurface: Option<Located<SubsurfaceForm>>,
    /// Fraction of the diffuse light that leaves on the other side of a thin surface such as a leaf, 0 to 1.
    pub(super) translucency: Option<Located<f32>>,
    /// Colour of the light that leaves on the other side; the base colour if absent.
    pub(super) translucency_color: Option<Located<Color>>,
    /// A transparent layer of its own roughness over all else, such as lacquer.
    pub(super) clearcoat: Option<ClearcoatForm>,
    /// Light that the fibres of cloth scatter.
    pub(super) sheen: Option<SheenForm>,
    /// A lobe that is wider along one direction, as of brushed metal.
    pub(super) anisotropy: Option<AnisotropyForm>,
    /// A thin film whose reflections interfere, as of soap bubbles and oil.
    pub(super) iridescence: Option<IridescenceForm>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum ModelName {
    #[default]
    MetallicRoughness,
    #[serde(rename = "lecture")]
    Phong,
    Unlit,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum AlphaName {
    #[default]
    Opaque,
    Mask,
    Blend,
}

#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Metal {
    Gold,
    Silver,
    Copper,
    Aluminium,
}

/// Default metalness: an author who gives a colour usually means paint.
pub(super) const METALLIC: f32 = 0.0;
/// Default roughness, that of chalk.
pub(super) const ROUGHNESS: f32 = 1.0;
/// Default threshold of a mask; glTF's.
pub(super) const ALPHA_CUTOFF: f32 = 0.5;

impl Metal {
    /// Returns the reflectance at normal incidence in air, linear RGB.
    pub(super) fn reflectance(self) -> [f32; 3] {
        let metal = match self {
            Metal::Gold => Conductor::GOLD,
            Metal::Silver => Conductor::SILVER,
            Metal::Copper => Conductor::COPPER,
            Metal::Aluminium => Conductor::ALUMINIUM,
        };
        metal.reflectance(1.0, 1.0).map(|r| r as f32)
    }
}
