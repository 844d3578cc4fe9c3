//! Cost of accuracy: predictions, error estimates, and the settings chosen by them.

mod forecast;
mod parameters;
mod statistics;
pub mod studies;
