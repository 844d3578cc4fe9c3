//! Writing of final images from rows in memory or from pieces on disk, with identical bytes in both cases.

use std::path::Path;

use super::chunk_directory::{ChunkDirectory, FrameMetadata};
use super::merge::{Merge, MergeError};
use crate::batch::ongoing_writes::OngoingWrites;
use crate::batch::request::ALPHA;
use crate::image::rows::{
    ExrChannel, ExrLayout, ExrScanlineWriter, PngScanlineWriter, RowWindow, SampleType, Samples,
};
use crate::image::{ChannelKind, ImageError, ImageFormat, PngChannels};
use crate::render::Layer;

/// Scanline writer of an image, by its format.
enum ImageWriter {
    Exr(Box<ExrScanlineWriter>),
    Png(Box<PngScanlineWriter>),
}

/// Writes an image whose channels `rows` returns from top to bottom, block by block.
pub(in crate::batch) fn write<E: From<ImageError>>(
    out: &Path,
    head: &FrameMetadata,
    mut rows: impl FnMut() -> Result<Option<Vec<Layer>>, E>,
) -> Result<(), E> {
    let path = out.join(&head.image);
    let mut writer = None;
    while let Some(planes) = rows()? {
        // The first rows give the channels of the file
        let writer = match &mut writer {
            Some(writer) => writer,
            None => writer.insert(ImageWriter::begin(&path, head, &planes)?),
        };
        writer.add(&planes)?;
    }
    match writer {
        Some(ImageWriter::Exr(writer)) => writer.finish()?,
        Some(ImageWriter::Png(writer)) => writer.finish()?,
        None => {}
    }
    Ok(())
}

/// Merges a frame from its pieces and removes the pieces.
pub(in crate::batch) fn merge(
    out: &Path,
    folder: &ChunkDirectory,
    writes: &OngoingWrites,
) -> Result<(), MergeError> {
    let mut merge = Merge::of(folder)?;
    writes.during(|| write(out, folder.head(), || merge.next_rows()))?;
    folder.remove();
    Ok(())
}

impl ImageWriter {
    fn begin(path: &Path, head: &FrameMetadata, planes: &[Layer]) -> Result<ImageWriter, ImageError> {
        let notes = head.notes.list();
        if ImageFormat::of_path(path) == Some(ImageFormat::Png) {
            // Coverage needs a fourth channel
            let channels = match alpha(planes) {
                None => PngChannels::Rgb,
                Some(_) => PngChannels::Rgba,
            };
            let writer = PngScanlineWriter::create_with(path, head.size, channels, head.png, &notes)?;
            return Ok(ImageWriter::Png(Box::new(writer)));
        }
        let channel = |plane: &Layer| {
            // Only colours may be rounded to half precision
            let sample = match plane.kind {
                ChannelKind::Color => head.exr.sample,
                ChannelKind::Exact => SampleType::Float,
            };
            ExrChannel::new(&plane.name, sample)
        };
        let layout = ExrLayout {
            data_window: RowWindow::of_size(head.size),
            display_window: RowWindow::of_size(head.size),
            channels: sorted_by_name(planes).into_iter().map(channel).collect(),
            compression: head.exr.compression,
            notes: &notes,
        };
        Ok(ImageWriter::Exr(Box::new(ExrScanlineWriter::create(
            path, &layout,
        )?)))
    }

    fn add(&mut self, planes: &[Layer]) -> Result<(), ImageError> {
        match self {
            ImageWriter::Exr(writer) => {
                let values: Vec<Samples> = sorted_by_name(planes)
                    .iter()
                    .map(|plane| plane.values[..].into())
                    .collect();
                writer.write_rows(&values)
            }
            ImageWriter::Png(writer) => match alpha(planes) {
                None => writer.write_rows(&colors(planes)),
                Some(alpha) => writer.write_rows_with_alpha(&colors(planes), alpha),
            },
        }
    }
}

/// Returns the channels sorted by name, the order in which pieces store them; rows in memory may have another.
fn sorted_by_name(planes: &[Layer]) -> Vec<&Layer> {
    let mut planes: Vec<&Layer> = planes.iter().collect();
    planes.sort_by(|a, b| a.name.cmp(&b.name));
    planes
}

/// Returns the coverage of the pixels, if there is such a channel.
fn alpha(planes: &[Layer]) -> Option<&[f32]> {
    let plane = planes.iter().find(|plane| plane.name == ALPHA);
    plane.map(|plane| &plane.values[..])
}

/// Returns the pixels of the channels R, G and B.
pub(in crate::batch) fn colors(planes: &[Layer]) -> Vec<[f32; 3]> {
    let plane = |name: &str| {
        planes
            .iter()
            .find(|plane| plane.name == name)
            .map_or(&[][..], |plane| &plane.values)
    };
    let [red, green, blue] = ["R", "G", "B"].map(plane);
    let pixels = red.iter().zip(green).zip(blue);
    pixels.map(|((&r, &g), &b)| [r, g, b]).collect()
}
