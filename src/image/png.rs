//! PNG: 8-bit sRGB, compressed for speed.

use std::io::{self, Write};

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

use super::{LinearImage, ToneMap};

/// Writes `image` as a PNG.
pub(super) fn encode(image: &LinearImage, tone: ToneMap, out: &mut impl Write) -> io::Result<()> {
    let bytes = tone.srgb_bytes(image);
    PngEncoder::new_with_quality(out, CompressionType::Fast, FilterType::Sub)
        .write_image(&bytes, image.width, image.height, image::ExtendedColorType::Rgb8)
        .map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_png_reads_back_as_the_tone_mapped_bytes() {
        let mut image = LinearImage::black(5, 3);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [0.01 * i as f32, 0.07 * i as f32, 0.5];
        }
        let mut file = Vec::new();
        encode(&image, ToneMap::default(), &mut file).unwrap();
        let read = image::load_from_memory(&file).unwrap().into_rgb8();
        assert_eq!((read.width(), read.height()), (5, 3));
        assert_eq!(read.into_raw(), ToneMap::default().srgb_bytes(&image));
    }
}
