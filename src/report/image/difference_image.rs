//! Difference images and error maps of two images.

use super::heat_map;
use crate::image::{LinearImage, linear_from_srgb, metrics};

/// Difference at which a channel of the difference image saturates, as a fraction of the displayed range.
pub const FULL_DIFFERENCE: f64 = 0.1;

/// Returns the signed difference of displayed values after `exposure_ev` stops: grey where both are equal, and brighter
/// in the channels where `image` is brighter. Both images have equal size.
pub fn signed(reference: &LinearImage, image: &LinearImage, exposure_ev: f32) -> LinearImage {
    let gain = f64::from(exposure_ev).exp2();
    let shown = |channel: f32| metrics::as_displayed(gain * f64::from(channel));
    let channel = |from: f32, to: f32| {
        // Map the difference to a display code around the middle grey
        let part = (shown(to) - shown(from)) / FULL_DIFFERENCE;
        linear_from_srgb((0.5 + 0.5 * part).clamp(0.0, 1.0)) as f32
    };
    let pairs = reference.pixels.iter().zip(&image.pixels);
    LinearImage {
        width: reference.width,
        height: reference.height,
        pixels: pairs
            .map(|(a, b)| std::array::from_fn(|c| channel(a[c], b[c])))
            .collect(),
    }
}

/// Returns an image of errors from 0 to 1 (row-major) in colours from dark violet over teal to light yellow.
pub fn heat(errors: &[f32], width: u32) -> LinearImage {
    LinearImage {
        width,
        height: (errors.len() / width.max(1) as usize) as u32,
        pixels: errors
            .iter()
            .map(|&error| heat_map::color(error.into()))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ToneMap;

    fn gray(values: &[f32]) -> LinearImage {
        LinearImage {
            width: values.len() as u32,
            height: 1,
            pixels: values.iter().map(|&v| [v; 3]).collect(),
        }
    }

    #[test]
    fn equal_pixels_are_grey_and_brighter_ones_brighter() {
        let code = |code: u32| linear_from_srgb(f64::from(code) / 255.0) as f32;
        let reference = gray(&[code(100), code(100), code(100), code(0)]);
        let image = gray(&[code(100), code(110), code(90), code(255)]);
        let bytes = ToneMap::default().srgb_bytes(&signed(&reference, &image, 0.0));
        let first: Vec<u8> = bytes.chunks(3).map(|pixel| pixel[0]).collect();
        // A difference of ten codes, relative to the saturation at 25.5 codes, over half of the range.
        assert!(first[0].abs_diff(128) <= 1, "{first:?}");
        assert!(
            first[1].abs_diff(128 + 50) <= 1 && first[2].abs_diff(128 - 50) <= 1,
            "{first:?}"
        );
        assert_eq!(first[3], 255);
    }

    #[test]
    fn more_exposure_increases_the_shown_difference() {
        let [a, b] = [gray(&[0.1]), gray(&[0.11])];
        let at = |ev| signed(&a, &b, ev).pixels[0][0];
        assert!(at(1.0) > at(0.0));
        // Both images are saturated to white at this exposure.
        assert_eq!(at(10.0), signed(&a, &a, 0.0).pixels[0][0]);
    }

    #[test]
    fn heat_map_keeps_the_positions_of_errors() {
        let map = heat(&[0.0, 0.5, 1.0, 0.0], 2);
        assert_eq!((map.width, map.height), (2, 2));
        assert_eq!(map.pixels[0], map.pixels[3]);
        assert_ne!(map.pixels[1], map.pixels[2]);
    }
}
