//! Conversion of materials of scene files by surface model; keys that a model does not have are rejected.

use super::material_form::{ALPHA_CUTOFF, AlphaName, METALLIC, MaterialForm, ModelName, ROUGHNESS};
use super::value::{Color, NoValue, Param, Textured};
use crate::scene::{
    AlphaMode, MAX_ROUGH_RAYS, Material, MaterialInput, MetallicRoughness, Model, Phong, UvTransform,
};

/// A texture on a material input, by the texture's name.
pub(super) struct LayerForm<'f> {
    pub(super) parameter: MaterialInput,
    pub(super) texture: &'f super::value::Located<String>,
    pub(super) tex_coord: u32,
    pub(super) transform: UvTransform,
    pub(super) strength: f32,
}

impl MaterialForm {
    /// Returns the material without its textures.
    pub(super) fn material(&self, name: &str) -> Result<Material, String> {
        self.check_keys()?;
        if self.metal.is_some() && self.glass.is_some() {
            return Err("is both a `metal` and a `glass`: give one".into());
        }
        // Choose the model; a metal gives its colour to the base colour
        let model = match self.model {
            ModelName::MetallicRoughness => Model::MetallicRoughness(self.metallic_roughness()?),
            ModelName::Phong => Model::Phong(self.phong()),
            ModelName::Unlit => Model::Unlit,
        };
        let metal_color = match (self.metal, self.model) {
            (Some(metal), ModelName::MetallicRoughness) => {
                let [r, g, b] = metal.reflectance();
                [r, g, b, 1.0]
            }
            _ => [1.0; 4],
        };
        // Fill in the inputs, then the interior, which depends on the transmission
        let mut material = Material {
            name: name.to_owned(),
            model,
            base_color: self.base_color.as_ref().map_or(metal_color, |p| p.value().0),
            emission: self.emission.as_ref().map_or([0.0; 3], |p| p.value().0),
            alpha: self.alpha()?,
            ..Material::default()
        };
        material.interior = self.interior(material.transmits())?;
        self.add_layers(&mut material);
        Ok(material)
    }

    fn alpha(&self) -> Result<AlphaMode, String> {
        match (self.alpha, self.alpha_cutoff) {
            (AlphaName::Mask, cutoff) => Ok(AlphaMode::Mask(cutoff.unwrap_or(ALPHA_CUTOFF))),
            (_, Some(_)) => Err("has an `alpha_cutoff` without a mask: add `alpha = \"mask\"`".into()),
            (AlphaName::Opaque, None) => Ok(AlphaMode::Opaque),
            (AlphaName::Blend, None) => Ok(AlphaMode::Blend),
        }
    }

    fn phong(&self) -> Phong {
        let plain = Phong::DEFAULT;
        // Presets for metals and glasses have no ambient and diffuse light of their own
        let preset = match (self.metal, self.glass) {
            (Some(metal), _) => Phong {
                ambient: [0.0; 3],
                diffuse: [0.0; 3],
                reflection: metal.reflectance(),
                ..plain
            },
            (None, Some(_)) => Phong {
                ambient: [0.0; 3],
                diffuse: [0.0; 3],
                reflection: [1.0; 3],
                transmission: [1.0; 3],
                fresnel: true,
                ..plain
            },
            (None, None) => plain,
        };
        // Given keys override the preset
        let color = |param: &Option<Param<Color>>, usual| param.as_ref().map_or(usual, |p| p.value().0);
        Phong {
            ambient: self.ambient.map_or(preset.ambient, |c| c.0),
            diffuse: self.diffuse.map_or(preset.diffuse, |c| c.0),
            specular: color(&self.specular, preset.specular),
            exponent: self.exponent.unwrap_or(preset.exponent),
            reflection: color(&self.reflection, preset.reflection),
            transmission: color(&self.transmission, preset.transmission),
            fresnel: self.fresnel.unwrap_or(preset.fresnel),
        }
    }

    fn metallic_roughness(&self) -> Result<MetallicRoughness, String> {
        let usual = MetallicRoughness::DEFAULT;
        let number = |param: &Option<Param<Color>>, key: &str, usual: f32| match param {
            None => Ok(usual),
            Some(param) => param.value().grey().ok_or_else(|| {
                format!("its `{key}` is a colour, but metallic-roughness has a number there: give one")
            }),
        };
        // A texture of both needs factors of 1 to have an effect.
        let (metallic, roughness) = match (&self.metallic_roughness, self.metal, self.glass) {
            (Some(_), ..) => (1.0, 1.0),
            (None, Some(_), _) => (1.0, 0.0),
            (None, None, Some(_)) => (0.0, 0.0),
            (None, None, None) => (METALLIC, ROUGHNESS),
        };
        // Glass transmits all light that it does not reflect
        let clear = if self.glass.is_some() {
            1.0
        } else {
            usual.transmission
        };
        Ok(MetallicRoughness {
            metallic: self.metallic.as_ref().map_or(metallic, Param::value),
            roughness: self.roughness.as_ref().map_or(roughness, Param::value),
            specular: number(&self.specular, "specular", usual.specular)?,
            specular_color: self
                .specular_color
                .as_ref()
                .map_or(usual.specular_color, |p| p.value().0),
            transmission: number(&self.transmission, "transmission", clear)?,
            rough_rays: self.rough_rays()?,
        })
    }

