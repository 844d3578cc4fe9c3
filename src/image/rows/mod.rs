//! Streaming scanline I/O: images are written and read some rows at a time, so that their size is not bounded by
//! memory.
//!
//! Rows go from top to bottom. A file appears only when it is complete: until then it is a temporary file in the same
//! folder, which is deleted with its writer.

mod exr_reader;
mod exr_writer;
mod f64_channels;
mod png_writer;

use std::borrow::Cow;

use exr::prelude::{self as openexr, IntegerBounds, Vec2};

use super::Attribute;

pub use exr_reader::ExrScanlineReader;
pub use exr_writer::ExrScanlineWriter;
pub(crate) use f64_channels::{join_f64, split_f64};
pub use png_writer::PngScanlineWriter;

/// Layout of an EXR file with one part of scan lines.
#[derive(Clone, Debug)]
pub struct ExrLayout<'a> {
    /// Rectangle of pixels that the file contains.
    pub data_window: RowWindow,
    /// Rectangle of the complete image, of which the file may contain a part.
    pub display_window: RowWindow,
    /// Channels with unique names, in the order in which the caller gives values. The file sorts them by name.
    pub channels: Vec<ExrChannel>,
    /// Compression method of the rows.
    pub compression: Compression,
    /// Text attributes; of several with one name, the last is written.
    pub notes: &'a [Attribute<'a>],
}

impl ExrLayout<'_> {
    /// Returns the layout of a complete image of `size` (width and height), uncompressed and without attributes.
    pub fn of_size(size: [u32; 2], channels: Vec<ExrChannel>) -> ExrLayout<'static> {
        ExrLayout {
            data_window: RowWindow::of_size(size),
            display_window: RowWindow::of_size(size),
            channels,
            compression: Compression::None,
            notes: &[],
        }
    }
}

/// Rectangle of pixels in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowWindow {
    /// Column and row of the pixel at the top left.
    pub origin: [i32; 2],
    /// Width and height in pixels.
    pub size: [u32; 2],
}

impl RowWindow {
    /// Returns the rectangle of an image of `size`, width and height.
    pub fn of_size(size: [u32; 2]) -> RowWindow {
        RowWindow { origin: [0; 2], size }
    }

    /// Converts from the rectangle type of the `exr` crate.
    fn of_bounds(bounds: IntegerBounds) -> RowWindow {
        RowWindow {
            origin: [bounds.position.x(), bounds.position.y()],
            size: [bounds.size.width() as u32, bounds.size.height() as u32],
        }
    }

    /// Converts to the rectangle type of the `exr` crate.
    fn bounds(&self) -> IntegerBounds {
        let [x, y] = self.origin;
        let [width, height] = self.size.map(|side| side as usize);
        IntegerBounds::new(Vec2(x, y), Vec2(width, height))
    }
}

/// Channel of an EXR file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExrChannel {
    /// Name of the channel; dots in it group channels into layers.
    pub name: String,
    /// Type of its values.
    pub sample: SampleType,
}

impl ExrChannel {
    /// Creates a channel with the given name and type.
    pub fn new(name: impl Into<String>, sample: SampleType) -> ExrChannel {
        ExrChannel {
            name: name.into(),
            sample,
        }
    }
}

/// Type of the values of a channel, by OpenEXR's names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum SampleType {
    /// 16-bit floats: 11 significant bits; infinite beyond 65504, as in OpenEXR's own conversion.
    Half,
    /// 32-bit floats, as rendered.
    #[default]
    Float,
    /// 32-bit unsigned integers, for ids and parts of f64.
    #[cfg_attr(feature = "cli", value(skip))]
    Uint,
}

impl SampleType {
    /// Converts from the type of the `exr` crate.
    fn of_exr(sample: openexr::SampleType) -> SampleType {
        match sample {
            openexr::SampleType::F16 => SampleType::Half,
            openexr::SampleType::F32 => SampleType::Float,
            openexr::SampleType::U32 => SampleType::Uint,
        }
    }

    /// Converts to the type of the `exr` crate.
    fn to_exr(self) -> openexr::SampleType {
        match self {
            SampleType::Half => openexr::SampleType::F16,
            SampleType::Float => openexr::SampleType::F32,
            SampleType::Uint => openexr::SampleType::U32,
        }
    }
}

/// Compression of an EXR file; all of these are lossless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Compression {
    /// No compression: the fastest to write.
    #[default]
    None,
    /// Run-length encoding of equal bytes: fast, for flat images.
    Rle,
    /// Deflate, each row on its own.
    Zips,
    /// Deflate, 16 rows at a time.
    Zip,
    /// Wavelets, 32 rows at a time: for noisy images.
    Piz,
}

impl Compression {
    /// Converts to the type of the `exr` crate.
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
    /// Values of a channel of halves or floats.
    Floats(Cow<'a, [f32]>),
    /// Values of a channel of integers.
    Integers(Cow<'a, [u32]>),
}

impl Samples<'_> {
    /// Returns the number of values.
    fn len(&self) -> usize {
        match self {
            Samples::Floats(values) => values.len(),
            Samples::Integers(values) => values.len(),
        }
    }

    /// Returns whether a channel of type `sample` can store these values.
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
