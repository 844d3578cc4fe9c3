//! Measurement of times: one protocol for all commands, and the statistics of its results.
//!
//! Every candidate runs once in each block, in random order, beside a calibration kernel that detects other load on the
//! machine ([`Blocks`]). Results are medians with an interval ([`Interval`]).

mod blocks;
mod observer;
mod statistics;

pub use blocks::{Blocks, Protocol, Timing};
pub use observer::Observer;
pub use statistics::{Interval, bootstrap};
