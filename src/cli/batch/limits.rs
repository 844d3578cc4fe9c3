//! Limits of a batch, and the number of frames rendered concurrently within them.

use std::path::Path;

use whit::render::{RenderSettings, TILE_SIDE};
use whit::report::memory::{available_bytes, in_words};

use super::super::failure::Failure;
use super::built_scene::{LoadedScene, SceneCaches};
use super::plan::Plan;
use super::row_schedule::film_bytes;

/// Number of tiles per thread in flight, so that few threads are idle while a frame runs out of tiles.
const TILES_PER_THREAD: u64 = 8;
/// Largest number of pixels rendered concurrently; a single frame may have more.
const MAX_PIXELS: u64 = 1 << 25;

/// Limits on the rendering of frames.
#[derive(Clone, Copy)]
pub(super) struct Limits<'a> {
    /// Output folder of the batch.
    pub(super) out: &'a Path,
    /// Seconds after which finished parts of a frame are saved to disk.
    pub(super) checkpoint: f64,
    /// Seconds after which no more samples are taken; unlimited if absent.
    pub(super) time: Option<f64>,
    /// Bytes that all frames and scenes may take together; the free memory if absent.
    pub(super) max_memory: Option<u64>,
}

impl Limits<'_> {
    /// Returns the number of frames of a loaded scene that are rendered concurrently by `threads` threads.
    ///
    /// # Errors
    ///
    /// If the memory is too small for a single frame. Nothing is built by then.
    pub(super) fn frames_at_once(
        &self,
        plan: &Plan,
        (loaded, kept): (&LoadedScene, &SceneCaches),
        threads: usize,
    ) -> Result<usize, Failure> {
        let settings = plan.request.resolved(&loaded.file.output)?.settings;
        let film = film_bytes(&loaded.film(&settings), self.time);
        let bytes = loaded.forecast(&plan.request);
        // Compare with the explicit limit, or with what is free now
        let (before, most) = match (self.max_memory, available_bytes()) {
            (Some(most), _) => (kept.bytes() + bytes.loaded + bytes.to_come, most),
            // Memory in use already is not part of the free memory.
            (None, Some(free)) => (bytes.to_come, free),
            (None, None) => (0, u64::MAX),
        };
        let fitting = most.saturating_sub(before) / film.max(1);
        if fitting > 0 {
            let at_once = self.frames_to_saturate(&settings, threads).min(fitting);
            return Ok(usize::try_from(at_once).unwrap_or(usize::MAX));
        }
        // Report that not even one frame fits
        let (name, needed, most) = (plan.name(), in_words(before + film), in_words(most));
        let sentence = match self.max_memory {
            Some(_) => format!(
                "{name} is forecast to take {needed} of memory and may take {most}: give a larger `--max-memory` or a \
                 smaller `size`"
            ),
            None => format!(
                "{name} is forecast to take {needed} of memory in addition to its scene, and {most} are free: give a \
                 smaller `size`"
            ),
        };
        Err(Failure::Work(sentence))
    }

    /// Returns the number of frames that keep all threads busy, plus one that renders while another is written.
    fn frames_to_saturate(&self, settings: &RenderSettings, threads: usize) -> u64 {
        if self.time.is_some() {
            // With a time limit, frames must not compete for the processors.
            return 1;
        }
        let [width, height] = [settings.width, settings.height].map(u64::from);
        let side = u64::from(TILE_SIDE);
        let tiles = width.div_ceil(side) * height.div_ceil(side);
        let busy = (TILES_PER_THREAD * threads as u64).div_ceil(tiles);
        (1 + busy).min((MAX_PIXELS / (width * height)).max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_frames_run_concurrently_and_huge_ones_alone() {
        let limits = Limits {
            out: Path::new(""),
            checkpoint: 60.0,
            time: None,
            max_memory: None,
        };
        let at_once = |limits: &Limits, [width, height]: [u32; 2], threads| {
            let settings = RenderSettings {
                width,
                height,
                ..RenderSettings::default()
            };
            limits.frames_to_saturate(&settings, threads)
        };
        assert_eq!(at_once(&limits, [512, 512], 2), 2);
        // 80 tiles per frame, of which 64 threads want 512: 6.4 frames.
        assert_eq!(at_once(&limits, [320, 256], 64), 1 + 7);
        assert_eq!(at_once(&limits, [4096, 4096], 2), 2);
        assert_eq!(at_once(&limits, [16384, 16384], 2), 1);
        let timed = Limits {
            time: Some(1.0),
            ..limits
        };
        assert_eq!(at_once(&timed, [512, 512], 2), 1);
    }
}
