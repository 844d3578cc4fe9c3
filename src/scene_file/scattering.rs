//! Subsurface scattering in scene files: a measured material or coefficients.

use schemars::JsonSchema;
use serde::Deserialize;

use super::fault::Diagnostic;
use super::forms::{forms, schema};
use super::value::{Color, Each, Located};
use crate::optics::subsurface::{Scattering, SubsurfacePreset};
use crate::scene::DEFAULT_IOR;

/// Default length of a millimetre in units of the scene: a scene is in metres.
const MILLIMETRE: f64 = 0.001;

/// Subsurface scattering: the name of a preset, or a table.
#[derive(Clone, Debug, Default)]
pub(super) struct SubsurfaceForm(SubsurfaceTable);

/// Subsurface scattering in one of three forms: a measured material; coefficients; or the diffuse reflectance of a
/// thick medium and the mean free path.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SubsurfaceTable {
    /// Name of a measured material.
    preset: Option<Located<String>>,
    /// Length of a millimetre, in which presets are measured, in units of the scene.
    #[schemars(extend("default" = MILLIMETRE))]
    scale: Option<Located<f64>>,
    /// Reduced scattering coefficients (1 - g) sigma_s, per unit of length.
    scattering: Option<Located<Color>>,
    /// Absorption coefficients, per unit of length.
    absorption: Option<Located<Color>>,
    /// Diffuse reflectance of a thick medium under uniform illumination.
    reflectance: Option<Located<Color>>,
    /// Mean free path of the light between two changes of its direction, for all colours or for red, green and blue.
    mean_free_path: Option<Located<Each<3>>>,
}

