//! Plan of a render: the effects that a scene needs, each with its reason.
//!
//! Most scenes need few of the effects that the renderer can simulate. Every effect has triggers, necessary
//! conditions on the data of the scene ([`TRIGGERS`]); an effect without an active trigger is off: it costs no rays,
//! no queue, no arrays, and no code in the path of other effects except one test. An effect that is off changes no
//! bit of the image, which `tests/it/scenes/effect_plan.rs` proves by rendering with everything on (`--effects all`).
//!
//! After planning, no code tests again whether the scene needs an effect.

mod facts;
mod light_visibility;
mod ray_forecast;
mod trigger;

use std::fmt;

use serde::Serialize;

pub use facts::Facts;
pub use ray_forecast::forecast_rays;
pub use trigger::{TRIGGERS, Trigger};

use crate::scene::{Camera, Effect, EffectOverrides, EffectSet, Scene};

/// Effects that are simulated, with the reason for each.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Decisions about all effects, in the order of [`Effect::ALL`].
    pub decisions: Vec<Decision>,
    /// Flag for every light: whether its shadow rays are traced.
    pub casts_shadows: Vec<bool>,
    on: EffectSet,
    forced: EffectSet,
}

/// Decision whether an effect is simulated, with its reason.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// Effect that the decision is about.
    pub effect: Effect,
    /// True if the effect is simulated.
    pub on: bool,
    /// Reason: data of the scene that needs the effect, a lack of any, or an override by the user.
    pub reason: String,
    /// True if the user overrides the needs of the scene.
    #[serde(skip)]
    pub overridden: bool,
}

impl Plan {
    /// Plans a scene that has passed [`Scene::validate`], as seen by `camera`, with the overrides of the user.
    pub fn new(scene: &Scene, camera: &Camera, overrides: &EffectOverrides) -> Plan {
        // Evaluate the triggers of every effect
        let facts = Facts::of(scene, camera);
        let mut decisions: Vec<Decision> = Effect::ALL
            .into_iter()
            .map(|effect| decide(effect, &facts))
            .collect();
        let called_for: EffectSet = on(&decisions);
        // Apply the overrides
        for decision in &mut decisions {
            let effect = decision.effect;
            if overrides.removed.has(effect) && decision.on {
                decision.on = false;
                decision.overridden = true;
                decision.reason = format!("switched off, so {}; {}", effect.consequence(), decision.reason);
            } else if overrides.added.has(effect) && !decision.on {
                decision.on = true;
                decision.overridden = true;
                decision.reason = format!("switched on, though {}", decision.reason);
            }
        }
        // Switch off effects whose requirements are off
        drop_what_needs_more(&mut decisions);
        let on = on(&decisions);
        let everywhere = overrides.added.has(Effect::Shadow);
        Plan {
            casts_shadows: facts
                .lights
                .iter()
                .map(|light| on.has(Effect::Shadow) && (everywhere || light.casts))
                .collect(),
            forced: on.minus(called_for),
            decisions,
            on,
        }
    }

    /// Returns the effects that are simulated.
    pub fn effects(&self) -> EffectSet {
        self.on
    }

    /// Returns the simulated effects that the scene does not need.
    pub(crate) fn forced(&self) -> EffectSet {
        self.forced
    }

    /// Returns whether the user switched off an effect that the scene needs.
    pub(crate) fn is_switched_off(&self, effect: Effect) -> bool {
        self.overridden()
            .any(|decision| decision.effect == effect && !decision.on)
    }

    /// Iterates over the decisions that override the needs of the scene.
    pub fn overridden(&self) -> impl Iterator<Item = &Decision> {
        self.decisions.iter().filter(|decision| decision.overridden)
    }
}

impl fmt::Display for Decision {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let state = if self.on { "on" } else { "off" };
        write!(f, "{} {state}: {}", self.effect, self.reason)
    }
}

/// Prints one line for each decision.
impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.decisions
            .iter()
            .try_for_each(|decision| writeln!(f, "{decision}"))
    }
}

/// Returns the decision about an effect that follows from the scene.
fn decide(effect: Effect, facts: &Facts) -> Decision {
    let triggers = TRIGGERS.iter().filter(|trigger| trigger.effect == effect);
    let reasons: Vec<String> = triggers.filter_map(|trigger| (trigger.fires)(facts)).collect();
    Decision {
        effect,
        on: !reasons.is_empty(),
        reason: if reasons.is_empty() {
            trigger::absence(effect, facts)
        } else {
            reasons.join("; ")
        },
        overridden: false,
    }
}

/// Switches off effects that have no result without another effect that is off.
fn drop_what_needs_more(decisions: &mut [Decision]) {
    let present = on(decisions);
    for decision in decisions {
        let Some(needed) = decision.effect.needs() else {
            continue;
        };
        if decision.on && !present.has(needed) {
            decision.on = false;
            decision.overridden = true;
            decision.reason = format!("no effect without {needed}, which is off; {}", decision.reason);
        }
    }
}

fn on(decisions: &[Decision]) -> EffectSet {
    decisions
        .iter()
        .filter(|decision| decision.on)
        .map(|decision| decision.effect)
        .collect()
}
