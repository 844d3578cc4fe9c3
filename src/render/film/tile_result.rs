//! Pixels of rendered tiles, and images assembled from them.

use super::super::tile::{TILE, Tile};
use super::pixel_statistics::PixelStatistics;
use super::splat::Splat;
use crate::parallel;

/// Pixels of one tile, row by row.
pub(in crate::render) struct TileResult {
    /// Means of the samples; empty once they are in a [`SharedImage`](super::SharedImage).
    pub(in crate::render) means: Vec<[f32; 3]>,
    /// Sums behind the means, if partial images are to be added.
    pub(in crate::render) sums: Vec<[f64; 3]>,
    /// Filtered sums for this and neighbouring pixels, if the filter is not a box.
    pub(in crate::render) splat: Option<Splat>,
    /// Sample statistics of each pixel, if requested.
    pub(in crate::render) estimates: Vec<PixelStatistics>,
    /// Film of the transparency of the pixels, if the background is transparent.
    pub(in crate::render) transparency: Option<Box<TileResult>>,
}

/// Assembles an image of the data that `part` selects from tiles, which must be in the order of
/// [`crate::render::tile::tiles`].
pub(in crate::render) fn assemble<T: Copy + Default + Send + Sync>(
    width: u32,
    height: u32,
    tiles: &[(Tile, TileResult)],
    part: &(dyn Fn(&TileResult) -> &Vec<T> + Sync),
) -> Vec<T> {
    let width_in_tiles = width.div_ceil(TILE) as usize;
    let mut pixels = vec![T::default(); width as usize * height as usize];
    // Copy each row of tiles into its band of the image, in parallel
    let rows_of_tiles: Vec<&[(Tile, TileResult)]> = tiles.chunks(width_in_tiles).collect();
    parallel::for_each_chunk_mut(&mut pixels, width as usize * TILE as usize, &|index, band| {
        for (tile, result) in rows_of_tiles[index] {
            for (row, part) in part(result).chunks(tile.width as usize).enumerate() {
                let start = row * width as usize + tile.x as usize;
                band[start..start + part.len()].copy_from_slice(part);
            }
        }
    });
    pixels
}
