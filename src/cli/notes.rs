//! What pictures say of how they were made, beside their pixels.
//!
//! Nothing that may differ between two runs with the same pixels: no times, threads or folders. So the files are the
//! same to the last byte.

use std::borrow::Cow;

use serde::Serialize;

use crate::accel::EmbreeIdentity;
use crate::cost::{Configuration, Settings};
use crate::image::{Attribute, cryptomatte};
use crate::render::{LayerKind, Plan};
use crate::scene::image_settings::FilterKind;
use crate::scene::{Camera, Effect, EffectSet, Scene};

use super::job::{RenderJob, Shot};

/// Texts under their names.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Notes(Vec<(Cow<'static, str>, String)>);

impl Notes {
    /// How a picture was made: `whit.settings` as JSON, `whit.plan`, and `whit.embree` where Embree found the hits; and
    /// what Cryptomatte wants to be told of its layers.
    pub(super) fn of(
        (job, shot): (&RenderJob, &Shot),
        (scene, camera): (&Scene, &Camera),
        embree: Option<&EmbreeIdentity>,
        plan: &Plan,
    ) -> Notes {
        let mut notes = Notes::default();
        if let Some(EmbreeIdentity { version, isa }) = embree {
            notes.add("whit.embree", format!("{version} {isa}"));
        }
        notes.add("whit.plan", plan.to_string());
        notes.add("whit.settings", settings((job, shot), camera));
        for kind in shot.settings.layers.kinds() {
            notes.add_matte(kind, scene);
        }
        notes
    }

    /// Adds a text.
    pub(super) fn add(&mut self, name: impl Into<Cow<'static, str>>, text: String) {
        self.0.push((name.into(), text));
    }

    /// Adds what Cryptomatte wants to be told of layers, where these are its own.
    fn add_matte(&mut self, kind: LayerKind, scene: &Scene) {
        let Some(layer) = kind.cryptomatte() else { return };
        let names = kind.matte_names(scene).unwrap_or_default();
        let attributes = cryptomatte::attributes(layer, names);
        for (name, text) in attributes {
            self.add(name, text);
        }
    }

    /// The texts as a file takes them.
    pub(super) fn list(&self) -> Vec<Attribute<'_>> {
        self.0
            .iter()
            .map(|(name, text)| Attribute { name, text })
            .collect()
    }
}

/// What a picture was made with.
#[derive(Serialize)]
struct Made<'a> {
    size: [u32; 2],
    camera: &'a str,
    exposure: f32,
    filter: FilterKind,
    filter_radius: f64,
    seed: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    ambient: Option<[f32; 3]>,
    effects_added: Vec<&'static str>,
    effects_removed: Vec<&'static str>,
    #[serde(flatten)]
    settings: Settings,
}

fn settings((job, shot): (&RenderJob, &Shot), camera: &Camera) -> String {
    let names = |effects: EffectSet| effects.iter().map(Effect::name).collect();
    let made = Made {
        size: [shot.settings.width, shot.settings.height],
        camera: &camera.name,
        exposure: shot.tone.exposure_ev,
        filter: shot.settings.filter.kind,
        filter_radius: shot.settings.filter.radius,
        seed: shot.settings.seed,
        ambient: job.ambient,
        effects_added: names(job.effects.added),
        effects_removed: names(job.effects.removed),
        settings: Settings::of(&Configuration {
            settings: shot.settings,
            path: job.tracing.path(job.backend),
            change: job.change,
        }),
    };
    // Numbers, words and lists of them, which JSON can say.
    serde_json::to_string(&made).unwrap_or_default()
}
