//! Description of a material: part of `whit info`.

use std::fmt;

use serde::Serialize;

use crate::optics::LINE_D;
use crate::optics::subsurface::Dipole;
use crate::scene::{Clearcoat, Iridescence, Material, Model, Sheen};

/// Description of a material.
#[derive(Clone, Debug, Serialize)]
pub struct MaterialInfo {
    /// Name from the file, or a generated one.
    pub name: String,
    /// Shading model: `metallic-roughness`, `lecture` or `unlit`.
    pub model: &'static str,
    /// Base colour and opacity, linear RGBA.
    pub base_color: [f32; 4],
    /// Values of the model that are not zero, in words.
    pub values: String,
    /// Names of the parameters that have a texture.
    pub textured: Vec<String>,
    /// Index of refraction at the d line, for materials that light can enter.
    pub ior: Option<f64>,
    /// Abbe number of the interior; null without dispersion.
    pub abbe: Option<f64>,
    /// Absorption coefficient per metre, for materials that light can enter.
    pub absorption: Option<[f64; 3]>,
}

impl MaterialInfo {
    pub(super) fn of(material: &Material) -> MaterialInfo {
        // Describe the parameters of the shading model
        let (model, values) = match &material.model {
            Model::MetallicRoughness(m) => (
                "metallic-roughness",
                format!(
                    "metallic {}, roughness {}{}, transmission {}{}{}",
                    m.metallic,
                    m.roughness,
                    rough_rays(material),
                    m.transmission,
                    scattering(material),
                    layers(material)
                ),
            ),
            Model::Phong(l) => (
                "lecture",
                format!(
                    "ra {}, rd {}, rsp {}, f {}, kr {}, kt {}",
                    rgb(l.ambient),
                    rgb(l.diffuse),
                    rgb(l.specular),
                    l.exponent,
                    rgb(l.reflection),
                    rgb(l.transmission)
                ),
            ),
            Model::Unlit => ("unlit", String::new()),
        };
        // Only a material with an interior has refraction and absorption
        let interior = material.interior;
        MaterialInfo {
            name: material.name.clone(),
            model,
            base_color: material.base_color,
            values,
            // Name the inputs with a texture
            textured: material
                .layers
                .iter()
                .map(|l| format!("{:?}", l.parameter))
                .collect(),
            ior: interior.map(|inside| inside.ior.ior(LINE_D)),
            abbe: interior
                .map(|inside| inside.ior.abbe_number())
                .filter(|abbe| abbe.is_finite()),
            absorption: interior.map(|inside| inside.absorption.sigma_a),
        }
    }
}

/// Returns the description of subsurface scattering or translucency; empty without either.
fn scattering(material: &Material) -> String {
    if let Some(Ok(dipole)) = material.scatters().map(Dipole::new) {
        let [_, path, _] = dipole.mean_free_path();
        return format!(", subsurface scattering, mean free path {path:.3e}");
    }
    let surface = material.translucent();
    surface.map_or_else(String::new, |surface| {
        format!(", translucency {}", surface.factor)
    })
}

/// Returns the description of layers and lobes of glTF's extensions; empty if there are none.
fn layers(material: &Material) -> String {
    let mut parts = Vec::new();
    // List the layers from the top
    if let Some(coat) = material.coated() {
        let Clearcoat { factor, roughness } = coat;
        parts.push(format!(", clear coat {factor} of roughness {roughness}"));
    }
    if let Some(Sheen { color, roughness }) = material.sheening() {
        parts.push(format!(", sheen {} of roughness {roughness}", rgb(*color)));
    }
    // List the lobes of the base
    if let Some(lobe) = material.anisotropic() {
        parts.push(format!(", anisotropy {}", lobe.strength));
    }
    if let Some(film) = material.iridescent() {
        let [thin, thick] = film.thickness;
        let Iridescence { factor, ior, .. } = film;
        parts.push(format!(
            ", iridescence {factor} of index {ior} and {thin} to {thick} nm"
        ));
    }
    parts.concat()
}

/// Returns the number of rays into the rough lobe in words; empty if there are none.
fn rough_rays(material: &Material) -> String {
    match material.rough_rays() {
        0 => String::new(),
        rays => format!(" by {rays} rays"),
    }
}

/// Formats a colour as one number if it is grey.
fn rgb([r, g, b]: [f32; 3]) -> String {
    if r == g && g == b {
        r.to_string()
    } else {
        format!("({r} {g} {b})")
    }
}

impl fmt::Display for MaterialInfo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [r, g, b, _] = self.base_color;
        write!(f, "`{}`, {}, colour {}", self.name, self.model, rgb([r, g, b]))?;
        if !self.values.is_empty() {
            write!(f, ", {}", self.values)?;
        }
        if !self.textured.is_empty() {
            write!(f, ", textures on {}", self.textured.join(", "))?;
        }
        if let Some(ior) = self.ior {
            write!(f, ", interior n = {ior:.4}")?;
        }
        if let Some(abbe) = self.abbe {
            write!(f, " (Abbe {abbe:.1})")?;
        }
        match self.absorption {
            Some(sigma_a) if sigma_a != [0.0; 3] => write!(f, ", absorbs {sigma_a:?} per metre"),
            _ => Ok(()),
        }
    }
}
