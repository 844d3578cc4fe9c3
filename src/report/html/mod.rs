//! Reports as HTML pages.

pub mod batch_page;
mod bench_charts;
pub mod bench_page;
pub mod compare_page;
mod cost_charts;
pub mod cost_page;
pub mod cross_check_page;
pub mod gallery;
mod intersection_errors;
pub mod page;
pub mod verify_page;
