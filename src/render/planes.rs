//! Layers in the making: tiles put their pixels where they belong as soon as they are finished, so that none is kept twice.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::film::{TILE, Tile};
use super::layers::Layer;
use super::region::Region;

/// The layers of a rectangle of a picture, which threads fill together.
pub(super) struct Planes<'p> {
    region: Region,
    /// The row of tiles that the first band is of.
    first: u32,
    /// Of each row of tiles, the pixels of each layer that lie in the rectangle.
    bands: Vec<Mutex<Vec<&'p mut [f32]>>>,
}

impl<'p> Planes<'p> {
    /// To be filled: `layers` of all pixels of `region`.
    pub(super) fn over(layers: &'p mut [Layer], region: &Region) -> Planes<'p> {
        let end = region.y + region.height;
        let mut planes = Planes {
            region: *region,
            first: region.y / TILE,
            bands: Vec::new(),
        };
        if layers.is_empty() {
            return planes;
        }
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

    /// Puts the layers of a tile into their places, as far as these are in the rectangle.
    pub(super) fn put(&self, tile: Tile, layers: &[Vec<f32>]) {
        let region = &self.region;
        let columns = common(tile.x, tile.width, region.x, region.width);
        let rows = common(tile.y, tile.height, region.y, region.height);
        if columns.is_empty() || rows.is_empty() || layers.is_empty() {
            return;
        }
        let band = &self.bands[(tile.y / TILE - self.first) as usize];
        let mut band = band.lock().unwrap_or_else(PoisonError::into_inner);
        for (plane, layer) in band.iter_mut().zip(layers) {
            let lines = plane.chunks_mut(region.width as usize);
            let parts = layer.chunks(tile.width as usize);
            for (line, part) in lines.zip(parts.skip((rows.start - tile.y) as usize)) {
                let part = &part[within(&columns, tile.x)];
                line[within(&columns, region.x)].copy_from_slice(part);
            }
        }
    }
}

/// What two stretches of so many have in common.
fn common(start: u32, count: u32, other_start: u32, other_count: u32) -> Range<u32> {
    start.max(other_start)..(start + count).min(other_start + other_count)
}

/// The same stretch, counted from `start`.
fn within(stretch: &Range<u32>, start: u32) -> Range<usize> {
    (stretch.start - start) as usize..(stretch.end - start) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ExtraKind;
    use crate::render::film::tiles;

    #[test]
    fn pixels_of_tiles_come_to_their_places_in_a_rectangle() {
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
            let blank = |number: u32| Layer {
                name: number.to_string(),
                kind: ExtraKind::Exact,
                values: vec![f32::NAN; (columns * rows) as usize],
            };
            let mut layers: Vec<Layer> = (0..2).map(blank).collect();
            let planes = Planes::over(&mut layers, &region);
            // More tiles than are needed, in an order of their own.
            for tile in tiles(width, height).into_iter().rev() {
                let of_layer = |layer| {
                    let places =
                        (0..tile.height).flat_map(|row| (0..tile.width).map(move |column| (column, row)));
                    places
                        .map(|(column, row)| value(tile.x + column, tile.y + row, layer))
                        .collect()
                };
                planes.put(tile, &[of_layer(0), of_layer(1)]);
            }
            drop(planes);
            for (number, layer) in (0..).zip(&layers) {
                for (index, &found) in (0..).zip(&layer.values) {
                    let [column, row] = [index % columns, index / columns];
                    assert_eq!(found, value(x + column, y + row, number), "{region:?}");
                }
            }
        }
    }
}
