//! Tiles that are needed to render a rectangle of an image.

use super::super::film::TileResult;
use super::super::settings::RenderSettings;
use super::super::tile::{TILE, Tile, tiles_among};
use super::region::Region;

/// Tiles that are needed to render a rectangle.
pub(in crate::render) struct Cover {
    /// Rectangle that the tiles cover.
    outer: Region,
    inner: Region,
    /// Tiles in row-major order.
    pub(in crate::render) tiles: Vec<Tile>,
}

impl Cover {
    /// Returns the tiles of a rectangle, with a border of one tile if the filter needs neighbours.
    pub(in crate::render) fn of(region: &Region, settings: &RenderSettings) -> Cover {
        Cover::with_border(region, settings, u32::from(settings.reach() > 0))
    }

    /// Returns the tiles of a rectangle, with a border of `margin` tiles.
    pub(in crate::render) fn with_border(region: &Region, settings: &RenderSettings, margin: u32) -> Cover {
        let along = |start: u32, size: u32, end: u32| {
            let first = (start / TILE).saturating_sub(margin);
            let last = ((start + size).div_ceil(TILE) + margin).min(end.div_ceil(TILE));
            (first..last, first * TILE, (last * TILE).min(end) - first * TILE)
        };
        let (columns, x, width) = along(region.x, region.width, settings.width);
        let (rows, y, height) = along(region.y, region.height, settings.height);
        Cover {
            outer: Region { x, y, width, height },
            inner: *region,
            tiles: tiles_among([settings.width, settings.height], [columns, rows]),
        }
    }

    /// Returns the first column and row of the rectangle that the tiles cover.
    pub(in crate::render) fn corner(&self) -> [u32; 2] {
        [self.outer.x, self.outer.y]
    }

    /// Returns the index of a pixel of the image in the rectangle that the tiles cover, row by row.
    pub(in crate::render) fn index(&self, [x, y]: [u32; 2]) -> usize {
        (y - self.outer.y) as usize * self.outer.width as usize + (x - self.outer.x) as usize
    }

    /// Returns the width and height of the rectangle that the tiles cover.
    pub(in crate::render) fn size(&self) -> [u32; 2] {
        [self.outer.width, self.outer.height]
    }

    /// Returns the tiles with positions relative to the rectangle that they cover.
    pub(in crate::render) fn placed(&self, mut tiles: Vec<(Tile, TileResult)>) -> Vec<(Tile, TileResult)> {
        for (tile, _) in &mut tiles {
            tile.x -= self.outer.x;
            tile.y -= self.outer.y;
        }
        tiles
    }

    /// Crops values of the pixels that the tiles cover to the rectangle.
    pub(in crate::render) fn cut<T: Copy>(&self, values: Vec<T>) -> Vec<T> {
        if self.outer == self.inner {
            return values;
        }
        let (inner, outer) = (&self.inner, &self.outer);
        let first = (inner.x - outer.x) as usize;
        values
            .chunks(outer.width as usize)
            .skip((inner.y - outer.y) as usize)
            .take(inner.height as usize)
            .flat_map(|row| &row[first..first + inner.width as usize])
            .copied()
            .collect()
    }
}
