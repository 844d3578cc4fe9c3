//! How a long render talks to whoever waits for it: how far it is, and its tiles as they are finished.

use std::sync::atomic::AtomicBool;

use super::estimate::Estimate;
use super::film::Tile;
use super::mosaic::Site;

/// How a long render talks to whoever waits for it.
#[derive(Clone, Copy)]
pub struct Monitor<'a> {
    /// Told the finished fraction, from any thread.
    pub progress: &'a (dyn Fn(f64) + Sync),
    /// Set by anyone to stop the render.
    pub cancel: &'a AtomicBool,
    /// Shown each tile as soon as it is finished, from any thread; with adaptive sampling after every round that gave it
    /// samples.
    pub tiles: Option<&'a (dyn Fn(FinishedTile) + Sync)>,
}

/// A part of the picture as far as it is known: neighbours may yet add to it through a filter, and rounds of adaptive
/// sampling too.
#[derive(Clone, Copy, Debug)]
pub struct FinishedTile<'a> {
    /// Its first column in the picture.
    pub x: u32,
    /// Its first row in the picture.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear RGB radiance, `width * height` pixels, row by row, the top row first.
    pub pixels: &'a [[f32; 3]],
}

impl Monitor<'_> {
    /// Shows the means of a tile to whoever wants to see them.
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

    /// Shows what is known of the pixels of a site; `estimates` are those of the whole canvas, of so many columns.
    pub(super) fn show_estimates(&self, Site { tile, at }: Site, estimates: &[Estimate], columns: usize) {
        if self.tiles.is_none() {
            return;
        }
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
