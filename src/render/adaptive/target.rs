//! Target of adaptive sampling, and the number of samples in its first round.

use crate::numeric::LANES;

/// Smallest number of samples per pixel: a full packet.
pub(in crate::render) const ROUND: u32 = LANES as u32;

/// Smallest target error, as a display value: the largest number of samples, 2^16, has an error of σ / n^¾, which is
/// 2^-20 for σ = 2^-8, one 8-bit code. A smaller target is out of reach for all pixels but uniform ones; the others
/// would only take the largest number of samples.
pub const MIN_ADAPTIVE_ERROR: f64 = 1e-6;

/// Stopping criterion of adaptive sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adaptive {
    /// Target for the standard error of a pixel's mean, as a display value: 0 is black, 1 is white, an 8-bit code is
    /// 1/255. More than 0. It is estimated for stratified samples, on a curve close to that of sRGB.
    pub error: f64,
    /// Factor on radiance before display: 2 to the power of the exposure.
    pub gain: f64,
}
