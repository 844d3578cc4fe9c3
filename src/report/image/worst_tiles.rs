//! Tiles in which an image differs most from its reference.

use crate::image::{LinearImage, ToneMap, metrics};

/// Side of a tile in pixels, unless the image is smaller.
pub const SIDE: u32 = 32;

/// Rectangular part of an image with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ErrorTile {
    /// Column and row of the upper left pixel.
    pub at: [u32; 2],
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Mean squared difference of displayed channels (black is 0, white 1).
    pub mse: f64,
}

/// Returns at most `most` tiles with the largest difference, in descending order and without equal ones. Both images
/// have equal size.
///
/// Tiles at the right and lower edges are shifted inwards where the size is not a multiple of the tile's, and overlap
/// their neighbours.
pub fn worst(reference: &LinearImage, image: &LinearImage, tone: ToneMap, most: usize) -> Vec<ErrorTile> {
    let size = [reference.width, reference.height].map(|side| side.min(SIDE));
    let rows = starts(reference.height);
    let places = rows.flat_map(|y| starts(reference.width).map(move |x| [x, y]));
    let mut tiles: Vec<ErrorTile> = places
        .map(|at| ErrorTile {
            at,
            size,
            mse: squared_difference([reference, image], tone, at, size),
        })
        .filter(|tile| tile.mse > 0.0)
        .collect();
    // The sort is stable, so that upper tiles come first among equal ones.
    tiles.sort_by(|a, b| b.mse.total_cmp(&a.mse));
    tiles.truncate(most);
    tiles
}

/// Returns the coordinates at which tiles begin along a side.
fn starts(side: u32) -> impl Iterator<Item = u32> {
    let last = side.saturating_sub(SIDE);
    (0..side.div_ceil(SIDE)).map(move |number| (number * SIDE).min(last))
}

fn squared_difference(images: [&LinearImage; 2], tone: ToneMap, at: [u32; 2], size: [u32; 2]) -> f64 {
    let [a, b] = images.map(|image| crop(image, at, size));
    let gain = f64::from(tone.exposure_ev).exp2();
    let shown = |channel: f32| metrics::as_displayed(gain * f64::from(channel));
    let channels = a.pixels.iter().flatten().zip(b.pixels.iter().flatten());
    let sum: f64 = channels.map(|(&a, &b)| (shown(a) - shown(b)).powi(2)).sum();
    sum / (3 * a.pixels.len()).max(1) as f64
}

/// Returns a part of an image as an image of its own; pixels outside the image are left out.
pub fn crop(image: &LinearImage, [x, y]: [u32; 2], [width, height]: [u32; 2]) -> LinearImage {
    let columns = x.min(image.width)..x.saturating_add(width).min(image.width);
    let rows = y.min(image.height)..y.saturating_add(height).min(image.height);
    let pixels = rows.clone().flat_map(|y| {
        let columns = columns.clone();
        columns.map(move |x| image.pixel(x, y))
    });
    LinearImage {
        width: columns.len() as u32,
        height: rows.len() as u32,
        pixels: pixels.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_sorted_by_decreasing_difference() {
        let reference = LinearImage::black(70, 40);
        let mut image = reference.clone();
        image.pixels[0] = [0.1; 3];
        image.pixels[39 * 70 + 69] = [1.0; 3];
        let tiles = worst(&reference, &image, ToneMap::default(), 8);
        let places: Vec<_> = tiles.iter().map(|tile| tile.at).collect();
        // The last column begins at 70 - 32, the last row at 40 - 32.
        assert_eq!(places, [[38, 8], [0, 0]]);
        // One of 32² pixels is white instead of black.
        assert!((tiles[0].mse - 1.0 / 1024.0).abs() < 1e-15, "{}", tiles[0].mse);
        assert_eq!(worst(&reference, &image, ToneMap::default(), 1).len(), 1);
    }

    #[test]
    fn small_image_is_one_tile_and_equal_images_have_none() {
        let reference = LinearImage::black(5, 3);
        assert!(worst(&reference, &reference, ToneMap::default(), 8).is_empty());
        let mut image = reference.clone();
        image.pixels[7] = [f32::INFINITY, f32::NAN, -1.0];
        let tiles = worst(&reference, &image, ToneMap::default(), 8);
        assert_eq!((tiles[0].at, tiles[0].size), ([0, 0], [5, 3]));
        // One of three channels is white; NaN and negative values are black.
        assert!((tiles[0].mse - 1.0 / 45.0).abs() < 1e-15);
        let none = LinearImage::black(0, 0);
        assert!(worst(&none, &none, ToneMap::default(), 8).is_empty());
    }

    #[test]
    fn crop_holds_exactly_the_pixels_of_its_rectangle() {
        let mut image = LinearImage::black(4, 3);
        image.pixels[2 * 4 + 3] = [1.0, 2.0, 3.0];
        let part = crop(&image, [2, 1], [2, 2]);
        assert_eq!((part.width, part.height), (2, 2));
        assert_eq!(part.pixels[3], [1.0, 2.0, 3.0]);
        let beside = crop(&image, [3, 9], [u32::MAX, 2]);
        assert_eq!((beside.width, beside.height, beside.pixels.len()), (1, 0, 0));
    }
}
