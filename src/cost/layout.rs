//! Planned size and samples of all images of an experiment.

use super::knob::LevelRange;
use super::view::View;
use super::{Configuration, Knob};

/// Planned size and samples of all images of an experiment.
pub(super) struct Layout {
    pub(super) view: View,
    pub(super) candidates: Vec<Candidate>,
    /// Samples per pixel of each half of the reference.
    pub(super) reference_spp: u32,
    /// Samples per pixel of the images that check whether stricter knobs still matter.
    pub(super) stricter_spp: u32,
    /// Samples per pixel of the base.
    pub(super) base_spp: u32,
    /// Upper limits of the sampling knobs.
    pub(super) reach: LevelRange,
}

/// Configuration that is measured in every block, with its knob and level.
#[derive(Clone)]
pub(super) struct Candidate {
    pub(super) knob: Option<Knob>,
    pub(super) level: String,
    pub(super) configuration: Configuration,
}
