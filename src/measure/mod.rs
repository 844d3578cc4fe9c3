//! Measurement of times: one protocol for all commands, and the statistics of its results.
//!
//! Every candidate runs once in each block, in random order, beside a calibration kernel that detects other load on the
//! machine ([`Blocks`]). Ratios compare processor times ([`TurnTime`]), to which other programs do not add. Results are
//! medians with an interval ([`Interval`]).

mod blocks;
mod observer;
mod statistics;
mod turn_time;

pub use blocks::{Blocks, Protocol, Timing};
pub use observer::Observer;
pub use statistics::{Interval, bootstrap};
pub use turn_time::{Stopwatch, TurnTime};
