//! Reports as text, CSV and JSON.

pub mod ablation;
pub mod accel_info;
pub mod batch;
pub mod bench;
pub mod compare;
pub mod cost;
pub mod cross_check;
pub mod crossover;
pub mod extents;
pub mod forecast;
pub mod image_error;
pub mod info;
pub(super) mod intersection_errors;
mod material_info;
pub mod regression;
pub mod stats;
pub mod table;
pub mod verify;
mod volume_info;
