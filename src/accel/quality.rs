//! Build quality of an acceleration structure: build time against traversal time.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Amount of work that Embree puts into its trees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum BuildQuality {
    /// By the order of the objects along a curve through space: built in a fraction of the time, slower to traverse.
    Low,
    /// By the surface area heuristic.
    #[default]
    Medium,
    /// By the surface area heuristic, with large triangles split in two where that pays. Embree does so for its own
    /// triangles at [`Precision::Fast`](super::Precision::Fast) only; elsewhere it is [`BuildQuality::Medium`].
    High,
}

impl BuildQuality {
    /// All qualities, the quickest to build first.
    pub const ALL: [BuildQuality; 3] = [BuildQuality::Low, BuildQuality::Medium, BuildQuality::High];
}

impl fmt::Display for BuildQuality {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            BuildQuality::Low => "low",
            BuildQuality::Medium => "medium",
            BuildQuality::High => "high",
        })
    }
}