    fn rough_rays(&self) -> Result<u32, String> {
        match self.rough_rays.unwrap_or(0) {
            rays @ 0..=MAX_ROUGH_RAYS => Ok(rays),
            rays => Err(format!(
                "its `rough_rays` is {rays}: give 0 to {MAX_ROUGH_RAYS}, and more samples a pixel"
            )),
        }
    }

    /// Rejects keys that the model does not have.
    fn check_keys(&self) -> Result<(), String> {
        use ModelName::{MetallicRoughness, Phong};
        // List each key with the models that have it
        let keys: [(bool, &str, &[ModelName]); 19] = [
            (self.ambient.is_some(), "ambient", &[Phong]),
            (self.diffuse.is_some(), "diffuse", &[Phong]),
            (self.exponent.is_some(), "exponent", &[Phong]),
            (self.reflection.is_some(), "reflection", &[Phong]),
            (self.fresnel.is_some(), "fresnel", &[Phong]),
            (self.specular.is_some(), "specular", &[Phong, MetallicRoughness]),
            (
                self.transmission.is_some(),
                "transmission",
                &[Phong, MetallicRoughness],
            ),
            (self.metal.is_some(), "metal", &[Phong, MetallicRoughness]),
            (self.glass.is_some(), "glass", &[Phong, MetallicRoughness]),
            (self.metallic.is_some(), "metallic", &[MetallicRoughness]),
            (self.roughness.is_some(), "roughness", &[MetallicRoughness]),
            (self.rough_rays.is_some(), "rough_rays", &[MetallicRoughness]),
            (
                self.metallic_roughness.is_some(),
                "metallic_roughness",
                &[MetallicRoughness],
            ),
            (
                self.specular_color.is_some(),
                "specular_color",
                &[MetallicRoughness],
            ),
            (self.occlusion.is_some(), "occlusion", &[Phong, MetallicRoughness]),
            (self.clearcoat.is_some(), "clearcoat", &[MetallicRoughness]),
            (self.sheen.is_some(), "sheen", &[MetallicRoughness]),
            (self.anisotropy.is_some(), "anisotropy", &[MetallicRoughness]),
            (self.iridescence.is_some(), "iridescence", &[MetallicRoughness]),
        ];
        for (given, key, models) in keys {
            if given && !models.contains(&self.model) {
                let model = match self.model {
                    MetallicRoughness => "metallic-roughness",
                    Phong => "lecture",
                    ModelName::Unlit => "unlit",
                };
                return Err(format!(
                    "the model \"{model}\" has no `{key}`: remove it or give another `model`"
                ));
            }
        }
        Ok(())
    }

    /// Returns the textures of all material inputs.
    pub(super) fn layers(&self) -> Vec<LayerForm<'_>> {
        // `specular` is a colour in one model and a strength in the other
        let specular = match self.model {
            ModelName::Phong => MaterialInput::SpecularColor,
            _ => MaterialInput::Specular,
        };
        [
            of_param(&self.base_color, MaterialInput::BaseColor),
            of_param(&self.emission, MaterialInput::Emission),
            of_param(&self.metallic, MaterialInput::Metallic),
            of_param(&self.roughness, MaterialInput::Roughness),
            of_param(&self.specular, specular),
            of_param(&self.specular_color, MaterialInput::SpecularColor),
            of_param(&self.reflection, MaterialInput::Reflection),
            of_param(&self.transmission, MaterialInput::Transmission),
            of_map(&self.metallic_roughness, MaterialInput::MetallicRoughness),
            of_map(&self.occlusion, MaterialInput::Occlusion),
            of_map(&self.normal, MaterialInput::Normal),
            of_map(&self.bump, MaterialInput::Bump),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

fn of_param<T>(param: &Option<Param<T>>, parameter: MaterialInput) -> Option<LayerForm<'_>> {
    match param {
        Some(Param::Textured(textured)) => Some(layer(textured, parameter)),
        _ => None,
    }
}

fn of_map(map: &Option<Textured<NoValue>>, parameter: MaterialInput) -> Option<LayerForm<'_>> {
    map.as_ref().map(|textured| layer(textured, parameter))
}

