//! Contrast limit above which pixels take all samples.

use super::super::automatic_exposure::Exposure;

/// Smallest contrast limit, as a displayed value: a quarter of an 8-bit code.
pub const MIN_EDGE_CONTRAST: f64 = 0.001;
/// Contrast above which a pixel takes all samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeContrast {
    /// Largest difference from a neighbour, in any channel as displayed, of a pixel that takes a single sample: 0 is
    /// black, 1 is white, an 8-bit code is 1/255. More than 0. The curve is close to that of sRGB.
    pub limit: f64,
    /// Exposure before display. An automatic one is chosen from the first samples of what is rendered.
    pub exposure: Exposure,
}
