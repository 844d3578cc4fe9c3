//! Request of interreflection: a switch, or a table of settings.

use schemars::JsonSchema;
use serde::Deserialize;

use super::forms::{forms, schema};
use crate::scene::Interreflection;

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
