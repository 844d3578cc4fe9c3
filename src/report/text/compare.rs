//! Comparison of two images as text and JSON: `whit compare`.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::image::metrics::{Deviation, Metrics};
use crate::report::format::percent;

/// Differences of an image from its reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompareReport {
    /// Path of the reference image, which counts as correct.
    pub reference: PathBuf,
    /// Path of the image that is compared with the reference.
    pub picture: PathBuf,
    /// Width of both images in pixels.
    pub width: u32,
    /// Height of both images in pixels.
    pub height: u32,
    /// True if both files hold radiance rather than display codes.
    pub is_radiance: bool,
    /// Exposure in stops before the images are displayed.
    pub exposure_ev: f32,
    /// Angular resolution in pixels per degree of the visual field.
    pub pixels_per_degree: f64,
    /// Error metrics; the PSNR is null where it is infinite, as displayed values are equal.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// Mean structural similarity of displayed values; null for images of less than 11 pixels a side.
    pub ssim: Option<f64>,
    /// Mean HDR-FLIP error, 0 to 1; null unless both files hold radiance.
    pub flip_hdr: Option<f64>,
    /// Numbers of pixels with a NaN or an infinity, in the reference and in the compared image.
    pub non_finite: [usize; 2],
}

/// Text form with one line for each kind of metric.
impl fmt::Display for CompareReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // Print the files and their size
        let what = if self.is_radiance {
            "radiance"
        } else {
            "display values"
        };
        writeln!(f, "{:<14}{}", "reference", self.reference.display())?;
        writeln!(f, "{:<14}{}", "image", self.picture.display())?;
        writeln!(f, "{:<14}{}x{} pixels of {what}", "size", self.width, self.height)?;
        // Print errors of radiance and of displayed values
        let Metrics {
            radiance,
            rel_mse,
            displayed,
            psnr,
            changed_share,
            flip,
        } = self.metrics;
        writeln!(f, "{:<14}{}; relMSE {rel_mse:.4e}", "radiance", Words(radiance))?;
        writeln!(f, "{:<14}{}; PSNR {psnr:.2} dB", "as displayed", Words(displayed))?;
        writeln!(
            f,
            "{:<14}{} differ by more than 1/255 as displayed",
            "pixels",
            percent(changed_share)
        )?;
        // Print perceptual metrics where they are defined
        if let Some(ssim) = self.ssim {
            writeln!(f, "{:<14}{ssim:.6}", "SSIM")?;
        }
        write!(
            f,
            "{:<14}{flip:.6} at {} pixels per degree",
            "FLIP", self.pixels_per_degree
        )?;
        match self.flip_hdr {
            Some(hdr) => writeln!(f, "; HDR-FLIP {hdr:.6}")?,
            None => writeln!(f)?,
        }
        // Print the number of non-finite pixels
        let [reference, image] = self.non_finite;
        if reference + image > 0 {
            writeln!(
                f,
                "{:<14}{reference} pixels of the reference and {image} of the image hold a NaN or an infinity",
                "not finite"
            )?;
        }
        Ok(())
    }
}

/// Text form of a deviation.
struct Words(Deviation);

impl fmt::Display for Words {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Deviation { rmse, mae, max } = self.0;
        write!(f, "RMSE {rmse:.4e}, MAE {mae:.4e}, largest {max:.4e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(metrics: Metrics) -> CompareReport {
        CompareReport {
            reference: "a.exr".into(),
            picture: "b.exr".into(),
            width: 4,
            height: 3,
            is_radiance: true,
            exposure_ev: 0.0,
            pixels_per_degree: 67.0,
            metrics,
            ssim: None,
            flip_hdr: Some(0.125),
            non_finite: [0, 2],
        }
    }

    const ALIKE: Metrics = Metrics {
        radiance: Deviation {
            rmse: 0.0,
            mae: 0.0,
            max: 0.0,
        },
        rel_mse: 0.0,
        displayed: Deviation {
            rmse: 0.0,
            mae: 0.0,
            max: 0.0,
        },
        psnr: f64::INFINITY,
        changed_share: 0.0,
        flip: 0.0,
    };

    #[test]
    fn text_lists_only_the_metrics_that_exist() {
        let text = report(ALIKE).to_string();
        for words in [
            "4x3 pixels of radiance",
            "PSNR inf dB",
            "HDR-FLIP 0.125000",
            "and 2 of the image",
        ] {
            assert!(text.contains(words), "{words} in {text}");
        }
        assert!(!text.contains("SSIM"), "{text}");
    }

    #[test]
    fn infinite_and_absent_metrics_are_null_in_json() {
        let json = serde_json::to_value(report(ALIKE)).unwrap();
        assert!(json["psnr"].is_null() && json["ssim"].is_null());
        assert_eq!(json["radiance"]["rmse"], 0.0);
        assert_eq!(json["flip_hdr"], 0.125);
    }
}
