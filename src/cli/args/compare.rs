//! Flags of `whit compare`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

use whit::image::metrics::PIXELS_PER_DEGREE;

/// Accepted range of pixels per degree: with fewer, no detail of an image is visible; with more, the eye resolves none.
const PIXELS_PER_DEGREE_RANGE: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

const COMPARE_HELP: &str = "\
Prints the differences of linear radiance and of values as displayed (after exposure, clipping and the sRGB curve, from
0 to 1), the share of pixels that change visibly, and two perceptual metrics: SSIM (Wang et al. 2004; 1 for equal
images) and FLIP (Andersson et al. 2020; 0 for equal images). If both files are EXR or HDR, HDR-FLIP compares them at
all exposures at which the reference is likely to be viewed. Alpha is ignored.

Examples:
  whit compare reference.exr image.exr
  whit compare before.png after.png --html difference.html
  whit compare reference.exr image.exr --exposure 2 --json metrics.json --difference signed.png --heat flip.png";

/// Flags of `whit compare`.
#[derive(Debug, ArgGroup)]
#[command(after_help = COMPARE_HELP)]
pub(in crate::cli) struct CompareArgs {
    /// Reference image, which is taken as correct: an EXR, HDR, PNG or JPEG
    #[arg(value_name = "REFERENCE")]
    pub(in crate::cli) reference: PathBuf,

    /// Image to compare with the reference, of the same size
    #[arg(value_name = "IMAGE")]
    pub(in crate::cli) image: PathBuf,

    /// Stops of exposure before values are displayed: radiance is multiplied by 2^EV
    #[arg(long, value_name = "EV", default_value_t = 0.0, value_parser = super::exposure, allow_hyphen_values = true)]
    pub(in crate::cli) exposure: f32,

    /// Pixels per degree of the visual field, for FLIP: 67 is a 4K screen 0.7 m wide, seen from 0.7 m
    #[arg(long, value_name = "N", default_value_t = PIXELS_PER_DEGREE, value_parser = pixels_per_degree)]
    pub(in crate::cli) pixels_per_degree: f64,

    /// Write the metrics as JSON
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) json: Option<PathBuf>,

    /// Write a page with both images under a slider, the metrics and both difference images
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) html: Option<PathBuf>,

    /// Write the signed difference of displayed values as a PNG: equal is grey, a tenth of the range is black or white
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) difference: Option<PathBuf>,

    /// Write the FLIP error of each pixel as a PNG, from dark violet for none to light yellow
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) heat: Option<PathBuf>,
}

fn pixels_per_degree(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|count| PIXELS_PER_DEGREE_RANGE.contains(count))
        .ok_or_else(|| "give 1 to 1000 pixels".to_owned())
}
