//! Reports of measurements: render statistics, scene contents, and the tables and pages of benchmarks, studies and
//! verification.
//!
//! Keys of the JSON forms are stable: new ones may be added, and existing ones are never renamed.

pub mod bench;
mod bench_charts;
pub mod bench_page;
pub mod compare;
pub mod compare_page;
pub mod cost;
mod cost_charts;
mod cost_geometry;
pub mod cost_page;
pub mod crossing;
pub mod difference;
pub mod extents;
pub mod forecast;
pub mod gallery;
pub mod heat;
pub mod info;
mod letters;
mod machine;
pub mod memory;
pub mod overlay;
pub mod own;
pub mod own_page;
pub mod page;
pub mod prices;
pub mod regress;
pub mod stats;
pub mod structure;
pub mod table;
pub mod verify;
pub mod verify_page;
mod volumes_info;
mod words;
pub mod worst_tiles;
