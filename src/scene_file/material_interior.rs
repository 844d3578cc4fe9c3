//! Interiors of materials of scene files: the index of refraction in any of the usual forms, and absorption.

use super::material_form::MaterialForm;
use super::medium::Glass;
use crate::optics::{Absorption, Cauchy, Dispersion, ior_from_speed};
use crate::scene::{DEFAULT_IOR, Medium, MediumKind};

/// Square nanometres in a square micrometre.
const SQUARE_NANOMETRES: f64 = 1e6;

impl MaterialForm {
    /// Returns the interior, if a key describes it or light enters it.
    pub(super) fn interior(&self, light_enters: bool) -> Result<Option<Medium>, String> {
        // Keys that describe an interior even if no light enters it
        let has_medium_keys = self.priority.is_some()
            || self.thin.is_some()
            || self.absorption.is_some()
            || self.attenuation_color.is_some()
            || self.attenuation_distance.is_some();
        let ior = self.dispersion()?;
        if !(light_enters || has_medium_keys || ior.is_some()) {
            return Ok(None);
        }
        Ok(Some(Medium {
            ior: ior.unwrap_or(Dispersion::Constant(DEFAULT_IOR)),
            absorption: self.absorption()?,
            priority: self.priority.unwrap_or(0),
            kind: match self.thin {
                Some(true) => MediumKind::ThinSlab,
                _ => MediumKind::Solid,
            },
        }))
    }

    fn dispersion(&self) -> Result<Option<Dispersion>, String> {
        // Reject two indices of refraction
        let keys = [
            (self.glass.is_some(), "glass"),
            (self.ior.is_some(), "ior"),
            (self.speed.is_some(), "speed"),
            (self.sellmeier.is_some(), "sellmeier"),
            (self.cauchy.is_some(), "cauchy"),
        ];
        let given: Vec<&str> = keys
            .iter()
            .filter(|(given, _)| *given)
            .map(|(_, key)| *key)
            .collect();
        // Two ways to give the index would contradict each other
        if let [first, second, ..] = given[..] {
            return Err(format!(
                "has both `{first}` and `{second}`: give one index of refraction"
            ));
        }
        // Find a constant index, if one is given
        let plain = match (self.ior, self.speed) {
            (Some(ior), _) => Some(ior),
            (None, Some(speed)) if speed > 0.0 && speed <= 1.0 => Some(ior_from_speed(speed)),
            (None, Some(speed)) => {
                return Err(format!(
                    "its `speed` is {speed}: give a fraction of the speed of light, over 0 and up to 1"
                ));
            }
            (None, None) => None,
        };
        // Add dispersion by the Abbe number
        match (plain, self.abbe) {
            (Some(ior), None) => return Ok(Some(Dispersion::Constant(ior))),
            (Some(ior), Some(abbe)) if abbe > 0.0 => {
                return Ok(Some(Dispersion::Cauchy(Cauchy::from_abbe(ior, abbe))));
            }
            (Some(_), Some(abbe)) => {
                return Err(format!(
                    "its `abbe` is {abbe}: give a positive number, 20 to 90 for glasses"
                ));
            }
            (None, Some(_)) => return Err("has `abbe` without `ior` or `speed`: add one of them".into()),
            (None, None) => {}
        }
        // Otherwise use an equation or a named medium
        if let Some(cauchy) = self.cauchy {
            let (a, b) = (cauchy.a, cauchy.b * SQUARE_NANOMETRES);
            return Ok(Some(Dispersion::Cauchy(Cauchy { a, b })));
        }
        if let Some(form) = &self.sellmeier {
            return form.sellmeier().map(Dispersion::Sellmeier).map(Some);
        }
        Ok(self.glass.map(Glass::dispersion))
    }

    fn absorption(&self) -> Result<Absorption, String> {
        match (self.absorption, self.attenuation_color, self.attenuation_distance) {
            (None, None, None) => Ok(Absorption::NONE),
            (Some(sigma_a), None, None) => Ok(Absorption {
                sigma_a: sigma_a.0.map(f64::from),
            }),
            (None, Some(color), Some(distance)) => {
                if !(distance > 0.0 && distance < f64::INFINITY) {
                    return Err(format!(
                        "its `attenuation_distance` is {distance}: give metres, more than 0"
                    ));
                }
                if color.0.iter().any(|c| *c > 1.0) {
                    return Err(
                        "its `attenuation_color` is over 1, but no medium adds light: give at most 1".into(),
                    );
                }
                Ok(Absorption::from_color(color.0.map(f64::from), distance))
            }
            (Some(_), ..) => Err("has both `absorption` and an attenuation: give one".into()),
            (None, Some(_), None) => {
                Err("has `attenuation_color` without `attenuation_distance`: add it".into())
            }
            (None, None, Some(_)) => {
                Err("has `attenuation_distance` without `attenuation_color`: add it".into())
            }
        }
    }
}
