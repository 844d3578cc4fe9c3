//! Image decoding for textures: PNG, JPEG, Radiance HDR and OpenEXR, distinguished by their first bytes.
//!
//! Eight-bit channels stay codes. Sixteen-bit channels become linear floats by the transfer curve that the caller
//! gives, as files do not state what their codes mean. HDR and EXR are linear floats already; EXR stores premultiplied
//! alpha, which is divided out, so that all images have straight alpha.
//!
//! Sizes are checked against a budget before anything is decoded.

use std::fs::File;
use std::io::{BufRead, BufReader, Seek};
use std::path::Path;

use exr::io::Tracking;
use exr::prelude::{self as openexr, ReadChannels, ReadLayers, ReadSpecificChannel, Vec2};
use image::codecs::hdr::HdrDecoder;
use image::{ColorType, DynamicImage, ImageDecoder, ImageReader, Limits};

use super::ImageError;
use super::tonemap::linear_from_srgb;

/// Decoded image of a file, top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedImage {
    /// Number of pixels per row.
    pub width: u32,
    /// Number of rows of pixels.
    pub height: u32,
    /// Array of `width * height` pixels, row by row.
    pub pixels: DecodedPixels,
}

/// Pixels in the precision of the file, with straight (not premultiplied) alpha.
#[derive(Clone, Debug, PartialEq)]
pub enum DecodedPixels {
    /// RGBA codes of eight bits.
    Bytes(Vec<[u8; 4]>),
    /// Linear RGBA, all finite. Colours may be above 1, and in EXR below 0.
    Floats(Vec<[f32; 4]>),
}

/// Transfer curve of the colour codes of an image with 16 bits a channel; alpha is linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransferCurve {
    /// Colours encoded by the sRGB curve.
    Srgb,
    /// Linear fractions of 65535.
    Linear,
}

/// Largest number of bytes that a decoder may allocate: an image of 2^29 pixels of 8 bytes, and its rows.
const MAX_DECODER_BYTES: u64 = 1 << 33;
/// Bytes of a decoded pixel of 8 bits a channel, the unit of the budget in pixels.
const CODE_BYTES: u64 = 4;
/// Bytes of a decoded pixel of floats.
const FLOAT_BYTES: u64 = 16;

/// First bytes of an EXR file.
const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
/// First bytes of a Radiance file: `#?RADIANCE` or `#?RGBE`.
const HDR_MAGIC: [u8; 2] = *b"#?";

/// Returns the width and height of the image at `path`, from its header; the rest of the file is not checked.
pub fn read_size(path: &Path) -> Result<[u32; 2], ImageError> {
    let mut file = open(path)?;
    let start = file.fill_buf().map_err(|error| unreadable(path, &error))?;
    // Choose the decoder by the first bytes
    let size = if start.starts_with(&EXR_MAGIC) {
        let meta = read_exr_meta(&mut file).map_err(|e| undecodable(path, &e))?;
        let layer = meta
            .headers
            .first()
            .map_or(Vec2(0, 0), |header| header.layer_size);
        (layer.x() as u32, layer.y() as u32)
    } else if start.starts_with(&HDR_MAGIC) {
        let decoder = HdrDecoder::new_nonstrict(file).map_err(|e| undecodable(path, &e))?;
        decoder.dimensions()
    } else {
        let reader = ImageReader::new(file)
            .with_guessed_format()
            .map_err(|error| unreadable(path, &error))?;
        let decoder = reader.into_decoder().map_err(|e| undecodable(path, &e))?;
        decoder.dimensions()
    };
    Ok([size.0, size.1])
}

/// Returns whether the file at `path` stores radiance, by its first bytes, and whether it is an EXR.
pub(super) fn holds_radiance(path: &Path) -> Result<(bool, bool), ImageError> {
    let mut file = open(path)?;
    let start = file.fill_buf().map_err(|error| unreadable(path, &error))?;
    let is_exr = start.starts_with(&EXR_MAGIC);
    Ok((is_exr || start.starts_with(&HDR_MAGIC), is_exr))
}

/// Opens a file with a buffered reader.
fn open(path: &Path) -> Result<BufReader<File>, ImageError> {
    let file = File::open(path).map_err(|error| unreadable(path, &error))?;
    Ok(BufReader::new(file))
}

/// Returns the error for a file that cannot be read.
fn unreadable(path: &Path, error: &std::io::Error) -> ImageError {
    let remedy = "check the path and whether you may read the file";
    refusal(path, format!("cannot be read ({error})"), remedy)
}

