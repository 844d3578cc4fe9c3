//! Text of a batch: the forecast of its frames, and the summary at its end.

use std::fmt;

use super::forecast::Forecast;
use crate::batch::memory::in_words;
use crate::batch::{BatchOutcome, FrameCost, PlannedFrame};

/// Forecast of a batch on a number of threads. The text form lists the frames, and the totals.
pub struct BatchForecast<'p> {
    /// Planned frames of the batch.
    pub plans: &'p [PlannedFrame],
    /// Costs of each planned frame.
    pub costs: Vec<FrameCost>,
    /// Number of threads that render.
    pub threads: usize,
}

impl BatchForecast<'_> {
    /// Returns the planned frames with their costs and their seconds of rendering.
    fn frames(&self) -> impl Iterator<Item = (&PlannedFrame, &FrameCost, f64)> {
        self.plans.iter().zip(&self.costs).map(|(plan, cost)| {
            let forecast = Forecast::of(&cost.probe, &cost.settings, cost.backend);
            // Costs are processor times, divided evenly among the threads here
            (plan, cost, forecast.seconds / self.threads as f64)
        })
    }

    /// Returns the seconds of the slowest of several shards. Each loads the scenes of its own frames; in the worst case
    /// it loads one more than its share, the slowest.
    pub fn shard_seconds(&self, shards: u32) -> f64 {
        let shards = f64::from(shards);
        let rendering: f64 = self.frames().map(|(_, _, seconds)| seconds).sum();
        let setup_seconds: f64 = self.costs.iter().map(|cost| cost.setup_seconds).sum::<f64>() / shards;
        let slowest = self
            .costs
            .iter()
            .map(|cost| cost.setup_seconds)
            .fold(0.0, f64::max);
        rendering / shards + setup_seconds + slowest
    }

    /// Returns the bytes of the frame that takes the most.
    pub fn max_bytes(&self) -> u64 {
        self.costs.iter().map(|cost| cost.bytes).max().unwrap_or(0)
    }
}

impl fmt::Display for BatchForecast<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // Print one line per frame
        let mut total = 0.0;
        for (plan, cost, seconds) in self.frames() {
            total += seconds + cost.setup_seconds;
            write!(f, "{}: {}", plan.name(), plan.frame.scene.display())?;
            if let Some(camera) = &plan.frame.camera {
                write!(f, ", camera {camera}")?;
            }
            for edit in &plan.frame.edits {
                write!(f, ", {edit}")?;
            }
            writeln!(
                f,
                ", {}x{}, {} samples per pixel: about {seconds:.2} s, {}",
                cost.settings.width,
                cost.settings.height,
                cost.settings.spp,
                in_words(cost.bytes)
            )?;
        }
        // Print the totals
        writeln!(
            f,
            "{} frames: about {} on {} threads, up to {}",
            self.plans.len(),
            duration(total),
            self.threads,
            in_words(self.max_bytes())
        )
    }
}

/// Summary of a batch: the counts of its frames, and what was shared among them.
pub struct BatchSummary<'o>(pub &'o BatchOutcome);

impl fmt::Display for BatchSummary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let outcome = self.0;
        writeln!(
            f,
            "{} frames in {:.1} s: {} existed already, {} failed",
            outcome.total, outcome.seconds, outcome.skipped, outcome.failed
        )?;
        if outcome.reusing_frames > 0 {
            writeln!(
                f,
                "{} frames reused a loaded scene and its acceleration structure, which saved {:.1} s",
                outcome.reusing_frames, outcome.saved_seconds
            )?;
        }
        let (images, meshes) = (outcome.images, outcome.meshes);
        for (found, requested, what) in [
            (images.found, images.lookups, "images"),
            (meshes.found, meshes.requested, "built meshes"),
        ] {
            if found > 0 {
                writeln!(
                    f,
                    "{found} of {requested} {what} were reused from a previous scene"
                )?;
            }
        }
        Ok(())
    }
}

/// Returns a duration in hours, minutes or seconds with one decimal.
fn duration(seconds: f64) -> String {
    const MINUTE: f64 = 60.0;
    const HOUR: f64 = 3600.0;
    match seconds {
        seconds if seconds >= HOUR => format!("{:.1} h", seconds / HOUR),
        seconds if seconds >= MINUTE => format!("{:.1} min", seconds / MINUTE),
        seconds => format!("{seconds:.1} s"),
    }
}
