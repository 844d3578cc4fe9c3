//! Images: linear radiance in memory, PNG and EXR files, and decoding of images for textures.
//!
//! Pixels are linear RGB radiance until they are written; exposure, a tone mapping operator and the sRGB curve are
//! applied only when a PNG is encoded ([`ToneMap`], [`ToneOperator`]); [`metrics`] measure the difference of two
//! images. Files are written atomically: to a temporary file in the target's directory, synced to disk and renamed.
//! Images larger than memory are streamed row by row ([`rows`]).

mod atomic_file;
pub mod cryptomatte;
mod decode;
mod denoise;
mod exr;
mod load;
pub mod metrics;
mod png;
pub mod rows;
mod tone_operator;
mod tonemap;

use std::fmt;
use std::path::{Path, PathBuf};

use crate::parallel;

pub use self::exr::ExrEncoding;
pub use self::png::{PngBits, PngChannels, PngEncoding};
pub use atomic_file::{check_writable, write_atomically};
pub use decode::{DecodedImage, DecodedPixels, TransferCurve, read, read_size};
pub use denoise::{DenoiseError, DenoiseGuides, Denoiser};
pub use load::{LoadedImage, load_image};
pub use tone_operator::ToneOperator;
pub use tonemap::{ToneMap, linear_from_srgb};

/// Image of linear RGB radiance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LinearImage {
    /// Number of pixels per row.
    pub width: u32,
    /// Number of rows of pixels.
    pub height: u32,
    /// Array of `width * height` pixels, row by row, the top row first.
    pub pixels: Vec<[f32; 3]>,
}

impl LinearImage {
    /// Creates an image whose pixels are all black.
    pub fn black(width: u32, height: u32) -> LinearImage {
        LinearImage {
            width,
            height,
            pixels: vec![[0.0; 3]; width as usize * height as usize],
        }
    }

    /// Returns the pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// If there is no such pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 3] {
        assert!(x < self.width, "column {x} of {}", self.width);
        self.pixels[y as usize * self.width as usize + x as usize]
    }

    /// Returns the number of pixels that contain a NaN or an infinity: 0 in a valid image.
    pub fn non_finite_count(&self) -> usize {
        // Count chunks in parallel
        const CHUNK: usize = 1 << 14;
        let counts = parallel::map_chunks(&self.pixels, CHUNK, &|_, chunk| {
            chunk.iter().filter(|p| !p.iter().all(|c| c.is_finite())).count()
        });
        counts.iter().sum()
    }
}

/// Text metadata in an image file: an EXR attribute or a PNG text chunk.
#[derive(Clone, Copy, Debug)]
pub struct Attribute<'a> {
    /// Name of the attribute: ASCII, at most 79 letters.
    pub name: &'a str,
    /// Value of the attribute; in an EXR each non-ASCII character becomes a question mark.
    pub text: &'a str,
}

/// File formats of images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum ImageFormat {
    /// PNG: sRGB, after exposure.
    #[default]
    Png,
    /// EXR: floating-point linear RGB, as rendered.
    Exr,
}

