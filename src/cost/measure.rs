//! Measurement blocks of an experiment, with checkpoints.

use std::time::{Duration, Instant};

use super::accumulated_reference::AccumulatedReference;
use super::budget::MEASURED_PART;
use super::checkpoint::{CheckpointData, checksum};
use super::layout::Layout;
use super::workspace::Workspace;
use super::{CostError, ImageSums, Knob, StudyCheckpoint};
use crate::measure::{Blocks, Protocol};
use crate::render::Rendering;

/// Least number of blocks, without and with a target, and the largest number.
const MIN_BLOCKS: usize = 6;
const MIN_BLOCKS_FOR_A_TARGET: usize = 2;
const MAX_BLOCKS: usize = 40;
/// Fraction of the budget for measurement blocks where settings are to be chosen afterwards.
const CHOOSING_PART: f64 = 0.35;

/// Interval between checkpoints, unless blocks take longer.
const KEEP_EVERY: Duration = Duration::from_secs(5);

/// Results of the measurement blocks so far.
pub(super) struct Measured {
    pub(super) blocks: Blocks,
    pub(super) errors: Vec<ImageSums>,
    /// First image of each candidate.
    pub(super) first: Vec<Option<Rendering>>,
}

impl Measured {
    /// Returns an empty result for `count` candidates.
    pub(super) fn none(count: usize, reference: &AccumulatedReference) -> Measured {
        Measured {
            blocks: Blocks::new(count),
            errors: vec![ImageSums::new(&reference.halves); count],
            first: (0..count).map(|_| None).collect(),
        }
    }
}

impl Workspace<'_, '_> {
    /// Measures blocks until the time is up, after those in `measured`, and stores checkpoints at intervals.
    pub(super) fn measure(
        &self,
        (layout, reference, left): (&Layout, &AccumulatedReference, &[(Knob, f64)]),
        mut measured: Measured,
    ) -> Result<Measured, CostError> {
        // Derive the number of blocks and the deadline
        let (least, most, until) = match self.experiment.target {
            Some(_) => (MIN_BLOCKS_FOR_A_TARGET, MIN_BLOCKS, CHOOSING_PART),
            None => (MIN_BLOCKS, MAX_BLOCKS, MEASURED_PART),
        };
        let until = until * self.experiment.budget;
        let protocol = Protocol {
            least,
            most,
            deadline: self.experiment.start + Duration::from_secs_f64(until),
            seed: 1,
        };
        let Measured {
            blocks,
            errors,
            first,
        } = &mut measured;
        let (mut longest, mut kept) = (0.0f64, None::<Instant>);
        // Measure one block: an image of every candidate
        while protocol.may_continue(blocks.count(), longest) {
            let seconds = blocks.add(protocol.seed, |candidate, block| {
                self.report_step("measure");
                let configuration = &layout.candidates[candidate].configuration;
                let (rendering, time) = self.render_image(configuration, layout.view, seed_of(block))?;
                errors[candidate].add(&reference.halves, &self.displayed(&rendering.image, layout.view));
                first[candidate].get_or_insert(rendering);
                Ok::<_, CostError>(time)
            })?;
            longest = longest.max(seconds);
            // Store a checkpoint
            if let Some(keep) = self.experiment.keep
                && kept.is_none_or(|kept| kept.elapsed() >= KEEP_EVERY)
            {
                let base = first[0].as_ref();
                let all = CheckpointData {
                    threads: self.experiment.threads,
                    target: self.experiment.target,
                    layout,
                    reference,
                    left,
                    blocks,
                    sums: errors,
                    checksum: base.map_or(0, |base| checksum(&base.image)),
                    spent: self.spent(),
                };
                keep(&all.bytes());
                kept = Some(Instant::now());
            }
        }
        Ok(measured)
    }

    /// Restores the measurements of an interrupted study. First images are rendered again; the base's checksum verifies
    /// that the scene is unchanged.
    pub(super) fn resumed(
        &self,
        layout: &Layout,
        unfinished: &StudyCheckpoint,
    ) -> Result<Measured, CostError> {
        let mut first = Vec::new();
        for candidate in &layout.candidates {
            self.report_step("resume");
            let (rendering, _) = self.render_image(&candidate.configuration, layout.view, seed_of(0))?;
            if first.is_empty() && checksum(&rendering.image) != unfinished.head.checksum {
                return Err(CostError::Other);
            }
            first.push(Some(rendering));
        }
        Ok(Measured {
            blocks: unfinished.head.blocks.clone(),
            errors: unfinished.sums.clone(),
            first,
        })
    }
}

/// Returns the random seed for the images of a block.
fn seed_of(block: usize) -> u32 {
    block as u32 + 1
}
