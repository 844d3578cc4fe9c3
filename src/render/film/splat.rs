//! Weighted sums of the samples of one tile, by a reconstruction filter.

use super::super::tile::{TILE, Tile};
use super::filter::PixelFilter;

/// Largest number of pixels that a sample affects, along one axis.
const MAX_SPAN: usize = 9;

/// Weighted sums of the samples of a tile, for its own pixels and a border of their neighbours.
#[derive(Clone)]
pub(in crate::render) struct Splat {
    filter: PixelFilter,
    reach: usize,
    /// Red, green, blue and weight per pixel; a square of rows of `TILE + 2 reach` pixels.
    sums: Vec<[f64; 4]>,
}

impl Splat {
    /// Returns the bytes of the sums.
    pub(in crate::render) fn byte_count(&self) -> usize {
        size_of_val(&self.sums[..])
    }

    pub(in crate::render) fn new(filter: PixelFilter) -> Splat {
        let reach = filter.reach();
        let side = TILE as usize + 2 * reach;
        Splat {
            filter,
            reach,
            sums: vec![[0.0; 4]; side * side],
        }
    }

    pub(in crate::render) fn clear(&mut self) {
        self.sums.fill([0.0; 4]);
    }

    fn side(&self) -> usize {
        TILE as usize + 2 * self.reach
    }

    /// Adds a sample at `position` within pixel `pixel` of the tile, `TILE` pixels per row.
    pub(in crate::render) fn add(&mut self, pixel: u32, position: [f64; 2], radiance: [f64; 3]) {
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

impl Splat {
    /// Adds the sums that fall onto the rows of `band`, whose first row is `first_row` of the image.
    pub(in crate::render) fn add_to_band(
        &self,
        tile: &Tile,
        band: &mut [[f64; 4]],
        width: usize,
        first_row: usize,
    ) {
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

/// Returns the weighted mean of sums; `None` where weights happen to cancel.
pub(in crate::render) fn weighted_mean([r, g, b, weight]: [f64; 4]) -> Option<[f32; 3]> {
    (weight > 0.0).then(|| [r, g, b].map(|sum| (sum / weight) as f32))
}

#[cfg(test)]
mod tests {
    use super::super::filter::filters;
    use super::*;

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
}
