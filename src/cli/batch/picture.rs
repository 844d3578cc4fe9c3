//! Final pictures, written from rows: by whoever has all of a frame in memory, or all of its pieces on the disk, with
//! the same bytes.

use std::path::Path;
use std::{fs, io};

use crate::batch::{Done, FrameHead, Merge, MergeError, PieceFolder, Plane};
use crate::image::rows::{
    ExrChannel, ExrLayout, ExrScanlineWriter, PngScanlineWriter, SampleType, Samples, Window,
};
use crate::image::{Attribute, ChannelKind, ImageError, ImageFormat};

use super::super::failure::Failure;
use super::super::interrupt;

/// A picture that is being written.
enum Writer {
    Exr(Box<ExrScanlineWriter>),
    Png(Box<PngScanlineWriter>),
}

/// Writes a picture whose channels `rows` gives from the top to the bottom, block by block.
///
/// # Errors
///
/// Where rows cannot be had, or the disk is full; the picture is then as it was.
pub(super) fn write<E: From<ImageError>>(
    out: &Path,
    head: &FrameHead,
    mut rows: impl FnMut() -> Result<Option<Vec<Plane>>, E>,
) -> Result<(), E> {
    let path = out.join(&head.image);
    let mut writer = None;
    while let Some(planes) = rows()? {
        let writer = match &mut writer {
            Some(writer) => writer,
            None => writer.insert(Writer::begin(&path, head, &planes)?),
        };
        writer.add(&planes)?;
    }
    match writer {
        Some(Writer::Exr(writer)) => writer.finish()?,
        Some(Writer::Png(writer)) => writer.finish()?,
        None => {}
    }
    Ok(())
}

/// Puts a frame together from its pieces and removes these.
///
/// # Errors
///
/// Where some are missing, or the disk is full.
pub(in crate::cli) fn merge(out: &Path, folder: &PieceFolder) -> Result<(), MergeError> {
    let mut merge = Merge::of(folder)?;
    interrupt::finish_first(|| write(out, folder.head(), || merge.next_rows()))?;
    folder.remove();
    Ok(())
}

/// What is to be noted of a picture that stands in its place.
///
/// # Errors
///
/// Where it does not.
pub(in crate::cli) fn done(
    out: &Path,
    head: &FrameHead,
    samples: f64,
    [render_seconds, write_seconds]: [f64; 2],
) -> io::Result<Done> {
    Ok(Done {
        frame: head.number,
        image: head.image.clone(),
        key: head.key,
        bytes: fs::metadata(out.join(&head.image))?.len(),
        seconds: render_seconds + write_seconds,
        render_seconds,
        samples,
        spp: head.spp,
        by: super::who(),
    })
}

impl Writer {
    fn begin(path: &Path, head: &FrameHead, planes: &[Plane]) -> Result<Writer, ImageError> {
        let notes: Vec<Attribute> = head
            .notes
            .iter()
            .map(|(name, text)| Attribute { name, text })
            .collect();
        if ImageFormat::of_path(path) == Some(ImageFormat::Png) {
            let writer = PngScanlineWriter::create(path, head.size, head.png, &notes)?;
            return Ok(Writer::Png(Box::new(writer)));
        }
        let channel = |plane: &Plane| {
            let sample = match plane.kind {
                ChannelKind::Color => head.exr.sample,
                ChannelKind::Exact => SampleType::Float,
            };
            ExrChannel::new(&plane.name, sample)
        };
        let layout = ExrLayout {
            data_window: Window::of_size(head.size),
            display_window: Window::of_size(head.size),
            channels: in_order(planes).into_iter().map(channel).collect(),
            compression: head.exr.compression,
            notes: &notes,
        };
        Ok(Writer::Exr(Box::new(ExrScanlineWriter::create(path, &layout)?)))
    }

    fn add(&mut self, planes: &[Plane]) -> Result<(), ImageError> {
        match self {
            Writer::Exr(writer) => {
                let values: Vec<Samples> = in_order(planes)
                    .iter()
                    .map(|plane| plane.values[..].into())
                    .collect();
                writer.write_rows(&values)
            }
            Writer::Png(writer) => writer.write_rows(&colors(planes)),
        }
    }
}

/// Channels by name, as pieces have them; others may not.
fn in_order(planes: &[Plane]) -> Vec<&Plane> {
    let mut planes: Vec<&Plane> = planes.iter().collect();
    planes.sort_by(|a, b| a.name.cmp(&b.name));
    planes
}

/// The pixels of the channels of colours.
fn colors(planes: &[Plane]) -> Vec<[f32; 3]> {
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

impl From<MergeError> for Failure {
    fn from(error: MergeError) -> Failure {
        match error {
            MergeError::Piece(error) => error.into(),
            error => Failure::Work(error.to_string()),
        }
    }
}
