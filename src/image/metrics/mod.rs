//! Image-difference metrics for two images of one size: in radiance, as displayed, and as perceived.
//!
//! [`compare`] evaluates complete images, with an error map; a [`Tally`] accumulates over parts of an image. All sums
//! are f64. *As displayed* means after exposure, clipping to black and white and the sRGB curve, not rounded to codes:
//! 1/255 is the width of one.

mod flip;
mod flip_color;
mod flip_filter;
mod flip_hdr;
#[cfg(test)]
mod pairs;
mod ssim;

use glam::DVec3;
use serde::Serialize;

use super::{LinearImage, ToneMap};

/// Default number of pixels per degree of the visual field: a screen 0.7 m wide with 3840 pixels, seen from 0.7 m
/// (Andersson et al. 2020, section 6).
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Fraction of a channel's range above which a pixel counts as changed: the width of an 8-bit code.
pub const VISIBLE_STEP: f64 = 1.0 / 255.0;

/// Constant added to the squared reference radiance in the denominator of relative errors.
pub const DARKEST_SQUARE: f64 = 1e-2;

/// Viewing conditions of an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewing {
    /// Tone mapping of radiance to displayed values.
    pub tone: ToneMap,
    /// Pixels per degree of the visual field; at least 1.
    pub pixels_per_degree: f64,
}

impl Default for Viewing {
    fn default() -> Viewing {
        Viewing {
            tone: ToneMap::default(),
            pixels_per_degree: PIXELS_PER_DEGREE,
        }
    }
}

/// Differences of values, over all pixels and channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Deviation {
    /// Root of the mean square difference.
    pub rmse: f64,
    /// Mean of the absolute differences.
    pub mae: f64,
    /// Largest of the absolute differences.
    pub max: f64,
}

/// Difference of an image from its reference. All values are 0 for equal images, except the ratio [`Metrics::psnr`];
/// only [`Metrics::rel_mse`] depends on which of the two is the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Metrics {
    /// Deviation of linear radiance, before exposure; NaN if a pixel is NaN.
    pub radiance: Deviation,
    /// Mean squared difference of radiance, each divided by the sum of the reference's square and [`DARKEST_SQUARE`].
    pub rel_mse: f64,
    /// Deviation of displayed values, from 0 for black to 1 for white; NaN is displayed black.
    pub displayed: Deviation,
    /// Peak signal-to-noise ratio in decibels, as displayed, for a peak of 1; infinite for images displayed alike.
    pub psnr: f64,
    /// Fraction of the pixels with a channel that differs by more than [`VISIBLE_STEP`] as displayed.
    pub changed_share: f64,
    /// Mean LDR-FLIP error, from 0 for equal images to 1.
    pub flip: f64,
}

/// Result of [`compare`] for two images.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Metrics over the whole image.
    pub metrics: Metrics,
    /// Mean structural similarity as displayed, 1 for images displayed alike; `None` for images of less than 11 pixels
    /// a side.
    pub ssim: Option<f64>,
    /// LDR-FLIP error of each pixel, 0 to 1, row by row, the top row first.
    pub flip_map: Vec<f32>,
}

/// Reasons that two images cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// Images of different sizes, whose pixels do not correspond.
    #[error(
        "images of {}x{} and {}x{} pixels differ in size: give two of the same size",
        .reference[0],
        .reference[1],
        .test[0],
        .test[1]
    )]
    Sizes {
        /// Width and height of the reference.
        reference: [u32; 2],
        /// Width and height of the test image.
        test: [u32; 2],
    },
}

/// Compares the image `test` with `reference`.
pub fn compare(
    reference: &LinearImage,
    test: &LinearImage,
    viewing: &Viewing,
) -> Result<Comparison, CompareError> {
    let mut tally = Tally::default();
    let flip_map = tally.add(reference, test, viewing)?;
    Ok(Comparison {
        metrics: tally.metrics(),
        ssim: ssim::ssim([reference, test], f64::from(viewing.tone.exposure_ev).exp2()),
        flip_map,
    })
}

/// Returns the HDR-FLIP error of each pixel, 0 to 1, row by row: the maximum over the exposures at which `reference` is
/// likely to be viewed. For images of linear radiance.
///
/// # Errors
///
/// If the sizes differ.
pub fn flip_hdr_map(
    reference: &LinearImage,
    test: &LinearImage,
    pixels_per_degree: f64,
) -> Result<Vec<f32>, CompareError> {
    check_sizes(reference, test)?;
    Ok(flip_hdr::hdr_error_map(reference, test, pixels_per_degree))
}

