//! OpenEXR files: linear RGB and additional channels, in one part of scan lines.

use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

use exr::prelude::{self as openexr, ReadChannels, ReadLayers};

use super::atomic_file::write_error;
use super::rows::{Compression, ExrChannel, ExrLayout, ExrScanlineWriter, SampleType, Samples};
use super::{Attribute, ChannelKind, ImageChannel, ImageError, LinearImage};

/// Sample type and compression of an EXR file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ExrEncoding {
    /// Sample type of colours: floats or halves.
    pub sample: SampleType,
    /// Compression method of the rows.
    pub compression: Compression,
}

/// Number of rows that are converted to planar channels at once: whole blocks for any compression.
const ROWS: usize = 32;

/// Writes `image` with additional channels, of one value per pixel, to `path` as an EXR file.
pub(super) fn write(
    image: &LinearImage,
    extra: &[ImageChannel],
    encoding: ExrEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    // Check channel lengths before the file is created
    check_lengths(image, extra).map_err(|error| write_error(path, &error))?;
    let layout = ExrLayout {
        compression: encoding.compression,
        notes,
        ..ExrLayout::of_size([image.width, image.height], channels(extra, encoding.sample))
    };
    let mut writer = ExrScanlineWriter::create(path, &layout)?;
    // Convert and write the image in groups of whole blocks
    let pixels_at_once = ROWS * image.width as usize;
    for (index, pixels) in image.pixels.chunks(pixels_at_once).enumerate() {
        let start = index * pixels_at_once;
        let plane = |channel: usize| pixels.iter().map(|pixel| pixel[channel]).collect::<Vec<f32>>();
        let colors = [0, 1, 2].map(|channel| Samples::from(plane(channel)));
        let others = extra
            .iter()
            .map(|channel| Samples::from(&channel.values[start..start + pixels.len()]));
        let rows: Vec<Samples> = colors.into_iter().chain(others).collect();
        writer.write_rows(&rows)?;
    }
    writer.finish()
}

/// Checks that each channel has one value per pixel.
fn check_lengths(image: &LinearImage, extra: &[ImageChannel]) -> io::Result<()> {
    let pixel_count = image.pixels.len();
    match extra.iter().find(|channel| channel.values.len() != pixel_count) {
        None => Ok(()),
        Some(channel) => Err(io::Error::other(format!(
            "channel {} has {} values for {pixel_count} pixels",
            channel.name,
            channel.values.len()
        ))),
    }
}

/// Returns the file's channels: R, G and B, then the additional ones.
fn channels(extra: &[ImageChannel], color: SampleType) -> Vec<ExrChannel> {
    let colors = ["R", "G", "B"].map(|name| ExrChannel::new(name, color));
    let others = extra.iter().map(|channel| {
        let sample = match channel.kind {
            ChannelKind::Exact => SampleType::Float,
            ChannelKind::Color => color,
        };
        ExrChannel::new(channel.name, sample)
    });
    colors.into_iter().chain(others).collect()
}

/// Reads the R, G and B channels of the first layer that has all three.
pub(super) fn read(path: &Path) -> Result<LinearImage, ImageError> {
    let fault = |error: exr::error::Error| ImageError::Read {
        path: path.to_owned(),
        message: error.to_string(),
    };
    let file = File::open(path).map_err(|error| fault(error.into()))?;
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
        .from_buffered(&mut BufReader::new(file))
        .map(|file| file.layer_data.channel_data.pixels)
        .map_err(fault)
}

#[cfg(test)]
mod tests {
    use exr::prelude::{AttributeValue, FlatSamples, Text};

    use super::super::{ImageFormat, SOFTWARE, ToneMap, write, write_exr_with};
    use super::*;

    const PLAIN: ExrEncoding = ExrEncoding {
        sample: SampleType::Float,
        compression: Compression::None,
    };

    #[test]
    fn exr_keeps_every_bit_and_names_its_writer() {
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
    fn metadata_is_stored_as_ascii() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let note = Attribute {
            name: "whit.plan",
            text: "shadow on: light `Ü`\n",
        };
        write_exr_with(&LinearImage::black(2, 2), &[], PLAIN, &[note], &path).unwrap();
        let meta = exr::meta::MetaData::read_from_file(&path, true).unwrap();
        let kept = &meta.headers[0].own_attributes.other[&Text::from("whit.plan")];
        assert_eq!(*kept, AttributeValue::Text(Text::from("shadow on: light `?`\n")));
    }

    #[test]
    fn extra_channels_do_not_change_the_image() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut image = LinearImage::black(5, 3);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32, 0.5, -1.0];
        }
        let values: Vec<f32> = (0..15).map(|i| 0.25 * i as f32).collect();
        let channel = |name| ImageChannel::exact(name, &values);
        write_exr_with(&image, &[channel("variance"), channel("a.b")], PLAIN, &[], &path).unwrap();
        assert_eq!(super::super::read_exr(&path).unwrap(), image);
        let file = openexr::read_first_flat_layer_from_file(&path).unwrap();
        let channels = &file.layer_data.channel_data.list;
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        assert_eq!(names, ["B", "G", "R", "a.b", "variance"]);
        assert_eq!(channels[4].sample_data, FlatSamples::F32(values.clone()));
        let short = ImageChannel::exact("short", &values[1..]);
        let message = write_exr_with(&image, &[short], PLAIN, &[], &path)
            .unwrap_err()
            .to_string();
        assert!(message.contains("14 values for 15 pixels"), "{message}");
    }

    #[test]
    fn half_floats_store_only_colours_and_round_to_nearest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut image = LinearImage::black(1, 1);
        // 2049 lies halfway between the halves 2048, which is even, and 2050; beyond 65504 halves are infinite.
        image.pixels[0] = [2049.0, 1e6, -0.125];
        let extra = [
            ImageChannel::color("albedo.R", &[2049.0]),
            ImageChannel::exact("depth", &[2049.0]),
        ];
        let encoding = ExrEncoding {
            sample: SampleType::Half,
            compression: Compression::Zip,
        };
        write_exr_with(&image, &extra, encoding, &[], &path).unwrap();
        let file = openexr::read_first_flat_layer_from_file(&path).unwrap();
        let values: Vec<(String, f32, bool)> = file
            .layer_data
            .channel_data
            .list
            .iter()
            .map(|channel| {
                let is_half = matches!(channel.sample_data, FlatSamples::F16(_));
                let value = channel.sample_data.values_as_f32().next().unwrap();
                (channel.name.to_string(), value, is_half)
            })
            .collect();
        let value = |name: &str, value, is_half| (name.to_owned(), value, is_half);
        assert_eq!(
            values,
            [
                value("B", -0.125, true),
                value("G", f32::INFINITY, true),
                value("R", 2048.0, true),
                value("albedo.R", 2048.0, true),
                value("depth", 2049.0, false),
            ]
        );
        assert_eq!(
            super::super::read_exr(&path).unwrap().pixels,
            [[2048.0, f32::INFINITY, -0.125]]
        );
    }

    #[test]
    fn non_exr_file_is_rejected_in_one_sentence() {
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
