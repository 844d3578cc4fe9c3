//! Loading of complete images for comparison.

use std::path::Path;

use super::decode::{self, DecodedPixels, TransferCurve, read_size};
use super::{ImageError, LinearImage, linear_from_srgb};

/// Largest number of pixels of an image: 3 GiB of them.
const MAX_PIXELS: u64 = 1 << 28;

/// Image loaded from a file, in linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedImage {
    /// Linear RGB; for a PNG or JPEG it is the displayed radiance, 0 to 1, and alpha is ignored.
    pub image: LinearImage,
    /// True if the file stores radiance, of any range, rather than display-referred codes.
    pub is_radiance: bool,
}

/// Reads the EXR, HDR, PNG or JPEG at `path`. An EXR may contain NaN and infinities, so that they can be counted.
///
/// # Errors
///
/// If the file cannot be read, is no image, or has more than 2^28 pixels.
pub fn load_image(path: &Path) -> Result<LoadedImage, ImageError> {
    // Reject images that are too large before decoding
    let [width, height] = read_size(path)?;
    if u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(ImageError::Unusable {
            path: path.to_owned(),
            fault: format!("has {width} x {height} pixels, more than {MAX_PIXELS}"),
            remedy: "compare regions of it",
        });
    }
    // Read EXR with the reader that keeps NaN and infinities
    let (is_radiance, is_exr) = decode::holds_radiance(path)?;
    if is_exr {
        let image = super::read_exr(path)?;
        return Ok(LoadedImage { image, is_radiance });
    }
    // The limit counts a float pixel as four byte pixels.
    let read = decode::read(path, TransferCurve::Srgb, 4 * MAX_PIXELS)?;
    // Convert codes to linear radiance by a table
    let pixels = match read.pixels {
        DecodedPixels::Bytes(codes) => {
            let linear: Vec<f32> = (0..=255)
                .map(|code| linear_from_srgb(f64::from(code) / 255.0) as f32)
                .collect();
            let pixel = |[r, g, b, _]: [u8; 4]| [r, g, b].map(|code| linear[usize::from(code)]);
            codes.into_iter().map(pixel).collect()
        }
        DecodedPixels::Floats(floats) => floats.into_iter().map(|[r, g, b, _]| [r, g, b]).collect(),
    };
    let image = LinearImage {
        width: read.width,
        height: read.height,
        pixels,
    };
    Ok(LoadedImage { image, is_radiance })
}

#[cfg(test)]
mod tests {
    use super::super::{ImageFormat, ToneMap, write};
    use super::*;

    #[test]
    fn png_is_read_as_displayed_and_exr_with_all_channels() {
        let folder = tempfile::tempdir().unwrap();
        let mut image = LinearImage::black(3, 2);
        image.pixels[1] = [0.25, 0.5, 2.0];
        image.pixels[5] = [f32::NAN, 1.0, f32::INFINITY];
        let path = |name: &str| folder.path().join(name);
        write(&image, &path("a.exr"), ImageFormat::Exr, ToneMap::default()).unwrap();
        write(&image, &path("a.png"), ImageFormat::Png, ToneMap::default()).unwrap();

        let radiance = load_image(&path("a.exr")).unwrap();
        assert!(radiance.is_radiance);
        let bits = |image: &LinearImage| {
            image
                .pixels
                .iter()
                .map(|p| p.map(f32::to_bits))
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&radiance.image), bits(&image));

        let displayed = load_image(&path("a.png")).unwrap();
        assert!(!displayed.is_radiance);
        let [r, g, b] = displayed.image.pixels[1];
        assert!(
            (r - 0.25).abs() < 0.004 && (g - 0.5).abs() < 0.004 && b == 1.0,
            "{r} {g} {b}"
        );
        assert_eq!(displayed.image.pixels[5], [0.0, 1.0, 1.0]);
    }

    #[test]
    fn non_image_is_rejected_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        for text in ["", "not an image", "\u{76}/1\u{1}broken"] {
            std::fs::write(&path, text).unwrap();
            let error = load_image(&path).unwrap_err().to_string();
            assert!(error.contains("a.png"), "{error}");
        }
        let missing = folder.path().join("none.exr");
        assert!(load_image(&missing).unwrap_err().to_string().contains("none.exr"));
    }
}