/// Decodes the image at `path`, of at most `max_pixels` pixels of 8 bits a channel; pixels that become floats count
/// four times.
pub fn read(path: &Path, curve: TransferCurve, max_pixels: u64) -> Result<DecodedImage, ImageError> {
    let mut file = open(path)?;
    let start = file.fill_buf().map_err(|error| unreadable(path, &error))?;
    // Choose the decoder by the first bytes
    let image = if start.starts_with(&EXR_MAGIC) {
        read_exr(path, &mut file, max_pixels)?
    } else if start.starts_with(&HDR_MAGIC) {
        let decoder = HdrDecoder::new_nonstrict(file).map_err(|e| undecodable(path, &e))?;
        decode(path, decoder, curve, max_pixels)?
    } else {
        let mut reader = ImageReader::new(file)
            .with_guessed_format()
            .map_err(|error| unreadable(path, &error))?;
        // Bound the memory of the decoder
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(MAX_DECODER_BYTES);
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(|e| undecodable(path, &e))?;
        decode(path, decoder, curve, max_pixels)?
    };
    // Reject NaN and infinity
    if let DecodedPixels::Floats(pixels) = &image.pixels
        && !pixels.as_flattened().iter().all(|x| x.is_finite())
    {
        let fault = "holds values that are not finite".to_owned();
        return Err(refusal(path, fault, "save it without NaN and infinity"));
    }
    Ok(image)
}

/// Decodes an image of the `image` crate, after checking its size.
fn decode(
    path: &Path,
    decoder: impl ImageDecoder,
    curve: TransferCurve,
    max_pixels: u64,
) -> Result<DecodedImage, ImageError> {
    let (width, height) = decoder.dimensions();
    let color = decoder.color_type();
    let is_wide = color.bytes_per_pixel() > color.channel_count();
    let pixel_bytes = if is_wide { FLOAT_BYTES } else { CODE_BYTES };
    check_size(path, [width.into(), height.into()], pixel_bytes, max_pixels)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(|e| undecodable(path, &e))?;
    // Convert to codes or linear floats
    let pixels = match color {
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => {
            DecodedPixels::Floats(linear_pixels(&decoded.into_rgba16().into_raw(), curve))
        }
        ColorType::Rgb32F | ColorType::Rgba32F => {
            DecodedPixels::Floats(quads(decoded.into_rgba32f().into_raw()))
        }
        _ => DecodedPixels::Bytes(quads(decoded.into_rgba8().into_raw())),
    };
    Ok(DecodedImage {
        width,
        height,
        pixels,
    })
}

/// Converts 16-bit RGBA codes to linear pixels.
fn linear_pixels(codes: &[u16], curve: TransferCurve) -> Vec<[f32; 4]> {
    // Tabulate the curve for all codes
    let unit = |code: u16| f64::from(code) / f64::from(u16::MAX);
    let color: Vec<f32> = (0..=u16::MAX)
        .map(|code| match curve {
            TransferCurve::Srgb => linear_from_srgb(unit(code)) as f32,
            TransferCurve::Linear => unit(code) as f32,
        })
        .collect();
    let pixels = codes.chunks_exact(4).map(|pixel| {
        let [r, g, b] = [0, 1, 2].map(|channel| color[pixel[channel] as usize]);
        [r, g, b, unit(pixel[3]) as f32]
    });
    pixels.collect()
}

/// Groups values by four, without a copy if the allocation's layout allows it.
fn quads<T: bytemuck::Pod>(values: Vec<T>) -> Vec<[T; 4]> {
    bytemuck::allocation::try_cast_vec(values).unwrap_or_else(|(_, values)| {
        values
            .chunks_exact(4)
            .map(|quad| [quad[0], quad[1], quad[2], quad[3]])
            .collect()
    })
}