fn layer<T>(textured: &Textured<T>, parameter: MaterialInput) -> LayerForm<'_> {
    // Scale first, then rotate, then add the offset
    let [scale_u, scale_v] = textured.scale.map_or([1.0; 2], |scale| scale.0.map(|s| s as f32));
    let (sin, cos) = textured.rotate.to_radians().sin_cos();
    LayerForm {
        parameter,
        texture: &textured.texture,
        tex_coord: textured.set,
        transform: UvTransform {
            matrix: [[cos * scale_u, -sin * scale_v], [sin * scale_u, cos * scale_v]],
            offset: textured.offset,
        },
        strength: textured.strength,
    }
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;
    use crate::optics::{Dispersion, LINE_D};

    fn material(text: &str) -> Result<Material, String> {
        from_text::<MaterialForm>(text)
            .map_err(|e| e.message().to_owned())?
            .material("test")
    }

    #[test]
    fn empty_material_is_rough_and_white() {
        let chalk = Material {
            name: "test".into(),
            ..Material::metallic_roughness([1.0; 3], METALLIC, ROUGHNESS)
        };
        assert_eq!(material("").unwrap(), chalk);
    }

    #[test]
    fn refractive_index_may_be_given_as_speed() {
        let glass = material("model = 'lecture'\ntransmission = 0.8\nspeed = 0.55").unwrap();
        assert_eq!(glass.interior.unwrap().ior, Dispersion::Constant(1.0 / 0.55));
        let default = material("transmission = 1").unwrap();
        assert_eq!(default.ior(LINE_D), crate::scene::DEFAULT_IOR);
    }

    #[test]
    fn explicit_values_override_presets() {
        // A metal is smooth unless it has a roughness
        let gold = material("metal = 'gold'\nroughness = 0.3").unwrap();
        let Model::MetallicRoughness(model) = gold.model else {
            unreachable!()
        };
        assert_eq!((model.metallic, model.roughness), (1.0, 0.3));
        assert!(gold.base_color[0] > gold.base_color[2]);
        // A glass reflects and transmits everything unless it has coefficients
        let water = material("model = 'lecture'\nglass = 'water'\nreflection = 0.5").unwrap();
        let Model::Phong(phong) = water.model else {
            unreachable!()
        };
        assert_eq!((phong.reflection, phong.transmission), ([0.5; 3], [1.0; 3]));
        assert!((water.ior(LINE_D) - 1.333).abs() < 1e-3);
    }

    #[test]
    fn conflicting_keys_are_rejected() {
        for (bad, words) in [
            ("exponent = 3", "has no `exponent`"),
            ("model = 'unlit'\nroughness = 1", "has no `roughness`"),
            ("model = 'lecture'\nrough_rays = 4", "has no `rough_rays`"),
            (
                "roughness = 0.3\nrough_rays = 257",
                "its `rough_rays` is 257: give 0 to 256",
            ),
            ("specular = [1, 0, 0]", "has a number there"),
            ("glass = 'water'\nior = 1.3", "both `glass` and `ior`"),
            ("glass = 'water'\nmetal = 'gold'", "both a `metal`"),
            ("abbe = 50", "without `ior`"),
            ("ior = 1.5\nabbe = 0", "its `abbe` is 0"),
            ("speed = 1.5", "its `speed` is 1.5"),
            ("attenuation_color = 0.5", "without `attenuation_distance`"),
            ("attenuation_color = 2\nattenuation_distance = 1", "over 1"),
            ("absorption = 1\nattenuation_distance = 1", "both"),
            ("alpha_cutoff = 0.5", "without a mask"),
            ("sellmeier = { b = [1], c = [] }", "as many"),
            ("normal = { texture = 'x', value = 1 }", "a value besides"),
        ] {
            let error = material(bad).unwrap_err();
            assert!(error.contains(words), "{bad}: {error}");
        }
    }

    #[test]
    fn texture_is_rotated_after_it_is_scaled() {
        let form: MaterialForm =
            from_text("roughness = { texture = 'x', scale = [2, 3], rotate = 90, offset = [0.5, 0] }")
                .unwrap();
        let [u, v] = form.layers()[0].transform.apply([1.0, 1.0]);
        // (1, 1) -> (2, 3) -> (-3, 2) -> (-2.5, 2).
        assert!((u + 2.5).abs() < 1e-6 && (v - 2.0).abs() < 1e-6, "{u} {v}");
    }
}
