//! Rectangle of pixels of an image.

use std::ops::Range;

use super::super::settings::RenderSettings;

/// Rectangle of pixels of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First column of the rectangle.
    pub x: u32,
    /// First row of the rectangle.
    pub y: u32,
    /// Number of columns; at least 1.
    pub width: u32,
    /// Number of rows; at least 1.
    pub height: u32,
}

impl Region {
    /// Returns the rectangle of the whole image.
    pub fn whole(settings: &RenderSettings) -> Region {
        Region::of_rows(settings, 0..settings.height)
    }

    /// Returns the rectangle of some complete rows of an image.
    pub fn of_rows(settings: &RenderSettings, rows: Range<u32>) -> Region {
        Region {
            x: 0,
            y: rows.start,
            width: settings.width,
            height: rows.end - rows.start,
        }
    }

    /// Returns whether the rectangle contains a pixel of the image.
    pub(in crate::render) fn contains(&self, [x, y]: [u32; 2]) -> bool {
        (self.x..self.x + self.width).contains(&x) && (self.y..self.y + self.height).contains(&y)
    }

    /// Returns the number of pixels of the rectangle.
    pub fn pixel_count(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}
