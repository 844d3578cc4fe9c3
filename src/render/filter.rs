//! Pixel reconstruction filters.
//!
//! A pixel is the weighted mean of the samples near its centre, `Σ w(s - p) L(s) / Σ w(s - p)`, so that a constant
//! image stays constant for any weights. Each tile adds its samples to a film of its own, which extends over the
//! tile's edges by the filter radius; these films are then added to the image in the order of the tiles. No sample is
//! traced twice: a border of samples around every tile would cost (36/32)² = 1.27 times the rays at radius 2. The
//! order of all sums depends on the image alone, because the tile grid is fixed. Filter importance sampling, which
//! chooses sample positions instead, cannot handle negative lobes and loses the samples of neighbours, which
//! increases noise.

use super::film::{TILE, Tile};
use super::wave::TileResult;
use crate::parallel;
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
    pub(super) fn bytes_per_pixel(&self) -> u64 {
        if self.is_box() {
            return 0;
        }
        let side = TILE as usize + 2 * self.reach();
        (side * side * size_of::<[f64; 4]>()).div_ceil((TILE * TILE) as usize) as u64
    }

    /// Returns whether samples count equally and for their own pixel only.
    pub(super) fn is_box(&self) -> bool {
        self.kind == FilterKind::Box
    }

    /// Returns the weight of a sample at distance `x` from the centre of a pixel, along one axis.
    fn weight(&self, x: f64) -> f64 {
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
    pub(super) fn reach(&self) -> usize {
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

/// Largest number of pixels that a sample affects, along one axis.
const MAX_SPAN: usize = 9;

/// Weighted sums of the samples of a tile, for its own pixels and a border of their neighbours.
#[derive(Clone)]
pub(super) struct Splat {
    filter: PixelFilter,
    reach: usize,
    /// Red, green, blue and weight per pixel; a square of rows of `TILE + 2 reach` pixels.
    sums: Vec<[f64; 4]>,
}

impl Splat {
    /// Returns the bytes of the sums.
    pub(super) fn byte_count(&self) -> usize {
        size_of_val(&self.sums[..])
    }

    pub(super) fn new(filter: PixelFilter) -> Splat {
        let reach = filter.reach();
        let side = TILE as usize + 2 * reach;
        Splat {
            filter,
            reach,
            sums: vec![[0.0; 4]; side * side],
        }
    }

    pub(super) fn clear(&mut self) {
        self.sums.fill([0.0; 4]);
    }

    fn side(&self) -> usize {
        TILE as usize + 2 * self.reach
    }

    /// Adds a sample at `position` within pixel `pixel` of the tile, `TILE` pixels per row.
    pub(super) fn add(&mut self, pixel: u32, position: [f64; 2], radiance: [f64; 3]) {
        let (x, y) = ((pixel % TILE) as usize, (pixel / TILE) as usize);
        // Weights are separable, so compute them per axis
        let [across, down] = position.map(|p| self.weights(p));
        let span = 2 * self.reach + 1;
        for (row, wy) in down.iter().enumerate().take(span) {
            let start = (y + row) * self.side() + x;
            for (sum, wx) in self.sums[start..start + span].iter_mut().zip(&across) {
                let weight = wx * wy;
                for channel in 0..3 {
                    sum[channel] += weight * radiance[channel];
                }
                sum[3] += weight;
            }
        }
    }

    /// Returns the weights along an axis of a sample at `position`, for the pixels from `reach` before its own to
    /// `reach` behind it.
    fn weights(&self, position: f64) -> [f64; MAX_SPAN] {
        let mut weights = [0.0; MAX_SPAN];
        for (k, weight) in weights.iter_mut().enumerate().take(2 * self.reach + 1) {
            let middle = k as f64 - self.reach as f64 + 0.5;
            *weight = self.filter.weight(position - middle);
        }
        weights
    }
}

/// Replaces `means` by the filtered pixels of tiles, which must be in the order of [`super::film::tiles`].
///
/// The unfiltered pixels in `means` are kept where weights happen to cancel.
pub(super) fn assemble(width: u32, means: &mut [[f32; 3]], tiles: &[(Tile, TileResult)]) {
    let width = width as usize;
    let bands = Bands::of(width, tiles);
    // Filter each row of tiles, including samples of the rows above and below
    parallel::for_each_chunk_mut(means, width * TILE as usize, &|index, band| {
        let mut sums = vec![[0.0; 4]; band.len()];
        bands.add_to(index, &mut sums);
        for (pixel, sums) in band.iter_mut().zip(sums) {
            *pixel = weighted_mean(sums).unwrap_or(*pixel);
        }
    });
}

/// Returns the weighted sums and weights of the pixels of tiles, which must be in the order of
/// [`super::film::tiles`], for an image of `width` and `height`.
pub(super) fn sums(width: u32, height: u32, tiles: &[(Tile, TileResult)]) -> Vec<[f64; 4]> {
    let width = width as usize;
    let bands = Bands::of(width, tiles);
    let mut sums = vec![[0.0; 4]; width * height as usize];
    parallel::for_each_chunk_mut(&mut sums, width * TILE as usize, &|index, band| {
        bands.add_to(index, band);
    });
    sums
}

/// Returns the weighted mean of sums; `None` where weights happen to cancel.
pub(super) fn weighted_mean([r, g, b, weight]: [f64; 4]) -> Option<[f32; 3]> {
    (weight > 0.0).then(|| [r, g, b].map(|sum| (sum / weight) as f32))
}

/// Tiles grouped by rows of tiles.
struct Bands<'t> {
    width: usize,
    rows_of_tiles: Vec<&'t [(Tile, TileResult)]>,
}

impl Bands<'_> {
    fn of(width: usize, tiles: &[(Tile, TileResult)]) -> Bands<'_> {
        Bands {
            width,
            rows_of_tiles: tiles.chunks(width.div_ceil(TILE as usize)).collect(),
        }
    }

    /// Adds the sums that fall onto row `index` of tiles, from this row and its neighbours.
    fn add_to(&self, index: usize, band: &mut [[f64; 4]]) {
        let first_row = index * TILE as usize;
        // The radius is smaller than a tile, so only adjacent rows of tiles contribute.
        let near = index.saturating_sub(1)..(index + 2).min(self.rows_of_tiles.len());
        for (tile, result) in self.rows_of_tiles[near].iter().copied().flatten() {
            if let Some(splat) = &result.splat {
                splat.add_to_band(tile, band, self.width, first_row);
            }
        }
    }
}

