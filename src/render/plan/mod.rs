//! The plan of a render: which effects a scene calls for, each with its reason.
//!
//! Light may do many things, and most scenes need few of them. Every effect has triggers, necessary conditions that the
//! scene's own data either meet or do not ([`TRIGGERS`]); an effect that none of its triggers asks for is off: no rays,
//! no queue, no columns of memory, no code on the way of other effects but one test. What is off changes no bit of the
//! picture, which `tests/it/scenes/effect_plan.rs` proves by rendering with everything on (`--effects all`).
//!
//! After the plan nobody asks the scene again whether it has some effect.

mod facts;
mod reach;
mod trigger;

use std::fmt;

use serde::Serialize;

pub use facts::Facts;
pub use trigger::{TRIGGERS, Trigger};

use crate::scene::{Camera, Effect, EffectOverrides, EffectSet, Scene};

/// What is simulated, and why.
#[derive(Clone, Debug)]
pub struct Plan {
    /// One for every effect, in the order of [`Effect::ALL`].
    pub decisions: Vec<Decision>,
    /// For every light whether its shadow rays are traced.
    pub casting: Vec<bool>,
    on: EffectSet,
    forced: EffectSet,
}

/// Whether an effect is simulated, and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decision {
    /// Which.
    pub effect: Effect,
    /// Whether it is.
    pub on: bool,
    /// What in the scene calls for it, that nothing does, or that a person wants it otherwise.
    pub reason: String,
    /// Whether a person wants it other than the scene calls for.
    #[serde(skip)]
    pub overridden: bool,
}

impl Plan {
    /// The plan for a scene that has passed [`Scene::validate`], seen by `camera`, with what a person wants otherwise.
    pub fn new(scene: &Scene, camera: &Camera, overrides: &EffectOverrides) -> Plan {
        let facts = Facts::of(scene, camera);
        let mut decisions: Vec<Decision> = Effect::ALL
            .into_iter()
            .map(|effect| decide(effect, &facts))
            .collect();
        let called_for: EffectSet = on(&decisions);
        for decision in &mut decisions {
            let effect = decision.effect;
            if overrides.removed.has(effect) && decision.on {
                decision.on = false;
                decision.overridden = true;
                decision.reason = format!("switched off, so {}; {}", effect.lack(), decision.reason);
            } else if overrides.added.has(effect) && !decision.on {
                decision.on = true;
                decision.overridden = true;
                decision.reason = format!("switched on, though {}", decision.reason);
            }
        }
        drop_what_needs_more(&mut decisions);
        let on = on(&decisions);
        let everywhere = overrides.added.has(Effect::Shadow);
        Plan {
            casting: facts
                .lights
                .iter()
                .map(|light| on.has(Effect::Shadow) && (everywhere || light.casts))
                .collect(),
            forced: on.minus(called_for),
            decisions,
            on,
        }
    }

    /// The effects that are simulated.
    pub fn effects(&self) -> EffectSet {
        self.on
    }

    /// Those of them that nothing calls for.
    pub fn forced(&self) -> EffectSet {
        self.forced
    }

    /// The decisions that are other than the scene calls for.
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

/// A line for each decision.
impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.decisions
            .iter()
            .try_for_each(|decision| writeln!(f, "{decision}"))
    }
}

/// What the scene itself says of an effect.
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

/// Switches off what can do nothing without an effect that is off.
fn drop_what_needs_more(decisions: &mut [Decision]) {
    let present = on(decisions);
    for decision in decisions {
        let Some(needed) = decision.effect.needs() else {
            continue;
        };
        if decision.on && !present.has(needed) {
            decision.on = false;
            decision.overridden = true;
            decision.reason = format!("nothing without {needed}, which is off; {}", decision.reason);
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
