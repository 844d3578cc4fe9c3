//! Profile of a render: rays, time and memory by category, and the bound on truncation error.

mod category;
mod memory;
mod memory_report;
mod profiler;
mod ray_type_counts;
mod render_profile;
mod truncation;

pub use category::Category;
pub use memory::{Memory, MemoryEntry};
pub use render_profile::{RenderProfile, Tally, TruncationBound};

pub(super) use category::ACCOUNTS;
pub(super) use memory::{ThreadFootprint, ThreadMemory};
pub(super) use profiler::{Accounts, Moment, Profiler};
pub(super) use ray_type_counts::RayTypeCounts;
pub(super) use render_profile::TruncationLimit;
pub(super) use truncation::TileTruncation;
