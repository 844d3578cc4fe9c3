//! Scene to measure, and options of `whit bench`: threads, acceleration structures and repetitions.

use rayon::ThreadPool;

use super::error::{BenchError, check};
use crate::accel::AccelOptions;
use crate::measure::{Blocks, Observer, Protocol, TurnTime};
use crate::render::RenderSettings;
use crate::scene::{Camera, ValidScene};

/// Seed of the random order within blocks.
const SEED: u64 = 1;

/// Scene to measure, with the image that its rays belong to.
#[derive(Clone, Copy)]
pub struct MeasuredScene<'s> {
    /// Name of the scene in the results: its path as the user gave it.
    pub name: &'s str,
    /// Scene with all rays and effects of the image.
    pub scene: ValidScene<'s>,
    /// Camera of the image.
    pub camera: &'s Camera,
    /// Render settings of the image.
    pub settings: RenderSettings,
}

/// Options of `whit bench`: threads, acceleration structures and repetitions.
#[derive(Clone, Copy)]
pub struct BenchOptions<'a> {
    /// Options of the acceleration structures that are listed first.
    pub accel: &'a AccelOptions<'a>,
    /// Whether Embree is measured at the other precisions, too.
    pub all_precisions: bool,
    /// Number of repetitions, at least 1.
    pub repeat: usize,
    /// Threads that build the structures.
    pub pool: &'a ThreadPool,
    /// Thread pools of the scaling measurement, fewest threads first; may be empty.
    pub scaling: &'a [ThreadPool],
    /// Progress and cancellation of the measurement.
    pub observer: &'a Observer<'a>,
}

impl BenchOptions<'_> {
    /// Measures `candidates` candidates, each once per repetition, in `parts` parts between which all others have their
    /// turns, so that a change of the machine's speed affects all alike: `turn` receives the candidate and the part, and
    /// returns the time.
    pub(super) fn blocks(
        &self,
        step: &str,
        (candidates, parts): (usize, usize),
        mut turn: impl FnMut(usize, usize) -> Result<TurnTime, BenchError>,
    ) -> Result<Blocks, BenchError> {
        let protocol = Protocol::of_blocks(self.repeat * parts, SEED);
        let progress = |fraction| (self.observer.progress)(step, fraction);
        let blocks = Blocks::measure(candidates, &protocol, &progress, |candidate, block| {
            check(self.observer)?;
            turn(candidate, block % parts)
        })?;
        Ok(blocks.summed(parts))
    }
}
