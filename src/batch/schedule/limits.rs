//! Memory of a batch, and the number of frames rendered concurrently within them.

use super::built_scene::{LoadedScene, SceneCaches};
use super::row_schedule::film_bytes;
use crate::batch::error::BatchError;
use crate::batch::memory::available_bytes;
use crate::batch::options::BatchOptions;
use crate::batch::plan::PlannedFrame;
use crate::render::{RenderSettings, TILE_SIDE};

/// Number of tiles per thread in flight, so that few threads are idle while a frame runs out of tiles.
const TILES_PER_THREAD: u64 = 8;
/// Largest number of pixels rendered concurrently; a single frame may have more.
const MAX_PIXELS: u64 = 1 << 25;

/// Returns the number of frames of a loaded scene that are rendered concurrently by `threads` threads.
///
/// # Errors
///
/// If the memory is too small for a single frame. Nothing is built by then.
pub(super) fn frames_at_once(
    options: &BatchOptions,
    plan: &PlannedFrame,
    (loaded, kept): (&LoadedScene, &SceneCaches),
    threads: usize,
) -> Result<usize, BatchError> {
    let settings = plan.request.resolved(&loaded.file.output)?.settings;
    let film = film_bytes(&loaded.film(&settings), options.time);
    let bytes = loaded.forecast(&plan.request);
    // Compare with the explicit limit, or with what is free now
    let (before, most) = match (options.max_memory, available_bytes()) {
        (Some(most), _) => (kept.bytes() + bytes.loaded + bytes.to_come, most),
        // Memory in use already is not part of the free memory.
        (None, Some(free)) => (bytes.to_come, free),
        (None, None) => (0, u64::MAX),
    };
    let fitting = most.saturating_sub(before) / film.max(1);
    if fitting > 0 {
        let at_once = frames_to_saturate(options, &settings, threads).min(fitting);
        return Ok(usize::try_from(at_once).unwrap_or(usize::MAX));
    }
    // Report that not even one frame fits
    let (image, needed) = (plan.name(), before + film);
    Err(match options.max_memory {
        Some(most) => BatchError::MaxMemory { image, needed, most },
        None => BatchError::FreeMemory {
            image,
            needed,
            free: most,
        },
    })
}

/// Returns the number of frames that keep all threads busy, plus one that renders while another is written.
fn frames_to_saturate(options: &BatchOptions, settings: &RenderSettings, threads: usize) -> u64 {
    if options.time.is_some() {
        // With a time limit, frames must not compete for the processors.
        return 1;
    }
    let [width, height] = [settings.width, settings.height].map(u64::from);
    let side = u64::from(TILE_SIDE);
    let tiles = width.div_ceil(side) * height.div_ceil(side);
    let busy = (TILES_PER_THREAD * threads as u64).div_ceil(tiles);
    (1 + busy).min((MAX_PIXELS / (width * height)).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_frames_run_concurrently_and_huge_ones_alone() {
        let options = BatchOptions::default();
        let at_once = |options: &BatchOptions, [width, height]: [u32; 2], threads| {
            let settings = RenderSettings {
                width,
                height,
                ..RenderSettings::default()
            };
            frames_to_saturate(options, &settings, threads)
        };
        assert_eq!(at_once(&options, [512, 512], 2), 2);
        // 80 tiles per frame, of which 64 threads want 512: 6.4 frames.
        assert_eq!(at_once(&options, [320, 256], 64), 1 + 7);
        assert_eq!(at_once(&options, [4096, 4096], 2), 2);
        assert_eq!(at_once(&options, [16384, 16384], 2), 1);
        let timed = BatchOptions {
            time: Some(1.0),
            ..options
        };
        assert_eq!(at_once(&timed, [512, 512], 2), 1);
    }
}
