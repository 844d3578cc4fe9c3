//! OpenEXR: 32-bit float linear RGB and further channels beside it, in one part of uncompressed scan lines.
//!
//! Not compressed: rendered floats shrink little, and on this path writing plain bytes is the faster way.

use std::io::{self, Seek, Write};
use std::path::Path;

use exr::image::write::channels::WritableChannels;
use exr::prelude::{
    self as openexr, AnyChannel, AnyChannels, AttributeValue, Encoding, FlatSamples, Image, Layer,
    LayerAttributes, ReadChannels, ReadLayers, SpecificChannels, Text, Vec2, WritableImage,
};

use super::{ExtraChannel, ImageError, LinearImage, Note, SOFTWARE};

/// Writes `image` as an EXR file.
pub(super) fn encode(image: &LinearImage, notes: &[Note], out: &mut (impl Write + Seek)) -> io::Result<()> {
    let width = image.width as usize;
    let channels = SpecificChannels::rgb(|position: Vec2<usize>| {
        let [r, g, b] = image.pixels[position.y() * width + position.x()];
        (r, g, b)
    });
    Image::from_layer(layer(image, channels, notes))
        .write()
        .non_parallel()
        .to_buffered(out)
        .map_err(io::Error::other)
}

/// Writes `image` with further channels, which hold a value a pixel.
pub(super) fn encode_with(
    image: &LinearImage,
    extra: &[ExtraChannel],
    notes: &[Note],
    out: &mut (impl Write + Seek),
) -> io::Result<()> {
    let pixel_count = image.pixels.len();
    if let Some(channel) = extra.iter().find(|channel| channel.values.len() != pixel_count) {
        return Err(io::Error::other(format!(
            "channel {} has {} values for {pixel_count} pixels",
            channel.name,
            channel.values.len()
        )));
    }
    let plane = |channel: usize| image.pixels.iter().map(|pixel| pixel[channel]).collect();
    let rgb = ["R", "G", "B"]
        .into_iter()
        .enumerate()
        .map(|(channel, name)| AnyChannel::new(name, FlatSamples::F32(plane(channel))));
    let others = extra
        .iter()
        .map(|channel| AnyChannel::new(channel.name, FlatSamples::F32(channel.values.to_vec())));
    let channels = AnyChannels::sort(rgb.chain(others).collect());
    Image::from_layer(layer(image, channels, notes))
        .write()
        .non_parallel()
        .to_buffered(out)
        .map_err(io::Error::other)
}

/// The one part of a file.
fn layer<'c, C: WritableChannels<'c> + 'c>(image: &LinearImage, channels: C, notes: &[Note]) -> Layer<C> {
    let size = (image.width as usize, image.height as usize);
    Layer::new(size, attributes(notes), Encoding::UNCOMPRESSED, channels)
}

fn attributes(notes: &[Note]) -> LayerAttributes {
    let ascii = |text: &str| Text::new_or_none(text.replace(|c: char| !c.is_ascii(), "?"));
    let attribute = |note: &Note| Some((Text::from(note.name), AttributeValue::Text(ascii(note.text)?)));
    LayerAttributes {
        software_name: Some(Text::from(SOFTWARE)),
        other: notes.iter().filter_map(attribute).collect(),
        ..LayerAttributes::default()
    }
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
    use super::super::{ImageFormat, ToneMap, write, write_exr_with};
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
    fn notes_are_kept_as_ascii() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let note = Note {
            name: "whit.plan",
            text: "shadow on: light `Ü`\n",
        };
        write_exr_with(&LinearImage::black(2, 2), &[], &[note], &path).unwrap();
        let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
        let kept = &meta.headers[0].own_attributes.other[&Text::from("whit.plan")];
        assert_eq!(*kept, AttributeValue::Text(Text::from("shadow on: light `?`\n")));
    }

    #[test]
    fn further_channels_stand_beside_the_picture_and_leave_it_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut image = LinearImage::black(5, 3);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32, 0.5, -1.0];
        }
        let values: Vec<f32> = (0..15).map(|i| 0.25 * i as f32).collect();
        let channel = |name| ExtraChannel {
            name,
            values: &values,
        };
        write_exr_with(&image, &[channel("variance"), channel("a.b")], &[], &path).unwrap();
        assert_eq!(super::super::read_exr(&path).unwrap(), image);
        let file = openexr::read_first_flat_layer_from_file(&path).unwrap();
        let channels = &file.layer_data.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(names, ["B", "G", "R", "a.b", "variance"]);
        assert_eq!(channels[4].sample_data, FlatSamples::F32(values.clone()));
        let short = ExtraChannel {
            name: "short",
            values: &values[1..],
        };
        let message = write_exr_with(&image, &[short], &[], &path)
            .unwrap_err()
            .to_string();
        assert!(message.contains("14 values for 15 pixels"), "{message}");
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
