//! Part of the image that a measurement renders.

use super::DisplayImage;
use crate::render::PatchGrid;

/// Part of the image that a measurement renders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum View {
    /// Complete image at this width and height.
    Whole([u32; 2]),
    /// Patches of the image at its full width and height.
    Patches(PatchGrid),
}

impl View {
    /// Returns `displayed` with the blocks for resampling: one per patch where the view shows patches.
    pub(super) fn with_blocks(self, displayed: DisplayImage) -> DisplayImage {
        match self {
            View::Whole(_) => displayed,
            View::Patches(mosaic) => displayed.with_block_columns(mosaic.columns),
        }
    }
}

/// Returns the number of pixels of an image.
pub(super) fn area([width, height]: [u32; 2]) -> f64 {
    f64::from(width) * f64::from(height)
}