impl ImageFormat {
    /// Returns the format that belongs to a file name's extension, in upper or lower case.
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

/// Reasons that an image file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// Output file whose folder does not exist.
    #[error("there is no folder {} for {}: create it first", .folder.display(), .path.display())]
    NoFolder {
        /// Path of the output file.
        path: PathBuf,
        /// Path of the missing folder.
        folder: PathBuf,
    },
    /// Output path that is an existing folder.
    #[error("{} is a folder: give a file name", .0.display())]
    IsFolder(PathBuf),
    /// Folder in which no file can be created.
    #[error("cannot write into the folder {}: {source}", .folder.display())]
    NotWritable {
        /// Path of the folder where the temporary file was tried.
        folder: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Write that failed; no partial file is left.
    #[error("could not write {}: {message}", .path.display())]
    Write {
        /// Path of the output file.
        path: PathBuf,
        /// Error message of the operating system or the encoder.
        message: String,
    },
    /// File whose content cannot be used as an image.
    #[error("{}: {fault}: {remedy}", .path.display())]
    Unusable {
        /// Path of the rejected file.
        path: PathBuf,
        /// Description of the fault, as the predicate of a sentence.
        fault: String,
        /// Remedy, as a request to the user.
        remedy: &'static str,
    },
    /// EXR file that could not be read.
    #[error("could not read {} as an EXR image: {message}", .path.display())]
    Read {
        /// Path of the rejected file.
        path: PathBuf,
        /// Error message of the operating system or the decoder.
        message: String,
    },
}

/// Writes `image` to `path` in `format`; `tonemap` applies to PNG only, as an EXR stores radiance unchanged.
///
/// The write is atomic: on an error no file appears, and an existing file stays until the new one is complete.
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

/// Writes `image` and text attributes to `path` as a PNG, atomically.
pub fn write_png_with(
    image: &LinearImage,
    encoding: PngEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    write_atomically(path, |file| png::encode(image, None, &encoding, notes, file))
}

/// Writes premultiplied `image` with the coverage `alpha` of its pixels and text attributes to `path` as a PNG with
/// straight alpha, atomically.
///
/// # Panics
/// If `alpha` has not one value per pixel.
pub fn write_png_with_alpha(
    image: &LinearImage,
    alpha: &[f32],
    encoding: PngEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    assert_eq!(alpha.len(), image.pixels.len(), "coverage of other pixels");
    write_atomically(path, |file| {
        png::encode(image, Some(alpha), &encoding, notes, file)
    })
}

/// Encodes `image` as the bytes of a PNG, for embedding in other files.
///
/// # Errors
///
/// If the image has more pixels than a PNG can hold.
pub fn png_bytes(image: &LinearImage, tone: ToneMap) -> std::io::Result<Vec<u8>> {
    let encoding = PngEncoding {
        tone,
        ..PngEncoding::default()
    };
    let mut bytes = Vec::new();
    png::encode(image, None, &encoding, &[], &mut bytes)?;
    Ok(bytes)
}

/// Additional channel of an EXR file, with one value per pixel.
#[derive(Clone, Copy, Debug)]
pub struct ImageChannel<'a> {
    /// Name of the channel; dots in it group channels into layers.
    pub name: &'a str,
    /// One value per pixel, row by row, the top row first.
    pub values: &'a [f32],
    /// Choice of whether the channel may be rounded to half floats.
    pub kind: ChannelKind,
}

/// Precision that the values of a channel need.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChannelKind {
    /// Counts, distances, ids, hashes: always stored as 32-bit floats.
    #[default]
    Exact,
    /// Colours for display: stored as half floats if the image's colours are.
    Color,
}

impl<'a> ImageChannel<'a> {
    /// Creates a channel that is stored without loss.
    pub fn exact(name: &'a str, values: &'a [f32]) -> ImageChannel<'a> {
        ImageChannel {
            name,
            values,
            kind: ChannelKind::Exact,
        }
    }

    /// Creates a channel that is rounded like the image's colours.
    pub fn color(name: &'a str, values: &'a [f32]) -> ImageChannel<'a> {
        ImageChannel {
            name,
            values,
            kind: ChannelKind::Color,
        }
    }
}

/// Writes `image`, additional channels and attributes to `path` as an EXR, atomically.
pub fn write_exr_with(
    image: &LinearImage,
    extra: &[ImageChannel],
    encoding: ExrEncoding,
    notes: &[Attribute],
    path: &Path,
) -> Result<(), ImageError> {
    exr::write(image, extra, encoding, notes, path)
}

/// Reads the linear RGB channels of an EXR file.
pub fn read_exr(path: &Path) -> Result<LinearImage, ImageError> {
    exr::read(path)
}

/// Name and version of this program, for the metadata of written files.
const SOFTWARE: &str = concat!("whit ", env!("CARGO_PKG_VERSION"));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_extension_selects_the_format() {
        assert_eq!(ImageFormat::of_path(Path::new("a/b.png")), Some(ImageFormat::Png));
        assert_eq!(ImageFormat::of_path(Path::new("B.EXR")), Some(ImageFormat::Exr));
        assert_eq!(ImageFormat::of_path(Path::new("b.jpg")), None);
        assert_eq!(ImageFormat::of_path(Path::new("png")), None);
    }

    #[test]
    fn non_finite_pixels_are_counted_once_each() {
        let mut image = LinearImage::black(300, 200);
        assert_eq!(image.non_finite_count(), 0);
        image.pixels[3] = [f32::NAN, f32::INFINITY, 0.0];
        image.pixels[59_999] = [0.0, 0.0, f32::NEG_INFINITY];
        assert_eq!(image.non_finite_count(), 2);
    }

    #[test]
    fn pixels_are_indexed_from_the_top_left() {
        let mut image = LinearImage::black(3, 2);
        image.pixels[4] = [1.0, 2.0, 3.0];
        assert_eq!(image.pixel(1, 1), [1.0, 2.0, 3.0]);
    }
}
