//! What accuracy costs in time: a scene's knobs, each turned by itself, on one plot of error over seconds.
//!
//! A [`Configuration`] is a way of rendering a scene; those that are measured differ from the *base* in one [`Knob`] each.
//! Errors are held against two independent halves of a reference, so that the reference's own noise does not count
//! ([`Halves`]); times are ratios to the base within blocks in which every configuration takes one turn ([`blocks`]).
//! Whatever is told comes with an interval that holds the true value 95 times of 100.

pub mod blocks;
mod error;
mod experiment;
mod front;
mod knob;
mod settings;
mod slope;
pub mod statistics;
mod study;

pub use error::{Displayed, ErrorEstimate, Halves, Pictures};
pub use experiment::{CostError, Experiment, Findings, Watcher, run};
pub use front::{Place, front, knee};
pub use knob::{Configuration, HitPath, Knob, SceneChange, knobs};
pub use settings::{Measured, Settings, SettingsFile};
pub use slope::slope;
pub use statistics::Interval;
pub use study::{Check, Curve, Point, Reference, Study, Timing};
