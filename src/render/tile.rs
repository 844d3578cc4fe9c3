//! Tiles of an image: rectangles of pixels that one task renders, and the parts of them that are sampled.

use std::ops::Range;

/// Side of a tile in pixels: its film (24 KB) stays in the L2 cache, and there are enough tiles to distribute among
/// threads.
pub(super) const TILE: u32 = 32;

/// Side of the tiles that images are rendered in: rectangles that are aligned to it cause no extra work.
pub const TILE_SIDE: u32 = TILE;

/// Rectangle of pixels that one task renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// Returns the tiles of an image, row by row.
pub(super) fn tiles(width: u32, height: u32) -> Vec<Tile> {
    tiles_among(
        [width, height],
        [0..width.div_ceil(TILE), 0..height.div_ceil(TILE)],
    )
}

/// Returns the tiles of an image of `size` in the given columns and rows of tiles, row by row.
pub(super) fn tiles_among([width, height]: [u32; 2], [columns, rows]: [Range<u32>; 2]) -> Vec<Tile> {
    let starts = |places: &Range<u32>| places.clone().map(|place| place * TILE);
    starts(&rows)
        .flat_map(|y| {
            starts(&columns).map(move |x| Tile {
                x,
                y,
                width: TILE.min(width - x),
                height: TILE.min(height - y),
            })
        })
        .collect()
}

/// Range of sample packets for one pixel.
pub(super) struct PixelVisit {
    /// Column within the tile.
    pub(super) x: u32,
    /// Row within the tile.
    pub(super) y: u32,
    /// Range of indices into the sample groups of the frame.
    pub(super) groups: Range<u32>,
}

/// Block of pixels that one packet covers.
pub(super) struct Block {
    pub(super) tile: Tile,
    /// Column and row of the first pixel of the block, within the tile.
    pub(super) corner: (u32, u32),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_every_pixel_once() {
        for (width, height) in [(1, 1), (32, 32), (33, 65), (17, 3)] {
            let mut covered = vec![0; (width * height) as usize];
            for tile in tiles(width, height) {
                for y in tile.y..tile.y + tile.height {
                    for x in tile.x..tile.x + tile.width {
                        covered[(y * width + x) as usize] += 1;
                    }
                }
            }
            assert!(covered.iter().all(|&count| count == 1));
        }
    }
}
