//! Progress, cancellation and finished tiles of a long render, for its caller.

use std::sync::atomic::{AtomicBool, Ordering};

use super::film::PixelStatistics;
use super::subset::Patch;
use super::tile::Tile;

/// Callbacks and cancellation flag that connect a render with its caller.
///
/// Construct it with `..Monitor::default()`: further fields may be added.
#[derive(Clone, Copy)]
pub struct Monitor<'a> {
    /// Callback that receives the finished fraction, from any thread.
    pub progress: &'a (dyn Fn(f64) + Sync),
    /// Flag that stops the render when it is set.
    pub cancel: &'a AtomicBool,
    /// Callback that receives each tile as soon as it is finished, from any thread; with adaptive sampling, after
    /// every round that added samples to it.
    pub tiles: Option<&'a (dyn Fn(FinishedTile) + Sync)>,
}

/// Error of a render that [`Monitor::cancel`] or [`Checkpoints::keep`](super::Checkpoints::keep) ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the render was cancelled")]
pub struct Cancelled;

/// Finished part of the image in its current state: a filter may still add samples of neighbouring tiles, and
/// adaptive sampling further rounds.
#[derive(Clone, Copy, Debug)]
pub struct FinishedTile<'a> {
    /// First column in the image.
    pub x: u32,
    /// First row in the image.
    pub y: u32,
    /// Number of columns in `pixels`.
    pub width: u32,
    /// Number of rows in `pixels`.
    pub height: u32,
    /// Linear RGB radiance, `width * height` pixels, row by row from the top.
    pub pixels: &'a [[f32; 3]],
}

impl Default for Monitor<'_> {
    /// Returns a monitor that reports nothing and never cancels.
    fn default() -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Monitor {
            progress: &|_| {},
            cancel: &NEVER,
            tiles: None,
        }
    }
}

impl Monitor<'_> {
    /// Returns an error if the render is to stop.
    pub(super) fn check(&self) -> Result<(), Cancelled> {
        match self.cancel.load(Ordering::Relaxed) {
            true => Err(Cancelled),
            false => Ok(()),
        }
    }

    /// Passes the means of a tile to the callback, if there is one.
    pub(super) fn show(&self, tile: Tile, means: &[[f32; 3]]) {
        if let Some(show) = self.tiles {
            show(FinishedTile {
                x: tile.x,
                y: tile.y,
                width: tile.width,
                height: tile.height,
                pixels: means,
            });
        }
    }

    /// Passes the means of the pixels of a site to the callback; `estimates` are those of the whole canvas with
    /// `columns` columns.
    pub(super) fn show_estimates(
        &self,
        Patch { tile, at }: Patch,
        estimates: &[PixelStatistics],
        columns: usize,
    ) {
        if self.tiles.is_none() {
            return;
        }
        // Collect the rows of the site from the canvas
        let row = |y: usize| {
            let first = (at[1] + y) * columns + at[0];
            &estimates[first..first + tile.width as usize]
        };
        let means: Vec<[f32; 3]> = (0..tile.height as usize)
            .flat_map(row)
            .map(|estimate| estimate.mean().map(|channel| channel as f32))
            .collect();
        self.show(tile, &means);
    }
}
