//! Pixel grid on which patches of an image lie side by side, or all tiles at their positions in the image.

use super::super::settings::RenderSettings;
use super::super::tile::{Tile, tiles};

/// Layout of patches on a common pixel grid, one empty row and column of pixels apart.
pub(in crate::render) struct PatchAtlas {
    /// Numbers of columns and rows of pixels.
    pub(in crate::render) size: [usize; 2],
    pub(in crate::render) sites: Vec<Patch>,
}

/// Patch of the image and its position on the canvas.
#[derive(Clone, Copy)]
pub(in crate::render) struct Patch {
    pub(in crate::render) tile: Tile,
    /// Column and row of the patch's first pixel on the canvas.
    pub(in crate::render) at: [usize; 2],
}

impl PatchAtlas {
    /// Returns the whole image, with every tile at its own position.
    pub(in crate::render) fn whole(settings: &RenderSettings) -> PatchAtlas {
        let RenderSettings { width, height, .. } = *settings;
        let grid_position = |tile: Tile| Patch {
            tile,
            at: [tile.x as usize, tile.y as usize],
        };
        PatchAtlas {
            size: [width as usize, height as usize],
            sites: tiles(width, height).into_iter().map(grid_position).collect(),
        }
    }
}