/// Checks that two images have one size.
fn check_sizes(reference: &LinearImage, test: &LinearImage) -> Result<(), CompareError> {
    let [reference, test] = [reference, test].map(|image| [image.width, image.height]);
    if reference != test {
        return Err(CompareError::Sizes { reference, test });
    }
    Ok(())
}

/// Metrics accumulated over several parts of an image.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pixel_count: usize,
    changed_count: usize,
    radiance: Sums,
    relative_squares: f64,
    displayed: Sums,
    flip: f64,
}

impl Tally {
    /// Adds a part; returns the FLIP error of its pixels, row by row.
    ///
    /// FLIP's filters extend a sixth of a degree around each pixel; a part is extended by its border pixels.
    pub fn add(
        &mut self,
        reference: &LinearImage,
        test: &LinearImage,
        viewing: &Viewing,
    ) -> Result<Vec<f32>, CompareError> {
        check_sizes(reference, test)?;
        // Sum differences of radiance and of displayed values
        let gain = f64::from(viewing.tone.exposure_ev).exp2();
        for (a, b) in reference.pixels.iter().zip(&test.pixels) {
            let mut changed = false;
            for (&a, &b) in a.iter().zip(b) {
                let [a, b] = [a, b].map(f64::from);
                self.radiance.add(a - b);
                self.relative_squares += (a - b).powi(2) / (a * a + DARKEST_SQUARE);
                let step = as_displayed(a * gain) - as_displayed(b * gain);
                self.displayed.add(step);
                changed |= step.abs() > VISIBLE_STEP;
            }
            self.changed_count += usize::from(changed);
        }
        // Add the FLIP errors
        let shown = |pixel: [f32; 3]| DVec3::from(pixel.map(|x| clipped(gain * f64::from(x))));
        let map = flip::error_map([reference, test], &shown, viewing.pixels_per_degree);
        self.flip += map.iter().copied().map(f64::from).sum::<f64>();
        self.pixel_count += map.len();
        Ok(map)
    }

    /// Returns the metrics over all parts added; those of equal images if there are none.
    pub fn metrics(&self) -> Metrics {
        let count = self.pixel_count.max(1) as f64;
        let displayed = self.displayed.deviation(3.0 * count);
        Metrics {
            radiance: self.radiance.deviation(3.0 * count),
            rel_mse: self.relative_squares / (3.0 * count),
            displayed,
            psnr: -20.0 * displayed.rmse.log10(),
            changed_share: self.changed_count as f64 / count,
            flip: self.flip / count,
        }
    }
}

/// Sums over absolute and squared differences.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    squares: f64,
    absolute: f64,
    max: f64,
}

impl Sums {
    fn add(&mut self, difference: f64) {
        let size = difference.abs();
        self.squares += size * size;
        self.absolute += size;
        // Keep a NaN: comparisons with it are false.
        if !(size <= self.max) && !self.max.is_nan() {
            self.max = size;
        }
    }

    fn deviation(&self, count: f64) -> Deviation {
        Deviation {
            rmse: (self.squares / count).sqrt(),
            mae: self.absolute / count,
            max: self.max,
        }
    }
}

/// Returns the displayable part of a linear channel, 0 to 1; NaN is black.
fn clipped(radiance: f64) -> f64 {
    if radiance > 0.0 { radiance.min(1.0) } else { 0.0 }
}

