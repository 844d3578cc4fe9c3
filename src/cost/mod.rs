//! Error against render time: each tunable parameter (knob) of a scene is varied by itself, on one plot of error over
//! seconds.
//!
//! A [`Configuration`] is a way of rendering a scene; measured configurations differ from the *base* in one [`Knob`]
//! each. Errors are taken against two independent halves of a reference, so that the reference's own noise does not
//! count ([`SplitReference`]). Times are ratios to the base in a randomised block design: every configuration runs once per
//! block ([`crate::measure`]). For a target, effects of single levels predict combinations, which orders what to measure
//! ([`forecasts`]). Every reported value has a 95 % confidence interval.

mod accumulated_reference;
mod autotune;
mod budget;
mod checkpoint;
mod configuration;
mod convergence_rate;
mod error;
mod evaluate;
mod experiment;
mod geometric_errors;
mod geometry;
mod knob;
mod layout;
mod measure;
mod noise_stratum;
mod pareto;
mod predict;
mod reference;
mod run;
mod settings;
mod study;
mod study_result;
mod target;
mod tuner;
mod view;
mod workspace;

pub use crate::batch::request::{HitPath, SceneChange, Settings};
pub use crate::measure::{Interval, Timing};
pub use checkpoint::StudyCheckpoint;
pub use configuration::Configuration;
pub use convergence_rate::slope;
pub use error::{DisplayImage, ErrorEstimate, ImageSums, SplitReference};
pub use experiment::{CostError, Experiment, Keep};
pub use geometric_errors::GeometricErrors;
pub use geometry::ReferenceResults;
pub use knob::{Knob, LevelRange, knobs};
pub use pareto::{ParetoPoint, front, knee};
pub use predict::{Prediction, forecasts, with_knob};
pub use run::run;
pub use settings::{Measured, SettingsFile};
pub use study::{Check, Choice, Curve, Point, Reference, Study};
pub use study_result::{PatchReference, StudyResult};
pub use target::{Goal, Target};
