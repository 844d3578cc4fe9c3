//! Assembly of filtered pixels from tiles, each of which splatted its samples beyond its edges.

use super::super::tile::{TILE, Tile};
use super::splat::weighted_mean;
use super::tile_result::TileResult;
use crate::parallel;

/// Replaces `means` by the filtered pixels of tiles, which must be in the order of [`crate::render::tile::tiles`].
///
/// The unfiltered pixels in `means` are kept where weights happen to cancel.
pub(in crate::render) fn assemble(width: u32, means: &mut [[f32; 3]], tiles: &[(Tile, TileResult)]) {
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
/// [`crate::render::tile::tiles`], for an image of `width` and `height`.
pub(in crate::render) fn sums(width: u32, height: u32, tiles: &[(Tile, TileResult)]) -> Vec<[f64; 4]> {
    let width = width as usize;
    let bands = Bands::of(width, tiles);
    let mut sums = vec![[0.0; 4]; width * height as usize];
    parallel::for_each_chunk_mut(&mut sums, width * TILE as usize, &|index, band| {
        bands.add_to(index, band);
    });
    sums
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

#[cfg(test)]
mod tests {
    use super::super::super::tile::tiles;
    use super::super::filter::{PixelFilter, filters};
    use super::super::splat::Splat;
    use super::*;

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
                    transparency: None,
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
