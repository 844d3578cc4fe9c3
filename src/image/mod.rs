//! Placeholder.

/// Linear RGB radiance, top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearImage {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Linear RGB.
    pub pixels: Vec<[f32; 3]>,
}
