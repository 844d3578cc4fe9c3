//! Reports of measurements: render statistics, scene contents, and the tables and pages of benchmarks, studies and
//! verification.
//!
//! Keys of the JSON forms are stable: new ones may be added, and existing ones are never renamed.

mod cpu;
mod format;
mod html;
mod image;
mod knob_name;
mod text;

pub use crate::batch::memory;
pub use html::{
    batch_page, bench_page, compare_page, cost_page, cross_check_page, gallery, page, verify_page,
};
pub use image::{difference_image, heat_map, overlay, worst_tiles};
pub use text::{
    ablation, accel_info, batch, bench, compare, cost, cross_check, crossover, extents, forecast,
    image_error, info, regression, stats, table, verify,
};
