//! OpenEXR: 32-bit float linear RGB, uncompressed scan lines.
//!
//! Not compressed: rendered floats shrink little, and on this path writing plain bytes is the faster way.

use std::io::{self, Seek, Write};
use std::path::Path;

use exr::prelude::{
    self as openexr, Encoding, Image, Layer, LayerAttributes, ReadChannels, ReadLayers, SpecificChannels,
    Text, Vec2, WritableImage,
};

use super::{ImageError, LinearImage, SOFTWARE};

/// Writes `image` as an EXR file.
pub(super) fn encode(image: &LinearImage, out: &mut (impl Write + Seek)) -> io::Result<()> {
    let width = image.width as usize;
    let channels = SpecificChannels::rgb(|position: Vec2<usize>| {
        let [r, g, b] = image.pixels[position.y() * width + position.x()];
        (r, g, b)
    });
    let attributes = LayerAttributes {
        software_name: Some(Text::from(SOFTWARE)),
        ..LayerAttributes::default()
    };
    let size = (width, image.height as usize);
    Image::from_layer(Layer::new(size, attributes, Encoding::UNCOMPRESSED, channels))
        .write()
        .non_parallel()
        .to_buffered(out)
        .map_err(io::Error::other)
}

/// Reads the R, G and B channels of the first layer that has them.
pub(super) fn read(path: &Path) -> Result<LinearImage, ImageError> {
    openexr::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| LinearImage::black(size.width() as u32, size.height() as u32),
            |image: &mut LinearImage, position, (r, g, b): (f32, f32, f32)| {
                let index = position.y() * image.width as usize + position.x();
                image.pixels[index] = [r, g, b];
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map(|file| file.layer_data.channel_data.pixels)
        .map_err(|error| ImageError::Read {
            path: path.to_owned(),
            message: error.to_string(),
        })
}

#[cfg(test)]
mod tests {
    use super::super::{ImageFormat, ToneMap, write};
    use super::*;

    #[test]
    fn an_exr_keeps_every_bit_and_names_its_maker() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut image = LinearImage::black(7, 4);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [1.0 / (1.0 + i as f32), 1e30 * i as f32, f32::from_bits(i as u32)];
        }
        write(&image, &path, ImageFormat::Exr, ToneMap { exposure_ev: 3.0 }).unwrap();
        assert_eq!(super::super::read_exr(&path).unwrap(), image);
        let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
        let software = meta.headers[0].own_attributes.software_name.as_ref().unwrap();
        assert_eq!(software.to_string(), SOFTWARE);
    }

    #[test]
    fn a_file_that_is_no_exr_is_refused_in_one_sentence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        std::fs::write(&path, b"not an image").unwrap();
        let message = super::super::read_exr(&path).unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("could not read {}", path.display())),
            "{message}"
        );
    }
}
