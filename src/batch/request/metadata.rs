//! Metadata in image files that records how an image was made.
//!
//! The metadata contains nothing that may differ between two runs with equal pixels, such as times, threads or folders,
//! so that the files are identical to the last byte.

use serde::{Deserialize, Serialize};

use super::environment::{EnvironmentRequest, EnvironmentSource};
use super::render_request::RenderRequest;
use super::resolved::ResolvedSettings;
use super::settings::Settings;
use crate::accel::EmbreeIdentity;
use crate::image::{Attribute, ToneOperator, cryptomatte};
use crate::render::{AovKind, Plan};
use crate::scene::image_settings::{FilterKind, VisibleBackground};
use crate::scene::{Camera, Effect, EffectSet, Scene};

/// Names and texts of the metadata of an image file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Notes(Vec<(String, String)>);

impl Notes {
    /// Returns the metadata of an image: `whit.settings` as JSON, `whit.plan`, `whit.embree` if Embree found the hits,
    /// and the attributes that Cryptomatte requires for its layers.
    pub fn of(
        (request, resolved): (&RenderRequest, &ResolvedSettings),
        (scene, camera): (&Scene, &Camera),
        embree: Option<&EmbreeIdentity>,
        plan: &Plan,
    ) -> Notes {
        let mut notes = Notes::default();
        // Record the Embree version, as bits depend on it
        if let Some(EmbreeIdentity { version, isa }) = embree {
            notes.add("whit.embree", format!("{version} {isa}"));
        }
        notes.add("whit.plan", plan.to_string());
        notes.add("whit.settings", settings(request, resolved, camera));
        for kind in resolved.settings.layers.kinds() {
            notes.add_matte(kind, scene);
        }
        notes
    }

    /// Adds a text under a name.
    pub fn add(&mut self, name: impl Into<String>, text: String) {
        self.0.push((name.into(), text));
    }

    /// Adds the attributes of a Cryptomatte layer; does nothing for other layers.
    fn add_matte(&mut self, kind: AovKind, scene: &Scene) {
        let Some(layer) = kind.cryptomatte() else { return };
        let names = kind.matte_names(scene).unwrap_or_default();
        let attributes = cryptomatte::attributes(layer, names);
        for (name, text) in attributes {
            self.add(name, text);
        }
    }

    /// Returns the texts as attributes for image writers.
    pub fn list(&self) -> Vec<Attribute<'_>> {
        self.0
            .iter()
            .map(|(name, text)| Attribute { name, text })
            .collect()
    }
}

/// Settings of an image, serialized to `whit.settings`.
#[derive(Serialize)]
struct ImageRecord<'a> {
    size: [u32; 2],
    camera: &'a str,
    exposure: f32,
    #[serde(skip_serializing_if = "is_clip")]
    tone_map: ToneOperator,
    #[serde(skip_serializing_if = "is_of_the_scene")]
    background: VisibleBackground,
    filter: FilterKind,
    filter_radius: f64,
    seed: u32,
    /// Contrast above which pixels have all samples.
    #[serde(skip_serializing_if = "Option::is_none")]
    edge_contrast: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ambient: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    environment: Option<EnvironmentRecord>,
    effects_added: Vec<&'static str>,
    effects_removed: Vec<&'static str>,
    #[serde(flatten)]
    settings: Settings,
}

/// Returns whether the operator is the default, which the record leaves out.
fn is_clip(operator: &ToneOperator) -> bool {
    *operator == ToneOperator::Clip
}

/// Returns whether the background is the default, which the record leaves out.
fn is_of_the_scene(background: &VisibleBackground) -> bool {
    *background == VisibleBackground::Environment
}

/// Environment map of an image, by its name without folders.
#[derive(Serialize)]
struct EnvironmentRecord {
    name: String,
    /// Rotation about +y in degrees.
    turn: f64,
    scale: f32,
}

impl EnvironmentRecord {
    fn of(request: &EnvironmentRequest) -> EnvironmentRecord {
        let name = match &request.source {
            EnvironmentSource::BuiltIn(environment) => environment.name().into(),
            EnvironmentSource::File(path) => path.file_name().unwrap_or_default().display().to_string(),
        };
        EnvironmentRecord {
            name,
            turn: request.rotation.to_degrees(),
            scale: request.scale,
        }
    }
}

fn settings(request: &RenderRequest, resolved: &ResolvedSettings, camera: &Camera) -> String {
    // Record the settings with the chosen backend, so that the image can be reproduced
    let names = |effects: EffectSet| effects.iter().map(Effect::name).collect();
    let record = ImageRecord {
        size: [resolved.settings.width, resolved.settings.height],
        camera: &camera.name,
        exposure: resolved.tone.exposure_ev,
        tone_map: resolved.operator,
        background: resolved.settings.background,
        filter: resolved.settings.filter.kind,
        filter_radius: resolved.settings.filter.radius,
        seed: resolved.settings.seed,
        edge_contrast: resolved.settings.edge_contrast.map(|contrast| contrast.limit),
        ambient: request.ambient,
        environment: request.environment.as_ref().map(EnvironmentRecord::of),
        effects_added: names(request.effects.added),
        effects_removed: names(request.effects.removed),
        settings: Settings::of(&resolved.settings, &request.tracing.path(), &request.change),
    };
    // Serialization cannot fail: the fields are numbers, strings and lists.
    serde_json::to_string(&record).unwrap_or_default()
}
