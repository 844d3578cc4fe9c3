//! Reports of measurements: render statistics, scene contents, and the tables and pages of benchmarks, studies and
//! verification.
//!
//! Keys of the JSON forms are stable: new ones may be added, and existing ones are never renamed.

pub mod ablation;
pub mod accel_info;
pub mod bench;
mod bench_charts;
pub mod bench_page;
mod bitmap_font;
pub mod compare;
pub mod compare_page;
pub mod cost;
mod cost_charts;
pub mod cost_page;
mod cpu;
pub mod cross_check;
pub mod cross_check_page;
pub mod crossover;
pub mod difference_image;
pub mod extents;
pub mod forecast;
mod format;
pub mod gallery;
pub mod heat_map;
pub mod info;
mod intersection_errors;
mod knob_name;
pub mod memory;
pub mod overlay;
pub mod page;
pub mod regression;
pub mod stats;
pub mod table;
pub mod verify;
pub mod verify_page;
mod volume_info;
pub mod worst_tiles;
