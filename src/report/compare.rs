//! Two pictures held against each other, as `whit compare` tells of it.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use super::words::percent;
use crate::image::metrics::{Deviation, Metrics};

/// How far a picture is from its reference.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompareReport {
    /// What is held to be right.
    pub reference: PathBuf,
    /// What is held against it.
    pub picture: PathBuf,
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Whether both files hold radiance, not codes for a screen.
    pub is_radiance: bool,
    /// Stops of exposure before either is displayed.
    pub exposure_ev: f32,
    /// Pixels in a degree of the visual field.
    pub pixels_per_degree: f64,
    /// In numbers; the ratio is null where it is infinite, as the two are displayed alike.
    #[serde(flatten)]
    pub metrics: Metrics,
    /// Mean structural similarity as displayed; null for pictures of less than 11 pixels a side.
    pub ssim: Option<f64>,
    /// Mean HDR-FLIP error, 0 to 1; null unless both files hold radiance.
    pub flip_hdr: Option<f64>,
    /// Pixels of the reference and of the picture that hold a NaN or an infinity.
    pub non_finite: [usize; 2],
}

/// A line for each kind of number.
impl fmt::Display for CompareReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let what = if self.is_radiance {
            "radiance"
        } else {
            "what a screen shows"
        };
        writeln!(f, "{:<14}{}", "reference", self.reference.display())?;
        writeln!(f, "{:<14}{}", "picture", self.picture.display())?;
        writeln!(f, "{:<14}{}x{} pixels of {what}", "size", self.width, self.height)?;
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
        if let Some(ssim) = self.ssim {
            writeln!(f, "{:<14}{ssim:.6}", "SSIM")?;
        }
        write!(
            f,
            "{:<14}{flip:.6} at {} pixels a degree",
            "FLIP", self.pixels_per_degree
        )?;
        match self.flip_hdr {
            Some(hdr) => writeln!(f, "; HDR-FLIP {hdr:.6}")?,
            None => writeln!(f)?,
        }
        let [reference, picture] = self.non_finite;
        if reference + picture > 0 {
            writeln!(
                f,
                "{:<14}{reference} pixels of the reference and {picture} of the picture hold a NaN or an infinity",
                "not numbers"
            )?;
        }
        Ok(())
    }
}

/// A deviation in words.
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
    fn lines_tell_what_there_is_and_no_more() {
        let text = report(ALIKE).to_string();
        for words in [
            "4x3 pixels of radiance",
            "PSNR inf dB",
            "HDR-FLIP 0.125000",
            "and 2 of the picture",
        ] {
            assert!(text.contains(words), "{words} in {text}");
        }
        assert!(!text.contains("SSIM"), "{text}");
    }

    #[test]
    fn what_json_has_no_number_for_is_null() {
        let json = serde_json::to_value(report(ALIKE)).unwrap();
        assert!(json["psnr"].is_null() && json["ssim"].is_null());
        assert_eq!(json["radiance"]["rmse"], 0.0);
        assert_eq!(json["flip_hdr"], 0.125);
    }
}
