//! Shared AOV buffers that tiles write into directly when they are finished, which avoids a second copy.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use multiversion::multiversion;

use super::super::subset::Region;
use super::super::tile::{TILE, Tile};
use super::layer::Layer;

/// Layers of a rectangle of an image, which threads fill concurrently.
pub(in crate::render) struct AovBuffers<'p> {
    region: Region,
    /// Row of tiles that the first band belongs to.
    first: u32,
    /// For each row of tiles, the pixels of each layer inside the rectangle.
    bands: Vec<Mutex<Vec<&'p mut [f32]>>>,
}

impl<'p> AovBuffers<'p> {
    /// Divides `layers` of the pixels of `region` into bands that can be written concurrently.
    pub(in crate::render) fn over(layers: &'p mut [Layer], region: &Region) -> AovBuffers<'p> {
        let end = region.y + region.height;
        let mut planes = AovBuffers {
            region: *region,
            first: region.y / TILE,
            bands: Vec::new(),
        };
        if layers.is_empty() {
            return planes;
        }
        // Split every layer at the boundaries of rows of tiles
        let mut rest: Vec<&mut [f32]> = layers.iter_mut().map(|layer| &mut layer.values[..]).collect();
        let mut y = region.y;
        while y < end {
            let next = (y / TILE + 1).saturating_mul(TILE).min(end);
            let pixel_count = (next - y) as usize * region.width as usize;
            let band = rest.iter_mut().map(|rest| {
                let (band, left) = std::mem::take(rest).split_at_mut(pixel_count);
                *rest = left;
                band
            });
            planes.bands.push(Mutex::new(band.collect()));
            y = next;
        }
        planes
    }

    /// Writes the layers of a tile, clipped to the rectangle.
    pub(in crate::render) fn put(&self, tile: Tile, layers: &[TileLayer]) {
        let region = &self.region;
        // Clip the tile to the rectangle
        let columns = common(tile.x, tile.width, region.x, region.width);
        let rows = common(tile.y, tile.height, region.y, region.height);
        if columns.is_empty() || rows.is_empty() || layers.is_empty() {
            return;
        }
        let window = Window {
            rows: within(&rows, tile.y),
            columns: within(&columns, tile.x),
            tile_width: tile.width as usize,
            first: (columns.start - region.x) as usize,
            width: region.width as usize,
        };
        // Write the clipped rows while the band is locked
        let band = &self.bands[(tile.y / TILE - self.first) as usize];
        let mut band = band.lock().unwrap_or_else(PoisonError::into_inner);
        for (plane, layer) in band.iter_mut().zip(layers) {
            fill(plane, layer, &window);
        }
    }
}

/// Layer of one tile, before it is clipped.
pub(in crate::render) enum TileLayer<'t> {
    /// Sums to be multiplied by their scales, `TILE` pixels per row; `nothing` where the scale is 0.
    Means {
        sums: &'t [f64],
        scales: &'t [f64],
        nothing: f32,
    },
    /// One channel of sums to be multiplied by a common scale, `TILE` pixels per row.
    Channel {
        sums: &'t [[f64; 3]],
        channel: usize,
        scale: f64,
    },
    /// One of three numbers per pixel, `TILE` pixels per row; `nothing` where the count is 0.
    Numbers {
        numbers: &'t [[u32; 3]],
        part: usize,
        counts: &'t [u32],
        nothing: f32,
    },
    /// Final values, in rows of the width of the tile.
    Values(Vec<f32>),
}

/// Part of a tile inside the rectangle, and its position there.
struct Window {
    /// Rows and columns within the tile.
    rows: Range<usize>,
    columns: Range<usize>,
    tile_width: usize,
    /// First column within the rectangle, and width of the rectangle.
    first: usize,
    width: usize,
}

/// Writes the part of a layer inside the window to the rows of a band, which begins at the window's first row.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn fill(plane: &mut [f32], layer: &TileLayer, window: &Window) {
    let lines = plane.chunks_mut(window.width);
    for (line, row) in lines.zip(window.rows.clone()) {
        let line = &mut line[window.first..][..window.columns.len()];
        let from = |width: usize| row * width + window.columns.start;
        match layer {
            TileLayer::Means {
                sums,
                scales,
                nothing,
            } => {
                // Convert sums to means
                let start = from(TILE as usize);
                let means = sums[start..].iter().zip(&scales[start..]);
                for (value, (&sum, &scale)) in line.iter_mut().zip(means) {
                    let mean = (sum * scale) as f32;
                    *value = if scale == 0.0 { *nothing } else { mean };
                }
            }
            TileLayer::Channel { sums, channel, scale } => {
                // Extract one channel of the sums
                for (value, sum) in line.iter_mut().zip(&sums[from(TILE as usize)..]) {
                    *value = (sum[*channel] * scale) as f32;
                }
            }
            TileLayer::Numbers {
                numbers,
                part,
                counts,
                nothing,
            } => {
                // Convert ids to f32
                let start = from(TILE as usize);
                let counted = numbers[start..].iter().zip(&counts[start..]);
                for (value, (numbers, &count)) in line.iter_mut().zip(counted) {
                    let number = numbers[*part] as f32;
                    *value = if count == 0 { *nothing } else { number };
                }
            }
            TileLayer::Values(values) => {
                // Copy finished values, which are cropped to the tile
                let start = from(window.tile_width);
                line.copy_from_slice(&values[start..start + line.len()]);
            }
        }
    }
}

