//! What accuracy costs in time: a scene's knobs, each turned by itself, on one plot of error over seconds.
//!
//! A [`Configuration`] is a way of rendering a scene; those that are measured differ from the *base* in one [`Knob`]
//! each. Errors are held against two independent halves of a reference, so that the reference's own noise does not count
//! ([`Halves`]); times are ratios to the base within blocks in which every configuration takes one turn ([`blocks`]). For
//! a target, what single turns foretell of several at once is an order in which to measure ([`forecasts`]). Whatever is
//! told comes with an interval that holds the true value 95 times of 100.

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
