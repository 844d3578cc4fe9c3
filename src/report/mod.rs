//! Measurements made readable: statistics of a render, contents of a scene, rows of a benchmark.
//!
//! Keys of the JSON forms are stable: they are added to, never renamed.

pub mod bench;
pub mod extents;
pub mod forecast;
pub mod heat;
pub mod info;
pub mod memory;
pub mod prices;
pub mod stats;
pub mod structure;
pub mod table;
mod volumes_info;
