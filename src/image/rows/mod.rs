//! Pictures that are written and read some rows at a time, so that their size is not bounded by memory.
//!
//! Rows go from top to bottom. A file appears when its last row is in it and not before: until then it is a temporary
//! neighbour, which vanishes with its writer.

mod exr_reader;
mod exr_writer;
mod f64_channels;
mod png_writer;

use std::borrow::Cow;

use exr::prelude::{self as openexr, IntegerBounds, Vec2};

use super::Attribute;

pub use exr_reader::ExrScanlineReader;
pub use exr_writer::ExrScanlineWriter;
pub use f64_channels::{join_f64, split_f64};
pub use png_writer::PngScanlineWriter;

/// What an EXR file holds: one part of scan lines.
#[derive(Clone, Debug)]
pub struct ExrLayout<'a> {
    /// The rectangle that the file has pixels of.
    pub data_window: Window,
    /// The whole picture, of which the file may hold a part.
    pub display_window: Window,
    /// Names, of which each is there once, in the order in which values are given. The file has them by name.
    pub channels: Vec<ExrChannel>,
    /// How rows are packed.
    pub compression: Compression,
    /// Texts beside the pixels; the last of those with one name counts.
    pub notes: &'a [Attribute<'a>],
}

impl ExrLayout<'_> {
    /// A whole picture of `size` (width and height), not compressed and without notes.
    pub fn of_size(size: [u32; 2], channels: Vec<ExrChannel>) -> ExrLayout<'static> {
        ExrLayout {
            data_window: Window::of_size(size),
            display_window: Window::of_size(size),
            channels,
            compression: Compression::None,
            notes: &[],
        }
    }
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Column and row of the pixel at the top left.
    pub origin: [i32; 2],
    /// Width and height in pixels.
    pub size: [u32; 2],
}

impl Window {
    /// The rectangle of a picture of `size`, width and height.
    pub fn of_size(size: [u32; 2]) -> Window {
        Window { origin: [0; 2], size }
    }

    fn of_bounds(bounds: IntegerBounds) -> Window {
        Window {
            origin: [bounds.position.x(), bounds.position.y()],
            size: [bounds.size.width() as u32, bounds.size.height() as u32],
        }
    }

    fn bounds(&self) -> IntegerBounds {
        let [x, y] = self.origin;
        let [width, height] = self.size.map(|side| side as usize);
        IntegerBounds::new(Vec2(x, y), Vec2(width, height))
    }
}

/// A channel of an EXR file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExrChannel {
    /// What the file calls it; dots in it group channels.
    pub name: String,
    /// What its values are.
    pub sample: SampleType,
}

impl ExrChannel {
    /// A channel called `name`.
    pub fn new(name: impl Into<String>, sample: SampleType) -> ExrChannel {
        ExrChannel {
            name: name.into(),
            sample,
        }
    }
}

/// What the values of a channel are, by OpenEXR's names.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
pub enum SampleType {
    /// 16-bit floats: 11 significant bits; beyond 65504 infinite, as OpenEXR's own conversion has it.
    Half,
    /// 32-bit floats, as rendered.
    #[default]
    Float,
    /// 32-bit unsigned integers.
    #[value(skip)]
    Uint,
}

impl SampleType {
    fn of_exr(sample: openexr::SampleType) -> SampleType {
        match sample {
            openexr::SampleType::F16 => SampleType::Half,
            openexr::SampleType::F32 => SampleType::Float,
            openexr::SampleType::U32 => SampleType::Uint,
        }
    }

    fn to_exr(self) -> openexr::SampleType {
        match self {
            SampleType::Half => openexr::SampleType::F16,
            SampleType::Float => openexr::SampleType::F32,
            SampleType::Uint => openexr::SampleType::U32,
        }
    }
}

/// How the rows of an EXR file are packed; all of these keep every bit.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, serde::Serialize, serde::Deserialize,
)]
pub enum Compression {
    /// Not at all: the fastest to write.
    #[default]
    None,
    /// Runs of equal bytes: fast, for flat pictures.
    Rle,
    /// Deflate, row by row.
    Zips,
    /// Deflate, 16 rows at a time.
    Zip,
    /// Wavelets, 32 rows at a time: for noisy pictures.
    Piz,
}

impl Compression {
    fn to_exr(self) -> openexr::Compression {
        match self {
            Compression::None => openexr::Compression::Uncompressed,
            Compression::Rle => openexr::Compression::RLE,
            Compression::Zips => openexr::Compression::ZIP1,
            Compression::Zip => openexr::Compression::ZIP16,
            Compression::Piz => openexr::Compression::PIZ,
        }
    }
}

/// Values of one channel, row by row, the top row first.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples<'a> {
    /// Of a channel of halves or floats.
    Floats(Cow<'a, [f32]>),
    /// Of a channel of integers.
    Integers(Cow<'a, [u32]>),
}

impl Samples<'_> {
    fn len(&self) -> usize {
        match self {
            Samples::Floats(values) => values.len(),
            Samples::Integers(values) => values.len(),
        }
    }

    /// Whether a channel of `sample` takes these values.
    fn fits(&self, sample: SampleType) -> bool {
        matches!(
            (self, sample),
            (Samples::Floats(_), SampleType::Half | SampleType::Float)
                | (Samples::Integers(_), SampleType::Uint)
        )
    }
}

impl<'a> From<&'a [f32]> for Samples<'a> {
    fn from(values: &'a [f32]) -> Samples<'a> {
        Samples::Floats(Cow::Borrowed(values))
    }
}

impl<'a> From<&'a [u32]> for Samples<'a> {
    fn from(values: &'a [u32]) -> Samples<'a> {
        Samples::Integers(Cow::Borrowed(values))
    }
}

impl From<Vec<f32>> for Samples<'_> {
    fn from(values: Vec<f32>) -> Self {
        Samples::Floats(Cow::Owned(values))
    }
}

impl From<Vec<u32>> for Samples<'_> {
    fn from(values: Vec<u32>) -> Self {
        Samples::Integers(Cow::Owned(values))
    }
}
