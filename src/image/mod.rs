//! Images: linear radiance in memory, PNG and EXR on disk; and reading those that become textures.
//!
//! Everything up to here is linear RGB radiance; exposure and the sRGB curve happen only on the way into a PNG
//! ([`ToneMap`]); [`metrics`] tell how far two pictures lie apart. Files appear whole or not at all: they are written
//! beside their place, forced to the disk and renamed into it. Pictures larger than memory go row by row ([`rows`]).

mod atomic_file;
pub mod cryptomatte;
mod decode;
mod exr;
mod load;
pub mod metrics;
mod png;
pub mod rows;
mod tonemap;

use std::fmt;
use std::path::{Path, PathBuf};

use crate::parallel;

pub use self::exr::ExrEncoding;
pub use self::png::{PngBits, PngEncoding};
pub use atomic_file::{check_writable, write_atomically};
pub use decode::{DecodedImage, DecodedPixels, TransferCurve, read, read_size};
pub use load::{LoadedImage, read_picture};
pub use tonemap::{ToneMap, linear_from_srgb};

/// Linear RGB radiance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearImage {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels, row by row, the top row first.
    pub pixels: Vec<[f32; 3]>,
}

impl LinearImage {
    /// A black image.
    pub fn black(width: u32, height: u32) -> LinearImage {
        LinearImage {
            width,
            height,
            pixels: vec![[0.0; 3]; width as usize * height as usize],
        }
    }

    /// The pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// If there is no such pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 3] {
        assert!(x < self.width, "column {x} of {}", self.width);
        self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// How many pixels hold a NaN or an infinity: 0 in a sound picture.
    pub fn non_finite_count(&self) -> usize {
        const CHUNK: usize = 1 << 14;
        let counts = parallel::map_chunks(&self.pixels, CHUNK, &|_, chunk| {
            chunk.iter().filter(|p| !p.iter().all(|c| c.is_finite())).count()
        });
        counts.iter().sum()
    }
}

/// A text that a file carries beside its pixels.
#[derive(Clone, Copy, Debug)]
pub struct Attribute<'a> {
    /// Its name: ASCII, at most 79 letters.
    pub name: &'a str,
    /// What it says; in an EXR what is not ASCII becomes a question mark.
    pub text: &'a str,
}

/// The kinds of image file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Hash)]
pub enum ImageFormat {
    /// sRGB, after exposure.
    #[default]
    Png,
    /// Floating-point linear RGB, as rendered.
    Exr,
}

impl ImageFormat {
    /// The format that a file's name asks for by its ending, in any case.
    pub fn of_path(path: &Path) -> Option<ImageFormat> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "png" => Some(ImageFormat::Png),
            "exr" => Some(ImageFormat::Exr),
            _ => None,
        }
    }
}

impl fmt::Display for ImageFormat {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            ImageFormat::Png => "png",
            ImageFormat::Exr => "exr",
        })
    }
}

/// Why an image file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The folder of an output file does not exist.
    #[error("there is no folder {} for {}: make it first", .folder.display(), .path.display())]
    NoFolder {
        /// The file that was to be written.
        path: PathBuf,
        /// What is missing.
        folder: PathBuf,
    },
    /// The output's name is taken by a folder.
    #[error("{} is a folder: name a file", .0.display())]
    IsFolder(PathBuf),
    /// The folder of an output file takes no files.
    #[error("cannot write into the folder {}: {source}", .folder.display())]
    NotWritable {
        /// Where a file was attempted.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Writing failed half-way; nothing is left of it.
    #[error("could not write {}: {message}", .path.display())]
    Write {
        /// The file that was to be written.
        path: PathBuf,
        /// What the system or the encoder said.
        message: String,
    },
    /// A file is no image that could be used.
    #[error("{}: {fault}: {remedy}", .path.display())]
    Unusable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Reading failed.
    #[error("could not read {} as an EXR image: {message}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system or the decoder said.
        message: String,
    },
}

