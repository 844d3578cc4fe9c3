//! Contents of a piece's file: finished rows, or sums of samples.
//!
//! Finished rows are stored as the final channels of the image. Rows of a share are stored as sums of samples in f64,
//! for which EXR has no channel type: each is split into two integer channels, so that no bit is lost. The data window
//! gives the rows.

use std::ops::Range;
use std::path::{Path, PathBuf};

use super::chunk::{Chunk, ChunkKind};
use crate::image::rows::{ExrChannel, ExrScanlineReader, SampleType, Samples, join_f64, split_f64};
use crate::image::{ChannelKind, ImageError};
use crate::render::{Layer, PartSums};

/// Header attribute with the number of samples per pixel of a share.
const SAMPLES: &str = "whit.samples";
/// Header attribute with the names of the colour channels of finished rows.
const COLORS: &str = "whit.colors";

/// Prefixes of the channel names of sums.
const RADIANCE: &str = "radiance";
const WEIGHTED: &str = "weighted";
const SQUARES: &str = "squares";

/// Rows read from a piece.
#[derive(Debug)]
pub(crate) enum ChunkRows {
    /// Channels of finished rows.
    Finished(Vec<Layer>),
    /// Sums of the samples of a share.
    PartSums(PartSums),
}

/// Contents of a piece's file.
pub(super) struct EncodedRows<'a> {
    /// Channels of the file.
    pub(super) channels: Vec<ExrChannel>,
    /// Values of each channel, the top row first.
    pub(super) values: Vec<Samples<'a>>,
    /// Name and text of the attribute that reading the channels requires.
    pub(super) note: (&'static str, String),
}

impl<'a> EncodedRows<'a> {
    /// Returns the contents for finished rows.
    pub(super) fn of_planes(planes: &'a [Layer]) -> EncodedRows<'a> {
        // Record which channels are colours
        let colors = planes.iter().filter(|plane| plane.kind == ChannelKind::Color);
        let colors: Vec<&str> = colors.map(|plane| plane.name.as_str()).collect();
        let channel = |plane: &Layer| ExrChannel::new(&plane.name, SampleType::Float);
        EncodedRows {
            channels: planes.iter().map(channel).collect(),
            values: planes.iter().map(|plane| plane.values[..].into()).collect(),
            note: (COLORS, colors.join(" ")),
        }
    }

    /// Returns the contents for rows of a share, each f64 channel split into two integer channels.
    pub(super) fn of_sums(sums: &PartSums) -> EncodedRows<'static> {
        let planes = sum_planes(sums);
        let channels = planes.iter().flat_map(|(name, _)| {
            ["high", "low"].map(|half| ExrChannel::new(format!("{name}.{half}"), SampleType::Uint))
        });
        let values = planes.iter().flat_map(|(_, values)| split_f64(values));
        EncodedRows {
            channels: channels.collect(),
            values: values.map(Samples::from).collect(),
            // The mean is computed from the number of samples.
            note: (SAMPLES, sums.samples.to_string()),
        }
    }
}

/// Open piece, from which rows can be read.
#[derive(Debug)]
pub(crate) struct ChunkReader {
    piece: Chunk,
    path: PathBuf,
    reader: ExrScanlineReader,
}

impl ChunkReader {
    /// Returns the reader of a piece whose file is open.
    pub(super) fn new(piece: &Chunk, path: &Path, reader: ExrScanlineReader) -> ChunkReader {
        ChunkReader {
            piece: piece.clone(),
            path: path.to_owned(),
            reader,
        }
    }

    /// Returns the rows and samples of the piece.
    pub(crate) fn piece(&self) -> &Chunk {
        &self.piece
    }

    /// Reads some rows, given by their numbers in the image.
    pub(crate) fn read(&mut self, rows: &Range<u32>) -> Result<ChunkRows, ImageError> {
        let first = self.piece.rows.start;
        let values = self.reader.read_rows(rows.start - first..rows.end - first)?;
        let names = self.reader.channels().iter().map(|channel| channel.name.clone());
        // Finished rows: restore the kind of each channel
        if self.piece.part == ChunkKind::All {
            let colors = self.reader.note(COLORS).unwrap_or_default();
            let kind = |name: &str| match colors.split(' ').any(|color| color == name) {
                true => ChannelKind::Color,
                false => ChannelKind::Exact,
            };
            let plane = |(name, values): (String, Samples)| match values {
                Samples::Floats(values) => Some(Layer {
                    kind: kind(&name),
                    name,
                    values: values.into_owned(),
                }),
                Samples::Integers(_) => None,
            };
            let planes: Option<Vec<Layer>> = names.zip(values).map(plane).collect();
            return planes.map(ChunkRows::Finished).ok_or_else(|| damaged(&self.path));
        }
        // Rows of a share: join the integer channels to sums in f64
        let planes: Vec<(String, Samples)> = names.zip(values).collect();
        let samples = self.reader.note(SAMPLES).and_then(|text| text.parse().ok());
        samples
            .and_then(|samples| sums_of(samples, &planes))
            .map(ChunkRows::PartSums)
            .ok_or_else(|| damaged(&self.path))
    }
}

/// Returns the error for a file of the frame with missing or wrong contents.
pub(super) fn damaged(path: &Path) -> ImageError {
    ImageError::Unusable {
        path: path.to_owned(),
        fault: "this piece lacks data of its frame".into(),
        remedy: "remove it",
    }
}

/// Returns the named channels of sums, without splitting the values.
fn sum_planes(sums: &PartSums) -> Vec<(String, Vec<f64>)> {
    fn planes<const N: usize>(name: &str, sums: &[[f64; N]]) -> Vec<(String, Vec<f64>)> {
        let plane = |channel: usize| sums.iter().map(|sum| sum[channel]).collect();
        (0..N)
            .map(|channel| (format!("{name}.{channel}"), plane(channel)))
            .collect()
    }
    let mut all = planes(RADIANCE, &sums.radiance);
    if let Some(weighted) = &sums.weighted {
        all.extend(planes(WEIGHTED, weighted));
    }
    if let Some(squares) = &sums.squares {
        all.push((SQUARES.into(), squares.clone()));
    }
    all
}

/// Returns the sums that these channels hold, or `None` if a mandatory channel is missing.
fn sums_of(samples: u32, planes: &[(String, Samples)]) -> Option<PartSums> {
    let half = |name: String| match planes.iter().find(|(plane, _)| *plane == name)? {
        (_, Samples::Integers(values)) => Some(values),
        (_, Samples::Floats(_)) => None,
    };
    // Join the halves of a channel, which is absent if one of them is
    let plane = |name: &str| {
        Some(join_f64(
            half(format!("{name}.high"))?,
            half(format!("{name}.low"))?,
        ))
    };
    // Interleave the channels to one array per pixel
    fn zipped<const N: usize>(planes: [Option<Vec<f64>>; N]) -> Option<Vec<[f64; N]>> {
        let planes: Vec<Vec<f64>> = planes.into_iter().collect::<Option<_>>()?;
        let sums = (0..planes[0].len()).map(|pixel| std::array::from_fn(|channel| planes[channel][pixel]));
        Some(sums.collect())
    }
    Some(PartSums {
        samples,
        radiance: zipped([0, 1, 2].map(|channel| plane(&format!("{RADIANCE}.{channel}"))))?,
        weighted: zipped([0, 1, 2, 3].map(|channel| plane(&format!("{WEIGHTED}.{channel}")))),
        squares: plane(SQUARES),
    })
}
