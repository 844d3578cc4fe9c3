//! Error against render time: each tunable parameter (knob) of a scene is varied by itself, on one plot of error over
//! seconds.
//!
//! A [`Configuration`] is a way of rendering a scene; measured configurations differ from the *base* in one [`Knob`]
//! each. Errors are taken against two independent halves of a reference, so that the reference's own noise does not
//! count ([`Halves`]). Times are ratios to the base in a randomised block design: every configuration runs once per
//! block ([`blocks`]). For a target, effects of single levels predict combinations, which orders what to measure
//! ([`forecasts`]). Every reported value has a 95 % confidence interval.

pub mod blocks;
mod choose;
mod configuration;
mod error;
mod experiment;
mod front;
mod geometry;
mod knob;
mod layout;
mod reference;
mod search;
mod settings;
mod slope;
mod stage;
pub mod statistics;
mod study;
mod targets;
mod unfinished;

pub use choose::{Forecast, Goal, Target, forecasts, with_knob};
pub use configuration::{Configuration, HitPath, SceneChange};
pub use error::{Displayed, ErrorEstimate, Halves, Pictures};
pub use experiment::{CostError, Experiment, Findings, Gauge, Keep, Watcher, run};
pub use front::{Place, front, knee};
pub use geometry::{Answered, GeometricErrors};
pub use knob::{Knob, Reach, knobs};
pub use settings::{Measured, Settings, SettingsFile};
pub use slope::slope;
pub use statistics::Interval;
pub use study::{Check, Choice, Curve, Point, Reference, Study, Timing};
pub use unfinished::Unfinished;