forms! {
    ['de] SubsurfaceForm, "the name of a measured material or a table";
    text name => Ok(SubsurfaceForm(SubsurfaceTable {
        preset: Some(Located::without_span(name.to_owned())),
        ..SubsurfaceTable::default()
    }));
    table table => SubsurfaceTable::deserialize(table).map(SubsurfaceForm);
}

schema!([] SubsurfaceForm, "Subsurface", generator => {
    "description": "A measured material by name, or a table.",
    "anyOf": [
        { "type": "string", "enum": SubsurfacePreset::ALL.map(|preset| preset.name) },
        generator.subschema_for::<SubsurfaceTable>(),
    ],
});

impl Located<SubsurfaceForm> {
    /// Returns the scattering coefficients, with the index of refraction `ior` if the material has one.
    pub(super) fn scattering(&self, ior: Option<f64>) -> Result<Scattering, Diagnostic> {
        let table = &self.0;
        let eta = ior.unwrap_or(DEFAULT_IOR);
        match (&table.preset, &table.scattering, &table.reflectance) {
            // A preset, in millimetres
            (Some(preset), None, None) => {
                let is_alone = table.absorption.is_none() && table.mean_free_path.is_none();
                if !is_alone {
                    return Err(self.fault("has a `preset` and coefficients of its own: give one"));
                }
                // Presets have coefficients per millimetre and an index of their own
                let found = SubsurfacePreset::named(preset).ok_or_else(|| self.unknown(preset))?;
                let scaled = found.scattering.scaled(self.millimetre()?);
                Ok(Scattering {
                    eta: ior.unwrap_or(scaled.eta),
                    ..scaled
                })
            }
            // Coefficients in units of the scene
            (None, Some(sigma_s), None) if table.mean_free_path.is_none() => {
                self.refuse_scale()?;
                let sigma_a = table.absorption.as_ref().map_or([0.0; 3], |sigma| sigma.0);
                Ok(Scattering {
                    sigma_s_reduced: sigma_s.0.map(f64::from),
                    sigma_a: sigma_a.map(f64::from),
                    eta,
                })
            }
            // A reflectance and a mean free path
            (None, None, Some(reflectance)) if table.absorption.is_none() => {
                self.refuse_scale()?;
                let Some(path) = &table.mean_free_path else {
                    return Err(reflectance.fault("has no depth of scattering: add `mean_free_path`"));
                };
                Scattering::from_reflectance(reflectance.0.map(f64::from), path.0, eta)
                    .map_err(|error| self.fault(error.to_string()))
            }
            _ => Err(self.fault(
                "does not define the scattering in exactly one way: give a `preset`, or `scattering` and \
                 `absorption`, or `reflectance` and `mean_free_path`",
            )),
        }
    }

    fn unknown(&self, preset: &Located<String>) -> Diagnostic {
        let names = SubsurfacePreset::ALL.map(|preset| preset.name).join(", ");
        let sentence = format!("`{}` is not a measured material: give one of {names}", **preset);
        // A preset that was given as a plain string has no span of its own
        if preset.span.is_empty() {
            self.fault(sentence)
        } else {
            preset.fault(sentence)
        }
    }

    fn millimetre(&self) -> Result<f64, Diagnostic> {
        match &self.0.scale {
            None => Ok(MILLIMETRE),
            Some(scale) if **scale > 0.0 && **scale < f64::INFINITY => Ok(**scale),
            Some(scale) => Err(scale.fault(format!(
                "is {}: give the length of a millimetre, more than 0",
                **scale
            ))),
        }
    }

    /// Rejects `scale` with other forms, as only presets are measured in millimetres.
    fn refuse_scale(&self) -> Result<(), Diagnostic> {
        match &self.0.scale {
            None => Ok(()),
            Some(scale) => Err(scale.fault("is for a `preset`: give lengths in units of the scene instead")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::material_form::MaterialForm;
    use super::super::node::from_text;
    use super::*;
    use crate::optics::LINE_D;
    use crate::scene::{Material, Translucency};

    fn material(text: &str) -> Result<Material, String> {
        let form = from_text::<MaterialForm>(text).map_err(|error| error.message().to_owned())?;
        let mut material = form.material("test")?;
        form.scatter(&mut material)
            .map_err(|fault| fault.sentence().to_owned())?;
        Ok(material)
    }

    #[test]
    fn preset_is_in_millimetres_of_a_metric_scene_by_default() {
        let milk = material("subsurface = 'wholemilk'").unwrap();
        let scattering = milk.subsurface.unwrap();
        // 2.55 per millimetre, in metres.
        assert!((scattering.sigma_s_reduced[0] - 2550.0).abs() < 1e-9);
        assert_eq!((scattering.eta, milk.ior(LINE_D)), (1.3, 1.3));
        let marble = material("subsurface = { preset = 'marble', scale = 0.5 }\nior = 1.4").unwrap();
        let scattering = marble.subsurface.unwrap();
        assert_eq!((scattering.sigma_s_reduced[1], scattering.eta), (5.24, 1.4));
        assert_eq!(marble.ior(LINE_D), 1.4);
    }

    #[test]
    fn coefficients_and_colours_use_scene_units() {
        let given = material("subsurface = { scattering = [1, 2, 3], absorption = 0.5 }").unwrap();
        let scattering = given.subsurface.unwrap();
        assert_eq!(
            (scattering.sigma_s_reduced, scattering.sigma_a, scattering.eta),
            ([1.0, 2.0, 3.0], [0.5; 3], DEFAULT_IOR)
        );
        let wax = material("subsurface = { reflectance = [1, 0.5, 0.2], mean_free_path = 0.25 }").unwrap();
        let scattering = wax.subsurface.unwrap();
        assert_eq!((scattering.sigma_s_reduced[0], scattering.sigma_a[0]), (4.0, 0.0));
        assert!(scattering.sigma_a[2] > scattering.sigma_a[1]);
    }

    #[test]
    fn thin_surface_transmits_its_base_colour_by_default() {
        let leaf = material("base_color = [0.2, 0.5, 0.1]\ntranslucency = 0.5").unwrap();
        let expected = Translucency {
            factor: 0.5,
            color: [0.2, 0.5, 0.1],
        };
        assert_eq!(leaf.translucency, Some(expected));
        let leaf = material("translucency = 0.5\ntranslucency_color = [0, 1, 0]").unwrap();
        assert_eq!(leaf.translucency.unwrap().color, [0.0, 1.0, 0.0]);
    }

    #[test]
    fn conflicting_keys_are_rejected() {
        for (bad, words) in [
            (
                "subsurface = 'chalk'",
                "is not a measured material: give one of apple, chicken1",
            ),
            ("subsurface = { preset = 'chalk' }", "give one of apple"),
            ("subsurface = { preset = 'skin1', scale = 0 }", "more than 0"),
            (
                "subsurface = { preset = 'skin1', absorption = 1 }",
                "coefficients of its own",
            ),
            ("subsurface = { scattering = 1, scale = 1 }", "is for a `preset`"),
            (
                "subsurface = { scattering = 1e20 }",
                "give a number from 0 to 1e15",
            ),
            ("subsurface = { reflectance = 0.5 }", "add `mean_free_path`"),
            (
                "subsurface = { reflectance = 2, mean_free_path = 1 }",
                "diffuse reflectance",
            ),
            ("subsurface = {}", "in exactly one way"),
            ("subsurface = { absorption = 1 }", "in exactly one way"),
            (
                "subsurface = 'marble'\ntransmission = 1",
                "give either `transmission`",
            ),
            (
                "subsurface = 'marble'\ntranslucency = 0.5",
                "give `subsurface` or `translucency`",
            ),
            (
                "subsurface = 'marble'\nmodel = 'lecture'",
                "only the metallic-roughness model",
            ),
            ("subsurface = 'marble'\nior = 2.5", "give one from 1 to 2"),
            ("translucency = 1.5", "outside [0, 1]"),
            (
                "translucency = 0.5\nmodel = 'lecture'",
                "only the metallic-roughness model",
            ),
            ("translucency_color = 0.5", "without `translucency`"),
        ] {
            let error = material(bad).unwrap_err();
            assert!(error.contains(words), "{bad}: {error}");
        }
    }
}
