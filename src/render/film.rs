//! Sums of radiance: f64 a pixel while a tile is rendered, f32 means in the picture.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::image::LinearImage;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Side of a tile in pixels: its film (24 KB) stays in the second-level cache, and there are enough tiles to share out.
pub(super) const TILE: u32 = 32;

/// A rectangle of pixels that one task renders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// The tiles of an image, row by row.
pub(super) fn tiles(width: u32, height: u32) -> Vec<Tile> {
    let starts = |size: u32| (0..size).step_by(TILE as usize);
    starts(height)
        .flat_map(|y| {
            starts(width).map(move |x| Tile {
                x,
                y,
                width: TILE.min(width - x),
                height: TILE.min(height - y),
            })
        })
        .collect()
}

/// Sums of radiance over a tile. Sums are made in one order, whoever makes them.
pub(super) struct TileFilm {
    sums: Vec<[f64; 3]>,
}

impl TileFilm {
    pub(super) fn new() -> TileFilm {
        TileFilm {
            sums: vec![[0.0; 3]; (TILE * TILE) as usize],
        }
    }

    pub(super) fn clear(&mut self) {
        self.sums.fill([0.0; 3]);
    }

    /// Adds one value a lane; lanes that have nothing to add hold zero.
    #[inline(always)]
    pub(super) fn add(&mut self, pixel: &Lanes<u32>, radiance: &Lanes3<f32>) {
        if pixel.iter().fold(0, |differ, p| differ | (p ^ pixel[0])) == 0 {
            let sum = &mut self.sums[pixel[0] as usize];
            let added = sums_of_lanes(radiance);
            for channel in 0..3 {
                sum[channel] += added[channel];
            }
            return;
        }
        for l in 0..LANES {
            let sum = &mut self.sums[pixel[l] as usize];
            for channel in 0..3 {
                sum[channel] += f64::from(radiance[channel][l]);
            }
        }
    }

    /// The means over `spp` samples of the tile's pixels, row by row.
    pub(super) fn means(&self, tile: Tile, spp: u32) -> Vec<[f32; 3]> {
        let scale = 1.0 / f64::from(spp);
        let mut means = Vec::with_capacity((tile.width * tile.height) as usize);
        for row in self.sums.chunks(TILE as usize).take(tile.height as usize) {
            means.extend(
                row[..tile.width as usize]
                    .iter()
                    .map(|sum| sum.map(|channel| (channel * scale) as f32)),
            );
        }
        means
    }
}

/// The f64 sums of sixteen values a channel, by halves.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn sums_of_lanes(radiance: &Lanes3<f32>) -> [f64; 3] {
    radiance.map(|values| {
        let mut halves = values.map(f64::from);
        let mut width = LANES / 2;
        while width > 0 {
            for l in 0..width {
                halves[l] += halves[l + width];
            }
            width /= 2;
        }
        halves[0]
    })
}

/// Puts rendered tiles together, which come in the order of [`tiles`].
pub(super) fn assemble(width: u32, height: u32, tiles: &[(Tile, Vec<[f32; 3]>)]) -> LinearImage {
    let width_in_tiles = width.div_ceil(TILE) as usize;
    let mut pixels = vec![[0.0; 3]; width as usize * height as usize];
    pixels
        .par_chunks_mut(width as usize * TILE as usize)
        .zip(tiles.par_chunks(width_in_tiles))
        .for_each(|(band, tiles)| {
            for (tile, means) in tiles {
                for (row, means) in means.chunks(tile.width as usize).enumerate() {
                    let start = row * width as usize + tile.x as usize;
                    band[start..start + means.len()].copy_from_slice(means);
                }
            }
        });
    LinearImage {
        width,
        height,
        pixels,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_every_pixel_once() {
        for (width, height) in [(1, 1), (32, 32), (33, 65), (17, 3)] {
            let mut covered = vec![0; (width * height) as usize];
            for tile in tiles(width, height) {
                for y in tile.y..tile.y + tile.height {
                    for x in tile.x..tile.x + tile.width {
                        covered[(y * width + x) as usize] += 1;
                    }
                }
            }
            assert!(covered.iter().all(|&count| count == 1));
        }
    }

    #[test]
    fn one_pixel_and_sixteen_pixels_sum_alike() {
        let radiance = [std::array::from_fn(|l| l as f32), [0.25; LANES], [0.0; LANES]];
        let mut film = TileFilm::new();
        film.add(&[5; LANES], &radiance);
        // 0 + 1 + ... + 15 = 120.
        assert_eq!(film.sums[5], [120.0, 4.0, 0.0]);
        film.add(&std::array::from_fn(|l| l as u32), &radiance);
        assert_eq!(film.sums[7], [7.0, 0.25, 0.0]);
        assert_eq!(film.sums[5], [125.0, 4.25, 0.0]);
    }
}
