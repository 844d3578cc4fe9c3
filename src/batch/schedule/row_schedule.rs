//! Number of rows of a frame rendered at a time: bounds the memory of images of any size.

use std::ops::Range;

use crate::batch::memory;
use crate::render::{RenderSettings, TILE_SIDE};

/// Number of tiles per thread in the first step, from whose time the later steps are estimated.
const FIRST_TILES: usize = 8;
/// Largest number of bytes of finished rows in memory; further rows go to disk. A step of rows in progress takes no
/// more.
pub(super) const MAX_BUFFERED_BYTES: usize = 1 << 28;

/// Returns whether the image must be rendered at once: its pixels depend on each other, or on the time of rendering.
pub(super) fn must_render_at_once(settings: &RenderSettings) -> bool {
    settings.adaptive.is_some() || settings.cost_aovs
}

/// Returns the bytes that an image takes in memory until it is written; `time` is the time limit of the frame, if any.
pub(super) fn film_bytes(film: &Film, time: Option<f64>) -> u64 {
    let whole = film.bytes_of(film.settings.height);
    if must_render_at_once(&film.settings) || time.is_some() {
        return whole;
    }
    // Count the rows in progress, the buffered rows, and the step that may exceed the buffer before it is flushed.
    whole.min(2 * film.bytes_of(film.max_rows_per_step()) + MAX_BUFFERED_BYTES as u64)
}

/// Parameters of a frame's memory.
pub(super) struct Film {
    pub(super) settings: RenderSettings,
    /// Number of lights of the scene, which may have layers of their own.
    pub(super) light_count: usize,
}

impl Film {
    fn bytes_of(&self, rows: u32) -> u64 {
        let pixels = u64::from(self.settings.width) * u64::from(rows);
        let of_pixel = self.settings.sampling_bytes_per_pixel(self.light_count);
        memory::film_bytes(self.settings.width, rows) + of_pixel * pixels
    }

    /// Returns the largest number of rows in a step, a multiple of the tile height.
    fn max_rows_per_step(&self) -> u32 {
        let fitting = MAX_BUFFERED_BYTES as u64 / self.bytes_of(TILE_SIDE);
        let rows = fitting.max(1).saturating_mul(u64::from(TILE_SIDE));
        u32::try_from(rows).unwrap_or(u32::MAX / TILE_SIDE * TILE_SIDE)
    }
}

/// Iterator over steps of rows: few rows at first, then as many as fit into half the checkpoint interval.
pub(super) struct RowSteps {
    rows: Range<u32>,
    step: u32,
    most: u32,
    seconds: f64,
}

impl RowSteps {
    /// Returns the steps through `row_schedule`, for an interval of `checkpoint` seconds.
    pub(super) fn new(rows: Range<u32>, film: &Film, checkpoint: f64) -> RowSteps {
        let columns = film.settings.width.div_ceil(TILE_SIDE) as usize;
        let tiles = FIRST_TILES * rayon::current_num_threads();
        let most = film.max_rows_per_step();
        RowSteps {
            rows,
            step: most.min(TILE_SIDE * tiles.div_ceil(columns) as u32),
            most,
            // Half the interval, so that at most half of the unsaved work is in progress.
            seconds: 0.5 * checkpoint,
        }
    }

    /// Returns the rows of the next step, or `None` at the end.
    pub(super) fn next(&mut self) -> Option<Range<u32>> {
        let start = self.rows.start;
        // Steps end at edges of tiles, so that no tile is rendered twice.
        let edge = (start / TILE_SIDE * TILE_SIDE).saturating_add(self.step);
        let end = edge.min(self.rows.end);
        self.rows.start = end;
        (start < end).then_some(start..end)
    }

    /// Adapts the size of the next steps to the seconds that the step of `row_schedule` took.
    pub(super) fn adapt(&mut self, rows: &Range<u32>, seconds: f64) {
        let of_row = seconds / f64::from(rows.end - rows.start);
        let fitting = (self.seconds / of_row.max(f64::MIN_POSITIVE)).min(f64::from(self.most)) as u32;
        self.step = (fitting / TILE_SIDE * TILE_SIDE).max(TILE_SIDE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(width: u32, height: u32) -> Film {
        Film {
            settings: RenderSettings {
                width,
                height,
                ..RenderSettings::default()
            },
            light_count: 0,
        }
    }

    #[test]
    fn steps_cover_every_row_once_in_whole_tiles() {
        let mut steps = RowSteps::new(5..1000, &film(100, 1000), 60.0);
        let mut end = 5;
        while let Some(rows) = steps.next() {
            assert_eq!(rows.start, end);
            assert!(rows.end == 1000 || rows.end.is_multiple_of(TILE_SIDE));
            end = rows.end;
            steps.adapt(&rows, 1e-3);
        }
        assert_eq!(end, 1000);
    }

    #[test]
    fn step_size_adapts_between_one_tile_and_the_memory_limit() {
        let wide = film(1 << 14, 1 << 20);
        let mut steps = RowSteps::new(0..1 << 20, &wide, 60.0);
        let rows = steps.next().unwrap();
        steps.adapt(&rows, 1e9);
        let slow = steps.next().unwrap();
        assert_eq!(slow.end - slow.start, TILE_SIDE);
        steps.adapt(&slow, 0.0);
        let fast = steps.next().unwrap();
        assert_eq!(fast.end - fast.start, wide.max_rows_per_step());
        let bytes = wide.bytes_of(fast.end - fast.start);
        assert!(
            (MAX_BUFFERED_BYTES as u64 / 2..=MAX_BUFFERED_BYTES as u64).contains(&bytes),
            "{bytes}"
        );
    }

    #[test]
    fn huge_image_takes_little_memory_unless_rendered_at_once() {
        let huge = film(1 << 17, 1 << 17);
        assert!(film_bytes(&huge, None) <= 3 * MAX_BUFFERED_BYTES as u64);
        assert_eq!(film_bytes(&huge, Some(1.0)), huge.bytes_of(1 << 17));
        let mut costly = film(1 << 17, 1 << 17);
        costly.settings.cost_aovs = true;
        assert_eq!(film_bytes(&costly, None), costly.bytes_of(1 << 17));
        let small = film(64, 64);
        assert_eq!(film_bytes(&small, None), small.bytes_of(64));
    }

    #[test]
    fn light_layers_count_towards_the_film_memory() {
        let mut lit = film(64, 64);
        let plain = lit.bytes_of(64);
        lit.light_count = 1000;
        assert_eq!(lit.bytes_of(64), plain);
        lit.settings.light_layers.lights = true;
        // Each light has three channels of f32 at least.
        assert!(lit.bytes_of(64) > plain + 1000 * 3 * 4 * 64 * 64);
    }
}
