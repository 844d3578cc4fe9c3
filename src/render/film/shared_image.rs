//! Pixels of an image that tiles write directly when they are finished, which avoids a second copy.

use std::sync::{Mutex, PoisonError};

use super::super::tile::{TILE, Tile};

/// Pixels of the rectangle that tiles cover, which threads fill concurrently.
pub(in crate::render) struct SharedImage<'p> {
    /// Column and row of the first pixel, which are those of a tile.
    corner: [u32; 2],
    /// Number of columns of the rectangle.
    width: usize,
    /// Pixels of each row of tiles.
    bands: Vec<Mutex<&'p mut [[f32; 3]]>>,
}

impl<'p> SharedImage<'p> {
    /// Divides the pixels of a rectangle into bands that can be written concurrently.
    pub(in crate::render) fn over(
        pixels: &'p mut [[f32; 3]],
        corner: [u32; 2],
        width: u32,
    ) -> SharedImage<'p> {
        let width = width as usize;
        SharedImage {
            corner,
            width,
            bands: pixels.chunks_mut(width * TILE as usize).map(Mutex::new).collect(),
        }
    }

    /// Writes the pixels of a tile, row by row.
    pub(in crate::render) fn put(&self, tile: Tile, means: &[[f32; 3]]) {
        // Find the rows and the first column
        let [left, top] = self.corner;
        let column = (tile.x - left) as usize;
        let band = &self.bands[((tile.y - top) / TILE) as usize];
        let mut band = band.lock().unwrap_or_else(PoisonError::into_inner);
        // Copy the tile row by row
        let rows = band.chunks_mut(self.width);
        for (row, means) in rows.zip(means.chunks(tile.width as usize)) {
            row[column..column + means.len()].copy_from_slice(means);
        }
    }
}