/// Reads the first layer with R, G and B, or else one with Y, and its A channel if present.
fn read_exr(path: &Path, file: &mut BufReader<File>, max_pixels: u64) -> Result<DecodedImage, ImageError> {
    let faulty = |error: exr::error::Error| undecodable(path, &error);
    let meta = read_exr_meta(file).map_err(faulty)?;
    for header in &meta.headers {
        let size = [header.layer_size.x(), header.layer_size.y()].map(|side| side as u64);
        // Blocks are decoded with all their channels, including those that are not used.
        let pixel_bytes = FLOAT_BYTES.max(header.channels.bytes_per_pixel as u64);
        check_size(path, size, pixel_bytes, max_pixels)?;
    }
    // Read RGBA if any layer has colours
    let is_color = |header: &exr::meta::header::Header| {
        let has = |name: &str| header.channels.list.iter().any(|channel| channel.name.eq(name));
        has("R") && has("G") && has("B")
    };
    file.rewind().map_err(|error| undecodable(path, &error))?;
    let layers = openexr::read().no_deep_data().largest_resolution_level();
    if meta.headers.iter().any(is_color) {
        let set = |image: &mut ReadFloats, at: Vec2<usize>, (r, g, b, a): (f32, f32, f32, f32)| {
            image.set(at, [r, g, b], a);
        };
        let reader = layers.rgba_channels(|size, _| ReadFloats::new(size), set);
        let file = reader.first_valid_layer().all_attributes().from_buffered(file);
        return Ok(file.map_err(faulty)?.layer_data.channel_data.pixels.finish());
    }
    // Otherwise read luminance as grey
    let set = |image: &mut ReadFloats, at: Vec2<usize>, (y, a): (f32, f32)| image.set(at, [y; 3], a);
    let reader = layers.specific_channels().required("Y").optional("A", 1.0f32);
    let reader = reader.collect_pixels(|size, _| ReadFloats::new(size), set);
    let file = reader.first_valid_layer().all_attributes().from_buffered(file);
    Ok(file.map_err(faulty)?.layer_data.channel_data.pixels.finish())
}

/// Reads the headers of an EXR file.
///
/// The `exr` crate wraps the reader of pixels in [`Tracking`]; all EXR reading here does the same and borrows the file,
/// so that the crate is compiled for one reader type.
fn read_exr_meta(file: &mut BufReader<File>) -> exr::error::Result<exr::meta::MetaData> {
    exr::meta::MetaData::read_from_buffered(Tracking::new(file), false)
}

/// Pixels of an EXR image while it is being read.
struct ReadFloats {
    size: Vec2<usize>,
    pixels: Vec<[f32; 4]>,
}

impl ReadFloats {
    fn new(size: Vec2<usize>) -> ReadFloats {
        ReadFloats {
            size,
            pixels: vec![[0.0; 4]; size.area()],
        }
    }

    /// Stores a pixel, dividing premultiplied colour by its alpha.
    fn set(&mut self, at: Vec2<usize>, color: [f32; 3], alpha: f32) {
        let alpha = alpha.clamp(0.0, 1.0);
        // A fully transparent pixel with a colour is emissive; its colour is kept, as it cannot be divided.
        let share = if alpha > 0.0 { alpha } else { 1.0 };
        let [r, g, b] = color.map(|c| c / share);
        self.pixels[at.y() * self.size.x() + at.x()] = [r, g, b, alpha];
    }

    /// Returns the finished image.
    fn finish(self) -> DecodedImage {
        DecodedImage {
            width: self.size.x() as u32,
            height: self.size.y() as u32,
            pixels: DecodedPixels::Floats(self.pixels),
        }
    }
}

/// Rejects images without pixels or beyond the budget.
fn check_size(
    path: &Path,
    [width, height]: [u64; 2],
    pixel_bytes: u64,
    max_pixels: u64,
) -> Result<(), ImageError> {
    let count = width.saturating_mul(height);
    if count == 0 {
        return Err(refusal(path, "has no pixels".to_owned(), "save it again"));
    }
    if width.max(height) > u64::from(u32::MAX)
        || count.saturating_mul(pixel_bytes) > max_pixels.saturating_mul(CODE_BYTES)
    {
        let fault = format!(
            "has {width} x {height} pixels of {pixel_bytes} bytes, more than the {max_pixels} of {CODE_BYTES} bytes that \
             are left for images"
        );
        return Err(refusal(path, fault, "make the image smaller"));
    }
    Ok(())
}

/// Returns the error for content that the decoder rejects.
fn undecodable(path: &Path, error: &dyn std::fmt::Display) -> ImageError {
    let words: Vec<String> = error.to_string().split_whitespace().map(str::to_owned).collect();
    let fault = format!("cannot be decoded ({})", words.join(" "));
    refusal(path, fault, "save it as PNG, JPEG, HDR or EXR")
}

