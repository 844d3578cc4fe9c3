//! Encoding of images in their files: the flags, checked against the formats that are written.

use whit::batch::request::ImageEncoding;
use whit::image::{ExrEncoding, ImageFormat};

use super::args::OutputArgs;
use super::failure::Failure;

/// Returns the encoding that the flags request; rejects flags for a format that none of the files has.
pub(super) fn image_encoding(
    args: &OutputArgs,
    formats: impl Iterator<Item = ImageFormat> + Clone,
) -> Result<ImageEncoding, Failure> {
    let is_written = |format| formats.clone().any(|written| written == format);
    // EXR flags need an EXR among the files
    if !is_written(ImageFormat::Exr) && args.exr_type.is_some() {
        return Err(Failure::Input(
            "`--exr-type` applies to EXR images only: write an .exr, or give `--png-bits` for a PNG".into(),
        ));
    }
    if !is_written(ImageFormat::Exr) && args.compression.is_some() {
        return Err(Failure::Input(
            "`--compression` applies to EXR images only, as PNG has only one compression method: write an .exr, or \
             leave out the flag"
                .into(),
        ));
    }
    // PNG flags need a PNG among the files
    if !is_written(ImageFormat::Png) && args.png_bits.is_some() {
        return Err(Failure::Input(
            "`--png-bits` applies to PNG images only: write a .png, or give `--exr-type` for an EXR".into(),
        ));
    }
    // Use the defaults for absent flags
    Ok(ImageEncoding {
        exr: ExrEncoding {
            sample: args.exr_type.unwrap_or_default(),
            compression: args.compression.unwrap_or_default(),
        },
        png_bits: args.png_bits.unwrap_or_default(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use whit::image::PngBits;
    use whit::image::rows::{Compression, SampleType};

    #[test]
    fn encoding_flag_requires_an_output_file_of_its_format() {
        let half = OutputArgs {
            exr_type: Some(SampleType::Half),
            ..OutputArgs::default()
        };
        let zip = OutputArgs {
            compression: Some(Compression::Zip),
            ..OutputArgs::default()
        };
        let wide = OutputArgs {
            png_bits: Some(PngBits::Sixteen),
            ..OutputArgs::default()
        };
        let (png, exr) = (ImageFormat::Png, ImageFormat::Exr);
        for (args, fits, other) in [(half, exr, png), (zip, exr, png), (wide, png, exr)] {
            assert!(image_encoding(&args, [fits].into_iter()).is_ok());
            assert!(image_encoding(&args, [other, fits].into_iter()).is_ok());
            let failure = image_encoding(&args, [other, other].into_iter()).unwrap_err();
            assert_eq!(failure.exit_code(), 2);
        }
        let encoding = image_encoding(&half, [exr].into_iter()).unwrap();
        assert_eq!(encoding.exr.sample, SampleType::Half);
        assert_eq!(
            image_encoding(&wide, [png].into_iter()).unwrap().png_bits,
            PngBits::Sixteen
        );
    }
}