/// Returns the intersection of two intervals.
fn common(start: u32, count: u32, other_start: u32, other_count: u32) -> Range<u32> {
    start.max(other_start)..(start + count).min(other_start + other_count)
}

/// Returns the interval relative to `start`.
fn within(interval: &Range<u32>, start: u32) -> Range<usize> {
    (interval.start - start) as usize..(interval.end - start) as usize
}

#[cfg(test)]
mod tests {
    use super::super::super::tile::tiles;
    use super::*;
    use crate::image::ChannelKind;

    #[test]
    fn tile_pixels_are_copied_into_a_rectangle() {
        let [width, height] = [150, 130];
        let value = |x: u32, y: u32, layer: u32| ((layer * height + y) * width + x) as f32;
        for (x, y, columns, rows) in [
            (0, 0, width, height),
            (5, 40, 3, 2),
            (33, 31, 80, 66),
            (149, 0, 1, 130),
        ] {
            let region = Region {
                x,
                y,
                width: columns,
                height: rows,
            };
            // Create layers filled with NaN
            let blank = |number: u32| Layer {
                name: number.to_string(),
                kind: ChannelKind::Exact,
                values: vec![f32::NAN; (columns * rows) as usize],
            };
            let mut layers: Vec<Layer> = (0..3).map(blank).collect();
            let planes = AovBuffers::over(&mut layers, &region);
            // More tiles than are needed, in reverse order.
            for tile in tiles(width, height).into_iter().rev() {
                // Encode layer, row and column in the values of each pixel
                let place = |index: u32| [index % TILE, index / TILE].map(|at| at.min(TILE - 1));
                let sum =
                    |index: u32| f64::from(value(tile.x + place(index)[0], tile.y + place(index)[1], 0));
                let sums: Vec<f64> = (0..TILE * TILE).map(sum).collect();
                let places =
                    (0..tile.height).flat_map(|row| (0..tile.width).map(move |column| (column, row)));
                let values = places.map(|(column, row)| value(tile.x + column, tile.y + row, 2));
                let means = TileLayer::Means {
                    sums: &sums,
                    scales: &[1.0; (TILE * TILE) as usize],
                    nothing: f32::NAN,
                };
                let green: Vec<[f64; 3]> = sums.iter().map(|&sum| [f64::NAN, 2.0 * sum, f64::NAN]).collect();
                let channel = TileLayer::Channel {
                    sums: &green,
                    channel: 1,
                    scale: 0.5,
                };
                planes.put(tile, &[means, channel, TileLayer::Values(values.collect())]);
            }
            drop(planes);
            // Compare every pixel of the rectangle
            for (number, layer) in (0..).zip(&layers) {
                for (index, &found) in (0..).zip(&layer.values) {
                    let [column, row] = [index % columns, index / columns];
                    let wanted = value(x + column, y + row, if number == 2 { 2 } else { 0 });
                    assert_eq!(found, wanted, "{region:?} {number}");
                }
            }
        }
    }

    #[test]
    fn pixels_without_hit_have_the_miss_value() {
        let region = Region {
            x: 0,
            y: 0,
            width: 2,
            height: 1,
        };
        let blank = |name: &str| Layer::blank(name.into(), ChannelKind::Exact, &region);
        let mut layers = vec![blank("Z"), blank("id.material")];
        let planes = AovBuffers::over(&mut layers, &region);
        // The first of the two pixels has no hit.
        let means = TileLayer::Means {
            sums: &[0.0, 6.0],
            scales: &[0.0, 0.25],
            nothing: f32::INFINITY,
        };
        let numbers = TileLayer::Numbers {
            numbers: &[[7, 8, 9], [1, 2, 3]],
            part: 1,
            counts: &[0, 4],
            nothing: -1.0,
        };
        planes.put(tiles(2, 1)[0], &[means, numbers]);
        drop(planes);
        assert_eq!(layers[0].values, [f32::INFINITY, 1.5]);
        assert_eq!(layers[1].values, [-1.0, 2.0]);
    }
}
