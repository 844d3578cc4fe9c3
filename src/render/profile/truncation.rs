//! Truncation error: bounds on the error of pixels due to rays that were not traced.
//!
//! A pixel is the mean of its samples, and a ray contributes its throughput times the radiance along it. A pixel is
//! therefore wrong by at most the mean of its samples' lost throughputs per unit of radiance of the lost rays. That
//! radiance has no bound of its own, because a light may be arbitrarily close to a surface, so the error is reported
//! per unit of radiance. Terminated rays are recorded one by one; where there are none, no memory or time is used.

use super::super::film::pixel_of;
use super::super::tile::TILE;
use super::render_profile::{RenderProfile, TruncationLimit};

/// Lost throughputs of the pixels of a tile, by [`TruncationLimit`]; empty while nothing is lost.
#[derive(Debug, Default)]
pub(in crate::render) struct TileTruncation {
    sums: Vec<[f64; 2]>,
}

impl TileTruncation {
    /// Returns the bytes of the sums.
    pub(in crate::render) fn byte_count(&self) -> usize {
        self.sums.capacity() * size_of::<[f64; 2]>()
    }

    pub(in crate::render) fn clear(&mut self) {
        self.sums.clear();
    }

    /// Adds a lost throughput to the pixel of `label`.
    #[cold]
    pub(in crate::render) fn add(&mut self, label: u32, limit: TruncationLimit, weight: f32) {
        if self.sums.is_empty() {
            self.sums.resize((TILE * TILE) as usize, [0.0; 2]);
        }
        self.sums[pixel_of(label) as usize][limit as usize] += f64::from(weight);
    }

    /// Records the largest error bound among `pixels`, which are given with their numbers of samples.
    pub(in crate::render) fn settle(
        &self,
        pixels: impl Iterator<Item = (u32, u32)>,
        ledger: &mut RenderProfile,
    ) {
        if self.sums.is_empty() {
            return;
        }
        for (pixel, sample_count) in pixels {
            // Average over the samples of the pixel
            let per_sample = f64::from(sample_count.max(1)).recip();
            let [depth, weight] = self.sums[pixel as usize].map(|sum| sum * per_sample);
            let worst = |greatest: &mut f64, lost: f64| *greatest = greatest.max(lost);
            worst(&mut ledger.depth_limit.max_weight, depth);
            worst(&mut ledger.weight_cutoff.max_weight, weight);
            worst(&mut ledger.max_lost_weight, depth + weight);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn largest_loss_is_a_pixel_mean() {
        let mut losses = TileTruncation::default();
        let mut ledger = RenderProfile::default();
        losses.settle([(3, 1)].into_iter(), &mut ledger);
        assert_eq!(ledger, RenderProfile::default());
        losses.add(3, TruncationLimit::Depth, 0.5);
        losses.add(3, TruncationLimit::Weight, 0.25);
        losses.add(7, TruncationLimit::Depth, 1.0);
        // Pixel 3 with two samples loses (0.5 + 0.25) / 2, pixel 7 with four samples 1 / 4.
        losses.settle([(3, 2), (7, 4), (8, 1)].into_iter(), &mut ledger);
        assert_eq!(ledger.depth_limit.max_weight, 0.25);
        assert_eq!(ledger.weight_cutoff.max_weight, 0.125);
        assert_eq!(ledger.max_lost_weight, 0.375);
        losses.clear();
        let mut ledger = RenderProfile::default();
        losses.settle([(3, 2)].into_iter(), &mut ledger);
        assert_eq!(ledger, RenderProfile::default());
    }
}
