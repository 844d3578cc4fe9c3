//! Target that settings are chosen for: a largest error or a longest time.

use serde::{Deserialize, Serialize};

/// Target that settings are chosen for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Target {
    /// Least time at which the root mean squared error of displayed values is at most this.
    Error(f64),
    /// Least error at which the complete image takes at most so many seconds, setup included.
    Seconds(f64),
}

/// Target in the units of a study.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// Largest root mean squared error of displayed values, as in [`Target::Error`].
    Error(f64),
    /// Largest time relative to the base's.
    TimeRatio(f64),
}