impl Splat {
    /// Adds the sums that fall onto the rows of `band`, whose first row is `first_row` of the image.
    fn add_to_band(&self, tile: &Tile, band: &mut [[f64; 4]], width: usize, first_row: usize) {
        let rows = band.len() / width;
        let (x, y) = (tile.x as usize, tile.y as usize);
        for (row, sums) in self.sums.chunks(self.side()).enumerate() {
            // Row `reach` of the sums is the first row of the tile.
            let Some(row) = (y + row)
                .checked_sub(self.reach + first_row)
                .filter(|&row| row < rows)
            else {
                continue;
            };
            // Clip the columns to the image
            let hidden = self.reach.saturating_sub(x);
            let start = x + hidden - self.reach;
            let seen = (self.side() - hidden).min(width - start);
            let target = &mut band[row * width + start..row * width + start + seen];
            for (sum, added) in target.iter_mut().zip(&sums[hidden..hidden + seen]) {
                for channel in 0..4 {
                    sum[channel] += added[channel];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::super::film::tiles;
    use super::*;

    fn filters() -> Vec<PixelFilter> {
        let usual = FilterKind::value_variants()
            .iter()
            .copied()
            .map(PixelFilter::of_kind);
        let widest = PixelFilter {
            kind: FilterKind::Mitchell,
            radius: PixelFilter::MAX_RADIUS,
        };
        usual.chain([widest]).collect()
    }

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

    #[test]
    fn a_sample_reaches_every_pixel_within_the_radius_and_no_other() {
        for filter in filters() {
            let splat = Splat::new(filter);
            for position in [0.0, 0.25, 0.5, 0.999] {
                let weights = splat.weights(position);
                let far = |k: f64| filter.weight(position - (k + 0.5));
                for k in 0..2 * splat.reach + 1 {
                    assert_eq!(weights[k], far(k as f64 - splat.reach as f64));
                }
                let beyond = splat.reach as f64 + 1.0;
                assert_eq!((far(-beyond), far(beyond)), (0.0, 0.0), "{filter:?} {position}");
            }
        }
    }

    /// Returns the filtered image of `radiance` over image coordinates, with four samples per pixel.
    fn filtered_image(
        filter: PixelFilter,
        (width, height): (u32, u32),
        radiance: impl Fn(f64, f64) -> [f64; 3],
    ) -> Vec<[f32; 3]> {
        // Splat four samples per pixel, tile by tile
        let splatted: Vec<(Tile, TileResult)> = tiles(width, height)
            .into_iter()
            .map(|tile| {
                let mut splat = Splat::new(filter);
                for pixel in 0..TILE * TILE {
                    let (x, y) = (pixel % TILE, pixel / TILE);
                    if x < tile.width && y < tile.height {
                        for [u, v] in [[0.1, 0.3], [0.6, 0.2], [0.4, 0.9], [0.8, 0.7]] {
                            let at = (f64::from(tile.x + x) + u, f64::from(tile.y + y) + v);
                            splat.add(pixel, [u, v], radiance(at.0, at.1));
                        }
                    }
                }
                let result = TileResult {
                    sums: Vec::new(),
                    means: Vec::new(),
                    splat: Some(splat),
                    estimates: Vec::new(),
                };
                (tile, result)
            })
            .collect();
        // Assemble the films of the tiles
        let mut pixels = vec![[f32::NAN; 3]; (width * height) as usize];
        assemble(width, &mut pixels, &splatted);
        pixels
    }

    #[test]
    fn constant_image_stays_constant_under_every_filter() {
        let constant = [0.3, 1e6, 1.0 / 3.0];
        for filter in filters() {
            for size in [(1, 1), (33, 40), (100, 3)] {
                for pixel in filtered_image(filter, size, |_, _| constant) {
                    // Some hundred rounding errors of 2^-53 before the rounding to f32, which they rarely change.
                    for channel in 0..3 {
                        let relative = f64::from(pixel[channel]) / constant[channel] - 1.0;
                        assert!(relative.abs() < 1.2e-7, "{filter:?} {size:?} {pixel:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn weighted_sums_of_a_constant_are_constant_to_a_trillionth() {
        for filter in filters() {
            let mut splat = Splat::new(filter);
            for sample in 0..4096u32 {
                let place = [0.618_034, 0.754_878].map(|step| (f64::from(sample) * step).fract());
                splat.add(sample % 1024, place, [0.7; 3]);
            }
            for sum in splat.sums.iter().filter(|sum| sum[3].abs() > 0.1) {
                assert!((sum[0] / sum[3] - 0.7).abs() < 1e-12, "{filter:?} {sum:?}");
            }
        }
    }

    #[test]
    fn filtered_tiles_have_no_seams() {
        // A ramp is symmetric about the centre of every pixel. Filtered by symmetric weights it stays a ramp, except
        // for the uneven sample positions, which repeat from pixel to pixel: all steps are equal.
        for filter in filters() {
            let (width, height) = (70, 70);
            let pixels = filtered_image(filter, (width, height), |x, y| [x, y, x + y]);
            let inner = 5..width - 5;
            for y in inner.clone() {
                for x in inner.clone() {
                    let at = |x: u32, y: u32| pixels[(y * width + x) as usize];
                    // Values up to 140 are rounded by 2^-17; the difference of two by twice that.
                    assert!(
                        (at(x + 1, y)[0] - at(x, y)[0] - 1.0).abs() < 2e-5,
                        "{filter:?} {x} {y}"
                    );
                    assert!(
                        (at(x, y + 1)[1] - at(x, y)[1] - 1.0).abs() < 2e-5,
                        "{filter:?} {x} {y}"
                    );
                }
            }
        }
    }
}
