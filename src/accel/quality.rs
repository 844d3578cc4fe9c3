//! What building an acceleration structure may take: time for a better tree, or memory for a faster one.

use std::fmt;

use serde::{Deserialize, Serialize};

/// How much work Embree puts into its trees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BuildQuality {
    /// By the order of the objects along a curve through space: built in a fraction of the time, walked in longer.
    Low,
    /// By the surface area heuristic.
    #[default]
    Medium,
    /// The same with large triangles cut in two where that pays. Embree does so for its own triangles at
    /// [`Precision::Fast`](super::Precision::Fast) only; elsewhere it is [`BuildQuality::Medium`].
    High,
}

impl BuildQuality {
    /// All, the quickest to build first.
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
