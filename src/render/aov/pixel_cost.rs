//! Cost of each pixel: rays and nanoseconds by account.
//!
//! Recorded only on request. Rays are counted for their pixels when they are traced; times are measured per packet
//! and divided equally among the pixels of its active lanes. For this, packets are traced one by one and all of them
//! are timed in detail, which changes no bit of the image but makes rendering slower.

use std::sync::{Mutex, PoisonError};

use super::super::film::pixel_of;
use super::super::profile::{ACCOUNTS, Category};
use super::super::tile::{TILE, Tile};
use crate::numeric::{LANES, Lanes};

/// Rays and nanoseconds of a pixel, by account.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cost {
    rays: [u32; ACCOUNTS],
    nanoseconds: [f32; ACCOUNTS],
}

/// Cost of each pixel, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelCosts {
    width: usize,
    pixels: Vec<Cost>,
}

impl PixelCosts {
    /// Number of bytes per pixel, as recorded.
    pub(in crate::render) const BYTES: usize = size_of::<Cost>();

    /// Returns the number of rays booked under `account`; integers.
    pub fn rays(&self, account: Category) -> Vec<f32> {
        let of = |cost: &Cost| cost.rays[account as usize] as f32;
        self.pixels.iter().map(of).collect()
    }

    /// Returns the nanoseconds booked under `account`, summed over threads and samples.
    pub fn nanoseconds(&self, account: Category) -> Vec<f32> {
        let of = |cost: &Cost| cost.nanoseconds[account as usize];
        self.pixels.iter().map(of).collect()
    }

    /// Returns the number of rays of all accounts.
    pub fn all_rays(&self) -> Vec<f32> {
        let of = |cost: &Cost| cost.rays.iter().sum::<u32>() as f32;
        self.pixels.iter().map(of).collect()
    }

    /// Returns the nanoseconds of all accounts.
    pub fn all_nanoseconds(&self) -> Vec<f32> {
        let of = |cost: &Cost| cost.nanoseconds.iter().sum();
        self.pixels.iter().map(of).collect()
    }
}

/// Pixel costs of an image, to which finished tiles are added.
pub(in crate::render) struct PixelCostBuffer(Mutex<PixelCosts>);

impl PixelCostBuffer {
    pub(in crate::render) fn new(width: u32, height: u32) -> PixelCostBuffer {
        PixelCostBuffer(Mutex::new(PixelCosts {
            width: width as usize,
            pixels: vec![Cost::default(); width as usize * height as usize],
        }))
    }

    /// Adds the costs of a tile.
    pub(in crate::render) fn add(&self, tile: Tile, costs: &TileCosts) {
        let mut buffer = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for y in 0..tile.height {
            let start = (tile.y + y) as usize * buffer.width + tile.x as usize;
            // Add row by row, clipped to the tile
            let row = &costs.pixels[(y * TILE) as usize..][..tile.width as usize];
            for (sum, cost) in buffer.pixels[start..].iter_mut().zip(row) {
                for account in 0..ACCOUNTS {
                    sum.rays[account] += cost.rays[account];
                    sum.nanoseconds[account] += cost.nanoseconds[account];
                }
            }
        }
    }

    pub(in crate::render) fn finish(self) -> PixelCosts {
        self.0.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Pixel costs of a tile, and the packet that is being processed.
pub(in crate::render) struct TileCosts {
    pixels: Vec<Cost>,
    labels: Lanes<u32>,
    active: Lanes<i32>,
}

impl TileCosts {
    /// Returns the bytes of the pixel costs.
    pub(in crate::render) fn byte_count(&self) -> usize {
        size_of_val(&self.pixels[..])
    }

    pub(in crate::render) fn new() -> TileCosts {
        TileCosts {
            pixels: vec![Cost::default(); (TILE * TILE) as usize],
            labels: [0; LANES],
            active: [0; LANES],
        }
    }

    pub(in crate::render) fn clear(&mut self) {
        self.pixels.fill(Cost::default());
    }

    /// Sets the packet that later costs belong to.
    pub(in crate::render) fn set_packet(&mut self, labels: &Lanes<u32>, active: &Lanes<i32>) {
        (self.labels, self.active) = (*labels, *active);
    }

    /// Divides seconds among the active lanes of the current packet.
    pub(in crate::render) fn share(&mut self, account: Category, seconds: f64) {
        let count = self.active.iter().filter(|&&active| active != 0).count();
        // Where no lane is active any more, the time belongs to all lanes.
        let is_all = count == 0;
        let sharers = if is_all { LANES } else { count };
        let each = (1e9 * seconds / sharers as f64) as f32;
        for l in 0..LANES {
            if is_all || self.active[l] != 0 {
                let pixel = pixel_of(self.labels[l]) as usize;
                self.pixels[pixel].nanoseconds[account as usize] += each;
            }
        }
    }

    /// Counts the rays of the current packet, and divides their common time among them.
    pub(in crate::render) fn trace(&mut self, account_of: impl Fn(usize) -> Category, seconds: f64) {
        let count = self.active.iter().filter(|&&active| active != 0).count();
        let each = (1e9 * seconds / count.max(1) as f64) as f32;
        for l in 0..LANES {
            if self.active[l] != 0 {
                let cost = &mut self.pixels[pixel_of(self.labels[l]) as usize];
                let account = account_of(l) as usize;
                cost.rays[account] += 1;
                cost.nanoseconds[account] += each;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packet_time_is_divided_among_active_lanes() {
        let mut costs = TileCosts::new();
        let mut active = [0; LANES];
        (active[0], active[1]) = (-1, -1);
        let mut labels = [TILE + 1; LANES];
        labels[1] = 0;
        costs.set_packet(&labels, &active);
        costs.share(Category::Surface, 6e-9);
        costs.trace(|_| Category::Camera, 2e-9);
        let buffer = PixelCostBuffer::new(40, 3);
        let tile = Tile {
            x: 32,
            y: 0,
            width: 8,
            height: 3,
        };
        buffer.add(tile, &costs);
        buffer.add(tile, &costs);
        let sum = buffer.finish();
        // Two lanes share 6 ns and 2 ns, and the tile is added twice.
        let (first, second) = (32, 40 + 33);
        for pixel in [first, second] {
            assert_eq!(sum.nanoseconds(Category::Surface)[pixel], 6.0);
            assert_eq!(sum.all_nanoseconds()[pixel], 8.0);
            assert_eq!(sum.rays(Category::Camera)[pixel], 2.0);
        }
        assert_eq!(sum.all_rays().iter().sum::<f32>(), 4.0);
    }
}