/// Returns an error with fault and remedy.
fn refusal(path: &Path, fault: String, remedy: &'static str) -> ImageError {
    ImageError::Unusable {
        path: path.to_owned(),
        fault,
        remedy,
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use image::{ExtendedColorType, ImageFormat};

    use super::*;

    const BUDGET: u64 = 1 << 20;

    struct ImageFolder(tempfile::TempDir);

    impl ImageFolder {
        fn new() -> ImageFolder {
            ImageFolder(tempfile::tempdir().unwrap())
        }

        fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
            let path = self.0.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path
        }

        /// Writes a file of `codes` with the image crate.
        fn image(&self, name: &str, codes: &[u8], color: ExtendedColorType, format: ImageFormat) -> PathBuf {
            let path = self.0.path().join(name);
            image::save_buffer_with_format(&path, codes, 2, 2, color, format).unwrap();
            path
        }

        /// Writes an EXR of 2 x 1 RGBA pixels.
        fn exr(&self, pixels: [[f32; 4]; 2]) -> PathBuf {
            use exr::prelude::WritableImage;
            let path = self.0.path().join("a.exr");
            let channels = openexr::SpecificChannels::rgba(|at: Vec2<usize>| {
                let [r, g, b, a] = pixels[at.x()];
                (r, g, b, a)
            });
            let image = openexr::Image::from_channels((2, 1), channels);
            image.write().to_file(&path).unwrap();
            path
        }
    }

    fn message(path: &Path, max_pixels: u64) -> String {
        read(path, TransferCurve::Linear, max_pixels)
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn eight_bit_files_keep_their_codes_under_any_name() {
        let folder = ImageFolder::new();
        let codes = [0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 110];
        let path = folder.image("a.jpg", &codes, ExtendedColorType::Rgb8, ImageFormat::Png);
        let image = read(&path, TransferCurve::Srgb, BUDGET).unwrap();
        assert_eq!((image.width, image.height), (2, 2));
        let expected = codes.chunks(3).map(|c| [c[0], c[1], c[2], 255]).collect();
        assert_eq!(image.pixels, DecodedPixels::Bytes(expected));
        let path = folder.image("b", &[200; 12], ExtendedColorType::Rgb8, ImageFormat::Jpeg);
        let DecodedPixels::Bytes(pixels) = read(&path, TransferCurve::Srgb, BUDGET).unwrap().pixels else {
            panic!("a JPEG has eight bits");
        };
        assert!(pixels.iter().all(|p| p[0].abs_diff(200) <= 2 && p[3] == 255));
    }

    #[test]
    fn sixteen_bits_keep_their_precision() {
        let folder = ImageFolder::new();
        let codes: [u16; 4] = [0, 1, 32768, 65535];
        let path = folder.image(
            "a.png",
            bytemuck::cast_slice(&codes),
            ExtendedColorType::L16,
            ImageFormat::Png,
        );
        let red = |curve| match read(&path, curve, BUDGET).unwrap().pixels {
            DecodedPixels::Floats(pixels) => pixels.iter().map(|p| p[0]).collect::<Vec<_>>(),
            DecodedPixels::Bytes(_) => panic!("sixteen bits do not fit in eight"),
        };
        assert_eq!(
            red(TransferCurve::Linear),
            codes.map(|code| f32::from(code) / 65535.0)
        );
        let srgb = red(TransferCurve::Srgb);
        assert_eq!([srgb[0], srgb[3]], [0.0, 1.0]);
        assert_eq!(srgb[1], (1.0 / 65535.0 / 12.92) as f32);
        // ((0.500008 + 0.055) / 1.055)^2.4
        assert!((srgb[2] - 0.214_048).abs() < 1e-6);
    }

    #[test]
    fn radiance_hdr_file_keeps_its_range() {
        let folder = ImageFolder::new();
        // Flat pixels: mantissas and an exponent; 128 / 256 * 2^(e - 128).
        let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
        bytes.extend([128, 64, 0, 138, 128, 128, 128, 129]);
        let pixels = read(&folder.file("a.hdr", &bytes), TransferCurve::Srgb, BUDGET)
            .unwrap()
            .pixels;
        let expected = vec![[512.0, 256.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]];
        assert_eq!(pixels, DecodedPixels::Floats(expected));
    }

    #[test]
    fn exr_is_read_from_colours_or_luminance_and_unpremultiplied() {
        use exr::prelude::WritableImage;
        let folder = ImageFolder::new();
        let path = folder.exr([[1000.0, -0.5, 0.25, 0.5], [3.0, 0.0, 0.0, 0.0]]);
        let image = read(&path, TransferCurve::Srgb, BUDGET).unwrap();
        let expected = vec![[2000.0, -1.0, 0.5, 0.5], [3.0, 0.0, 0.0, 0.0]];
        assert_eq!(image.pixels, DecodedPixels::Floats(expected));
        let path = folder.0.path().join("y.exr");
        let channels = openexr::SpecificChannels::build()
            .with_channel("Y")
            .with_pixel_fn(|at: Vec2<usize>| (at.x() as f32 + 0.5,));
        let image = openexr::Image::from_channels((2, 1), channels);
        image.write().to_file(&path).unwrap();
        let image = read(&path, TransferCurve::Srgb, BUDGET).unwrap();
        let expected = vec![[0.5, 0.5, 0.5, 1.0], [1.5, 1.5, 1.5, 1.0]];
        assert_eq!(image.pixels, DecodedPixels::Floats(expected));
    }

    #[test]
    fn oversized_images_are_rejected_before_decoding() {
        let folder = ImageFolder::new();
        let png = folder.image("a.png", &[7; 4], ExtendedColorType::L8, ImageFormat::Png);
        assert!(
            message(&png, 3).contains("has 2 x 2 pixels"),
            "{}",
            message(&png, 3)
        );
        assert!(message(&folder.exr([[1.0; 4]; 2]), 1).contains("has 2 x 1 pixels"));
        let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 2000000\n";
        let said = message(&folder.file("a.hdr", hdr), BUDGET);
        assert!(
            said.contains("2000000 x 30000") && said.ends_with("make the image smaller"),
            "{said}"
        );
        // A header alone, of 2^31 - 1 pixels a side.
        let mut bytes = std::fs::read(&png).unwrap();
        bytes[16..24].copy_from_slice(&[0x7f, 0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0xff]);
        assert!(read(&folder.file("b.png", &bytes), TransferCurve::Linear, BUDGET).is_err());
    }

    #[test]
    fn non_finite_values_are_rejected() {
        let folder = ImageFolder::new();
        for bad in [f32::NAN, f32::INFINITY] {
            let said = message(&folder.exr([[1.0; 4], [bad, 0.0, 0.0, 1.0]]), BUDGET);
            assert!(said.contains("a.exr: holds values that are not finite"), "{said}");
        }
    }

    #[test]
    fn truncated_or_corrupt_image_gives_an_error() {
        let folder = ImageFolder::new();
        let noise: Vec<u8> = (0..12).map(|i| (i * 37) as u8).collect();
        // Write a valid file of each format
        let files = [
            folder.image("a.png", &noise, ExtendedColorType::Rgb8, ImageFormat::Png),
            folder.image("a.jpg", &noise, ExtendedColorType::Rgb8, ImageFormat::Jpeg),
            folder.image(
                "a.hdr",
                bytemuck::cast_slice(&[0.3f32; 12]),
                ExtendedColorType::Rgb32F,
                ImageFormat::Hdr,
            ),
            folder.exr([[0.5; 4]; 2]),
        ];
        for path in files {
            let whole = std::fs::read(&path).unwrap();
            assert!(
                read(&path, TransferCurve::Linear, BUDGET).is_ok(),
                "{}",
                path.display()
            );
            for length in 0..whole.len() {
                // Some decoders accept truncated files; none may panic.
                let _ = read(
                    &folder.file("cut", &whole[..length]),
                    TransferCurve::Linear,
                    BUDGET,
                );
            }
            // Half a file is rejected by every decoder
            let half = folder.file("half", &whole[..whole.len() / 2]);
            assert!(
                read(&half, TransferCurve::Linear, BUDGET).is_err(),
                "{}",
                path.display()
            );
            // Flip bits of each byte
            for at in 0..whole.len() {
                for mask in [0x01, 0x80, 0xff] {
                    let mut bytes = whole.clone();
                    bytes[at] ^= mask;
                    let _ = read(&folder.file("flipped", &bytes), TransferCurve::Linear, BUDGET);
                }
            }
        }
    }

    #[test]
    fn invalid_or_missing_image_is_rejected_in_one_sentence() {
        let folder = ImageFolder::new();
        let said = message(&folder.file("a.png", b"no image"), BUDGET);
        assert!(said.contains("a.png: cannot be decoded"), "{said}");
        assert!(said.ends_with("save it as PNG, JPEG, HDR or EXR"), "{said}");
        let said = message(&folder.0.path().join("none.png"), BUDGET);
        assert!(
            said.ends_with("check the path and whether you may read the file"),
            "{said}"
        );
        assert!(read(folder.0.path(), TransferCurve::Linear, BUDGET).is_err());
    }
}
