//! Requests of interreflection and of caustics: a switch each, or a table of settings.

use schemars::JsonSchema;
use serde::Deserialize;

use super::forms::{forms, schema};
use crate::scene::{Caustics, Interreflection};

/// Settings of diffuse light between surfaces.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct BounceSettings {
    /// Largest number of diffuse surfaces that scatter the light of a path, 1 to 256.
    #[schemars(extend("default" = Interreflection::default().bounces))]
    bounces: Option<u32>,
}

/// Interreflection of the scene; `None` if it is switched off.
#[derive(Clone, Copy, Debug)]
pub(super) struct InterreflectionForm(Option<BounceSettings>);

forms! {
    ['de] InterreflectionForm, "true, false or { bounces = 16 }";
    boolean is_on => Ok(InterreflectionForm(is_on.then_some(BounceSettings { bounces: None })));
    table table => BounceSettings::deserialize(table).map(|settings| InterreflectionForm(Some(settings)));
}

schema!([] InterreflectionForm, "Interreflection", generator => {
    "anyOf": [{ "type": "boolean" }, generator.subschema_for::<BounceSettings>()],
    "default": false,
});

impl InterreflectionForm {
    /// Returns the settings of the scene.
    pub(super) fn interreflection(self) -> Option<Interreflection> {
        let settings = self.0?;
        let default = Interreflection::default();
        Some(Interreflection {
            bounces: settings.bounces.unwrap_or(default.bounces),
        })
    }
}

/// Settings of photons that mirrors and refracting bodies throw onto surfaces.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PhotonSettings {
    /// Number of photons that all lights emit together, 1 to 2^24.
    #[schemars(extend("default" = Caustics::default().photons))]
    photons: Option<u32>,
    /// Number of neighbours that the disc of a photon reaches, 1 to 4096.
    #[schemars(extend("default" = Caustics::default().neighbours))]
    neighbours: Option<u32>,
}

/// Caustics of the scene; `None` if they are switched off.
#[derive(Clone, Copy, Debug)]
pub(super) struct CausticsForm(Option<PhotonSettings>);

forms! {
    ['de] CausticsForm, "true, false or { photons = 262144, neighbours = 32 }";
    boolean is_on => Ok(CausticsForm(is_on.then(PhotonSettings::default)));
    table table => PhotonSettings::deserialize(table).map(|settings| CausticsForm(Some(settings)));
}

schema!([] CausticsForm, "Caustics", generator => {
    "anyOf": [{ "type": "boolean" }, generator.subschema_for::<PhotonSettings>()],
    "default": false,
});

impl CausticsForm {
    /// Returns the settings of the scene.
    pub(super) fn caustics(self) -> Option<Caustics> {
        let settings = self.0?;
        let default = Caustics::default();
        Some(Caustics {
            photons: settings.photons.unwrap_or(default.photons),
            neighbours: settings.neighbours.unwrap_or(default.neighbours),
        })
    }
}