/// Writes `image` to `path` in `format`; `tonemap` applies to PNG only, as an EXR keeps what was rendered.
///
/// The file appears whole or, on an error, not at all; what stood there before stays until then.
pub fn write(image: &LinearImage, path: &Path, format: ImageFormat, tone: ToneMap) -> Result<(), ImageError> {
    match format {
        ImageFormat::Png => {
            let encoding = PngEncoding {
                tone,
                ..PngEncoding::default()
            };
            write_png_with(image, encoding, &[], path)
        }
        ImageFormat::Exr => write_exr_with(image, &[], ExrEncoding::default(), &[], path),
    }
}

/// Writes `image` and notes to `path` as a PNG, whole or, on an error, not at all.
pub fn write_png_with(
    image: &LinearImage,
    encoding: PngEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    write_atomically(path, |file| png::encode(image, &encoding, notes, file))
}

/// `image` as the bytes of a PNG, for what holds pictures itself.
///
/// # Errors
///
/// Where the picture has more pixels than a PNG.
pub fn png_bytes(image: &LinearImage, tone: ToneMap) -> std::io::Result<Vec<u8>> {
    let encoding = PngEncoding {
        tone,
        ..PngEncoding::default()
    };
    let mut bytes = Vec::new();
    png::encode(image, &encoding, &[], &mut bytes)?;
    Ok(bytes)
}

/// One more value a pixel, for the channels of an EXR file.
#[derive(Clone, Copy, Debug)]
pub struct ImageChannel<'a> {
    /// What the file calls it; dots in it group channels.
    pub name: &'a str,
    /// As many as there are pixels, row by row, the top row first.
    pub values: &'a [f32],
    /// Whether a file of halves may round them.
    pub kind: ChannelKind,
}

/// What the values of a channel are good for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChannelKind {
    /// Counts, distances, ids, hashes: always 32-bit floats.
    #[default]
    Exact,
    /// What is looked at: halves where the picture's colours are.
    Color,
}

impl<'a> ImageChannel<'a> {
    /// A channel that keeps every bit.
    pub fn exact(name: &'a str, values: &'a [f32]) -> ImageChannel<'a> {
        ImageChannel {
            name,
            values,
            kind: ChannelKind::Exact,
        }
    }

    /// A channel that is rounded as colours are.
    pub fn color(name: &'a str, values: &'a [f32]) -> ImageChannel<'a> {
        ImageChannel {
            name,
            values,
            kind: ChannelKind::Color,
        }
    }
}

/// Writes `image`, further channels and notes to `path` as an EXR, whole or, on an error, not at all.
pub fn write_exr_with(
    image: &LinearImage,
    extra: &[ImageChannel],
    encoding: ExrEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    exr::write(image, extra, encoding, notes, path)
}

/// Reads the linear RGB of an EXR file.
pub fn read_exr(path: &Path) -> Result<LinearImage, ImageError> {
    exr::read(path)
}

/// What wrote a file, for its metadata.
const SOFTWARE: &str = concat!("whit ", env!("CARGO_PKG_VERSION"));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_asks_for_its_format_by_its_ending() {
        assert_eq!(ImageFormat::of_path(Path::new("a/b.png")), Some(ImageFormat::Png));
        assert_eq!(ImageFormat::of_path(Path::new("B.EXR")), Some(ImageFormat::Exr));
        assert_eq!(ImageFormat::of_path(Path::new("b.jpg")), None);
        assert_eq!(ImageFormat::of_path(Path::new("png")), None);
    }

    #[test]
    fn pixels_that_are_not_finite_are_counted_once_each() {
        let mut image = LinearImage::black(300, 200);
        assert_eq!(image.non_finite_count(), 0);
        image.pixels[3] = [f32::NAN, f32::INFINITY, 0.0];
        image.pixels[59_999] = [0.0, 0.0, f32::NEG_INFINITY];
        assert_eq!(image.non_finite_count(), 2);
    }

    #[test]
    fn the_pixel_of_a_column_and_row_is_found_from_the_top_left() {
        let mut image = LinearImage::black(3, 2);
        image.pixels[4] = [1.0, 2.0, 3.0];
        assert_eq!(image.pixel(1, 1), [1.0, 2.0, 3.0]);
    }
}