/// Returns the sRGB value of a radiance, 0 to 1 (IEC 61966-2-1).
pub fn as_displayed(radiance: f64) -> f64 {
    /// Upper end of the curve's linear piece.
    const LINEAR_END: f64 = 0.003_130_8;
    let linear = clipped(radiance);
    if linear <= LINEAR_END {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(values: &[f32]) -> LinearImage {
        LinearImage {
            width: values.len() as u32,
            height: 1,
            pixels: values.iter().map(|&v| [v; 3]).collect(),
        }
    }

    fn metrics(a: &LinearImage, b: &LinearImage) -> Metrics {
        compare(a, b, &Viewing::default()).unwrap().metrics
    }

    #[test]
    fn equal_images_have_no_difference() {
        let image = gray(&[0.0, 0.25, 7.0, -1.0]);
        let metrics = metrics(&image, &image);
        assert_eq!(metrics.radiance, Deviation::default());
        assert_eq!(metrics.displayed, Deviation::default());
        assert_eq!(
            (metrics.psnr, metrics.changed_share, metrics.flip),
            (f64::INFINITY, 0.0, 0.0)
        );
    }

    #[test]
    fn differences_match_textbook_formulas() {
        // Differences 0, 0, 0, 1 and their squares: means 1/4; root 1/2. Displayed values are equal to radiance, as 0
        // and 1 stay 0 and 1, up to a rounding of 1.055 - 0.055.
        let metrics = metrics(&gray(&[0.0, 1.0, 1.0, 0.0]), &gray(&[0.0, 1.0, 1.0, 1.0]));
        let Deviation { rmse, mae, max } = metrics.radiance;
        assert_eq!((rmse, mae, max), (0.5, 0.25, 1.0));
        let Deviation { rmse, mae, max } = metrics.displayed;
        for (value, expected) in [(rmse, 0.5), (mae, 0.25), (max, 1.0)] {
            assert!((value - expected).abs() <= f64::EPSILON, "{value}");
        }
        // 20 log10 2 = 6.0206 dB.
        assert!((metrics.psnr - 6.0206).abs() < 1e-4, "{}", metrics.psnr);
        assert_eq!(metrics.changed_share, 0.25);
    }

    #[test]
    fn values_clamped_by_the_display_do_not_differ() {
        let metrics = metrics(&gray(&[1.0, 0.0]), &gray(&[3.0, -2.0]));
        assert_eq!(
            metrics.radiance,
            Deviation {
                rmse: 2.0,
                mae: 2.0,
                max: 2.0
            }
        );
        assert_eq!((metrics.displayed, metrics.flip), (Deviation::default(), 0.0));
    }

    #[test]
    fn pixel_counts_as_changed_from_one_code_step() {
        // The curve's linear piece is 12.92 times radiance.
        let code = (VISIBLE_STEP / 12.92) as f32;
        let share = |radiance| metrics(&gray(&[0.0, 0.0]), &gray(&[0.0, radiance])).changed_share;
        assert_eq!((share(0.999 * code), share(1.001 * code)), (0.0, 0.5));
    }

    #[test]
    fn exposure_makes_dark_differences_visible() {
        let (a, b) = (gray(&[0.0]), gray(&[2e-4]));
        let at = |exposure_ev| {
            let viewing = Viewing {
                tone: ToneMap { exposure_ev },
                ..Viewing::default()
            };
            compare(&a, &b, &viewing).unwrap().metrics
        };
        assert_eq!((at(0.0).changed_share, at(1.0).changed_share), (0.0, 1.0));
        assert_eq!(at(0.0).radiance, at(1.0).radiance);
    }

    #[test]
    fn nan_makes_radiance_metrics_nan_and_displays_black() {
        let metrics = metrics(&gray(&[f32::NAN, 0.5, 0.0]), &gray(&[0.0, 0.5, 0.25]));
        assert!(metrics.radiance.rmse.is_nan() && metrics.radiance.max.is_nan());
        // 1.055 · 0.25^(1/2.4) - 0.055 = 0.5371.
        assert!((metrics.displayed.max - 0.5371).abs() < 1e-4);
        assert!(metrics.flip.is_finite());
    }

    #[test]
    fn partial_metrics_sum_to_the_pixel_mean() {
        let (a, b) = (gray(&[0.0, 0.0, 0.5]), gray(&[1.0, 0.0, 0.5]));
        let mut tally = Tally::default();
        tally.add(&a, &b, &Viewing::default()).unwrap();
        let once = tally.metrics();
        tally.add(&a, &a, &Viewing::default()).unwrap();
        let twice = tally.metrics();
        assert_eq!(twice.changed_share, once.changed_share / 2.0);
        assert!((twice.flip - once.flip / 2.0).abs() < 1e-12);
    }

    #[test]
    fn images_of_different_sizes_are_rejected() {
        let error = compare(&gray(&[0.0]), &gray(&[0.0, 1.0]), &Viewing::default()).unwrap_err();
        assert!(error.to_string().contains("1x1 and 2x1"), "{error}");
    }
}
