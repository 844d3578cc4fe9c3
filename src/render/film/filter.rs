//! Pixel reconstruction filters.
//!
//! A pixel is the weighted mean of the samples near its centre, `Σ w(s - p) L(s) / Σ w(s - p)`, so that a constant
//! image stays constant for any weights. Each tile adds its samples to a film of its own, which extends over the
//! tile's edges by the filter radius; these films are then added to the image in the order of the tiles. No sample is
//! traced twice: a border of samples around every tile would cost (36/32)² = 1.27 times the rays at radius 2. The
//! order of all sums depends on the image alone, because the tile grid is fixed. Filter importance sampling, which
//! chooses sample positions instead, cannot handle negative lobes and loses the samples of neighbours, which
//! increases noise.

use super::super::tile::TILE;
use crate::scene::image_settings::{FilterKind, MAX_FILTER_RADIUS, MIN_FILTER_RADIUS};

/// Reconstruction filter: kernel and radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelFilter {
    /// Kernel of the filter.
    pub kind: FilterKind,
    /// Distance in pixels from the centre of a pixel, horizontally and vertically, from which on samples do not
    /// count; from [`PixelFilter::MIN_RADIUS`] to [`PixelFilter::MAX_RADIUS`]. A box always covers the pixel itself.
    pub radius: f64,
}

impl Default for PixelFilter {
    fn default() -> PixelFilter {
        PixelFilter::of_kind(FilterKind::Box)
    }
}

impl PixelFilter {
    /// Smallest radius of a filter, in pixels.
    pub const MIN_RADIUS: f64 = MIN_FILTER_RADIUS;
    /// Largest radius of a filter, in pixels.
    pub const MAX_RADIUS: f64 = MAX_FILTER_RADIUS;

    /// Returns the filter of that kind with its default radius.
    pub fn of_kind(kind: FilterKind) -> PixelFilter {
        let radius = match kind {
            FilterKind::Box => 0.5,
            FilterKind::Tent => 1.0,
            FilterKind::Gaussian => 1.5,
            FilterKind::Mitchell => 2.0,
        };
        PixelFilter { kind, radius }
    }

    /// Returns the bytes per pixel that the films of all tiles use.
    pub(in crate::render) fn bytes_per_pixel(&self) -> u64 {
        if self.is_box() {
            return 0;
        }
        let side = TILE as usize + 2 * self.reach();
        (side * side * size_of::<[f64; 4]>()).div_ceil((TILE * TILE) as usize) as u64
    }

    /// Returns whether samples count equally and for their own pixel only.
    pub(crate) fn is_box(&self) -> bool {
        self.kind == FilterKind::Box
    }

    /// Returns the weight of a sample at distance `x` from the centre of a pixel, along one axis.
    pub(in crate::render) fn weight(&self, x: f64) -> f64 {
        let x = x.abs();
        if x >= self.radius {
            return 0.0;
        }
        match self.kind {
            FilterKind::Box => 1.0,
            FilterKind::Tent => 1.0 - x / self.radius,
            FilterKind::Gaussian => {
                /// Exponent 1/2 (radius / sigma)² for a radius of three sigma.
                const FALL: f64 = 4.5;
                let ratio = x / self.radius;
                (-FALL * ratio * ratio).exp() - (-FALL).exp()
            }
            FilterKind::Mitchell => mitchell(2.0 * x / self.radius),
        }
    }

    /// Returns how many pixels to each side of its own a sample may affect.
    pub(in crate::render) fn reach(&self) -> usize {
        // A sample lies up to half a pixel from the centre of its pixel; samples exactly `radius` away do not count.
        (self.radius.clamp(0.5, PixelFilter::MAX_RADIUS) - 0.5).ceil() as usize
    }
}

/// Evaluates the filter of Mitchell and Netravali with B = C = 1/3, for `x` in [0, 2] ("Reconstruction filters in
/// computer graphics", SIGGRAPH 1988, equation 8).
fn mitchell(x: f64) -> f64 {
    if x < 1.0 {
        (7.0 * x * x * x - 12.0 * x * x + 16.0 / 3.0) / 6.0
    } else {
        (-7.0 / 3.0 * x * x * x + 12.0 * x * x - 20.0 * x + 32.0 / 3.0) / 6.0
    }
}

/// Returns the filters that tests use: every kernel at its default radius, and the widest one.
#[cfg(test)]
pub(in crate::render) fn filters() -> Vec<PixelFilter> {
    let usual = [
        FilterKind::Box,
        FilterKind::Tent,
        FilterKind::Gaussian,
        FilterKind::Mitchell,
    ]
    .iter()
    .copied()
    .map(PixelFilter::of_kind);
    let widest = PixelFilter {
        kind: FilterKind::Mitchell,
        radius: PixelFilter::MAX_RADIUS,
    };
    usual.chain([widest]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filter_weights_equal_published_values() {
        let of = |kind, x| PixelFilter::of_kind(kind).weight(x);
        assert_eq!([0.0, 0.49, 0.5].map(|x| of(FilterKind::Box, x)), [1.0, 1.0, 0.0]);
        assert_eq!(
            [0.0, 0.25, -0.25, 1.0].map(|x| of(FilterKind::Tent, x)),
            [1.0, 0.75, 0.75, 0.0]
        );
        // exp(-1/2) - exp(-9/2) at one sigma = 0.5, half a pixel.
        let bell = (-0.5f64).exp() - (-4.5f64).exp();
        assert!((of(FilterKind::Gaussian, 0.5) - bell).abs() < 1e-15);
        // B = C = 1/3: 8/9 at the centre, 1/18 at 1, and at 1.5: (-7.875 + 27 - 30 + 10.667) / 6 = -0.034722.
        let close = |x, expected: f64| (of(FilterKind::Mitchell, x) - expected).abs() < 1e-14;
        assert!(close(0.0, 8.0 / 9.0) && close(1.0, 1.0 / 18.0) && close(1.5, -5.0 / 144.0));
        assert_eq!(of(FilterKind::Mitchell, 2.0), 0.0);
    }
}
