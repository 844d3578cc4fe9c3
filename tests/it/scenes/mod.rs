//! Whole scenes: against goldens, against the recursive reference, between backends, and with effects on and off.

#[cfg(feature = "embree")]
mod agree;
mod effect_plan;
mod goldens;
mod metamorphic;
mod profile;
mod textbook;
mod wavefront_vs_reference;
