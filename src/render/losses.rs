//! What a pixel lacks at worst: the weights of the rays that were not followed, summed over its samples.
//!
//! A pixel is the mean of its samples, and a ray adds its weight times what it brings back. So a pixel is wrong by at
//! most the mean of its samples' lost weights for every unit of radiance that the lost rays could have brought. How
//! much that is has no bound of its own, as a light may be as near to a surface as it likes; so the error is told per
//! unit of radiance. Where a ray was cut is known one by one, so nothing is kept or counted where none is.

use super::film::TILE;
use super::ledger::Ledger;
use super::samples::pixel_of;

/// Why a ray is not followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Limit {
    /// It has as many generations behind it as are allowed.
    Depth,
    /// It weighs too little.
    Weight,
}

/// Lost weights of the pixels of a tile, by [`Limit`]; empty as long as nothing is lost.
#[derive(Debug, Default)]
pub(super) struct TileLosses {
    sums: Vec<[f64; 2]>,
}

impl TileLosses {
    /// Bytes of the sums.
    pub(super) fn byte_count(&self) -> usize {
        self.sums.capacity() * size_of::<[f64; 2]>()
    }

    pub(super) fn clear(&mut self) {
        self.sums.clear();
    }

    /// Adds a weight to the pixel that `label` tells.
    #[cold]
    pub(super) fn add(&mut self, label: u32, limit: Limit, weight: f32) {
        if self.sums.is_empty() {
            self.sums.resize((TILE * TILE) as usize, [0.0; 2]);
        }
        self.sums[pixel_of(label) as usize][limit as usize] += f64::from(weight);
    }

    /// Books the worst of `pixels`, each with its number of samples.
    pub(super) fn settle(&self, pixels: impl Iterator<Item = (u32, u32)>, ledger: &mut Ledger) {
        if self.sums.is_empty() {
            return;
        }
        for (pixel, sample_count) in pixels {
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
    fn the_worst_pixel_counts_by_the_mean_of_its_samples() {
        let mut losses = TileLosses::default();
        let mut ledger = Ledger::default();
        losses.settle([(3, 1)].into_iter(), &mut ledger);
        assert_eq!(ledger, Ledger::default());
        losses.add(3, Limit::Depth, 0.5);
        losses.add(3, Limit::Weight, 0.25);
        losses.add(7, Limit::Depth, 1.0);
        // Pixel 3 with two samples lacks (0.5 + 0.25) / 2, pixel 7 with four 1 / 4.
        losses.settle([(3, 2), (7, 4), (8, 1)].into_iter(), &mut ledger);
        assert_eq!(ledger.depth_limit.max_weight, 0.25);
        assert_eq!(ledger.weight_cutoff.max_weight, 0.125);
        assert_eq!(ledger.max_lost_weight, 0.375);
        losses.clear();
        let mut ledger = Ledger::default();
        losses.settle([(3, 2)].into_iter(), &mut ledger);
        assert_eq!(ledger, Ledger::default());
    }
}
