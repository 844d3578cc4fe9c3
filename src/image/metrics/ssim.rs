//! SSIM, structural similarity: compares luminance, contrast and structure of two images in a window around each pixel.
//!
//! Z. Wang, A. C. Bovik, H. R. Sheikh and E. P. Simoncelli, "Image Quality Assessment: From Error Visibility to
//! Structural Similarity", IEEE Transactions on Image Processing 13(4), 2004, with their constants, on the luma of
//! displayed values; only pixels whose whole window lies in the image count.

use super::as_displayed;
use super::flip_filter::{FlipKernel, FlipPlane};
use crate::image::LinearImage;
use crate::parallel;

/// Radius of the window in pixels, and the standard deviation of its Gaussian weights.
const RADIUS: usize = 5;
const DEVIATION: f64 = 1.5;
/// Stabilising constants for ratios of small means and variances, for values in a range of 1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Weights of red, green and blue in luma (ITU-R BT.601).
const LUMA: [f64; 3] = [0.299, 0.587, 0.114];

/// Returns the mean similarity, -1 to 1 and 1 for images displayed alike, of two images of one size whose linear
/// radiance is displayed times `gain`; `None` if no window fits.
pub(super) fn ssim(images: [&LinearImage; 2], gain: f64) -> Option<f64> {
    let [width, height] = [images[0].width, images[0].height].map(|n| n as usize);
    if width.min(height) <= 2 * RADIUS {
        return None;
    }
    // Compute the luma of displayed values
    let luma = |pixel: &[f32; 3]| -> f64 {
        let shown = pixel.map(|channel| as_displayed(gain * f64::from(channel)));
        LUMA.iter().zip(shown).map(|(part, shown)| part * shown).sum()
    };
    let [x, y] = images.map(|image| {
        let pixels = &image.pixels;
        parallel::generate(pixels.len(), |index| luma(&pixels[index]))
    });
    // Compute local means and second moments
    let window = FlipKernel::gaussian(RADIUS as i32, DEVIATION);
    let blurred = |value: &(dyn Fn(usize) -> f64 + Sync)| {
        let values = parallel::generate(x.len(), value);
        FlipPlane { width, values }.filtered(&window, &window).values
    };
    let means = [blurred(&|i| x[i]), blurred(&|i| y[i])];
    let squares = [blurred(&|i| x[i] * x[i]), blurred(&|i| y[i] * y[i])];
    let products = blurred(&|i| x[i] * y[i]);
    // Average the similarity over pixels whose window fits
    let similarity = |i: usize| {
        let [a, b] = [means[0][i], means[1][i]];
        let [var_x, var_y] = [squares[0][i] - a * a, squares[1][i] - b * b];
        let covariance = products[i] - a * b;
        (2.0 * a * b + C1) * (2.0 * covariance + C2) / ((a * a + b * b + C1) * (var_x + var_y + C2))
    };
    let inner = (RADIUS..height - RADIUS).flat_map(|row| {
        let first = row * width;
        first + RADIUS..first + width - RADIUS
    });
    let count = (width - 2 * RADIUS) * (height - 2 * RADIUS);
    Some(inner.map(similarity).sum::<f64>() / count as f64)
}

#[cfg(test)]
mod tests {
    use super::super::pairs::{COUNT, pairs};
    use super::*;
    use crate::image::linear_from_srgb;

    /// Results of scikit-image 0.26 for the pairs, with the weights and the constants of the paper.
    const PUBLISHED: [f64; COUNT] = [
        0.391_864_651_034_604_05,
        0.596_087_298_946_888_2,
        0.658_636_746_239_425_9,
        0.374_473_320_006_151_1,
    ];

    fn all() -> [(&'static str, [LinearImage; 2]); COUNT] {
        pairs(|code| linear_from_srgb(f64::from(code) / 255.0))
    }

    #[test]
    fn ssim_matches_a_published_program() {
        for ((name, [a, b]), expected) in all().iter().zip(PUBLISHED) {
            let found = ssim([a, b], 1.0).unwrap();
            // Radiance is stored in f32, which limits the precision of small variances.
            assert!((found - expected).abs() < 1e-5, "{name}: {found}");
            assert_eq!(ssim([b, a], 1.0), Some(found), "{name}");
        }
    }

    #[test]
    fn image_has_full_similarity_to_itself() {
        for (name, [a, _]) in all() {
            let found = ssim([&a, &a], 1.0).unwrap();
            assert!((found - 1.0).abs() < 1e-12, "{name}: {found}");
        }
    }

    #[test]
    fn image_smaller_than_the_window_has_no_similarity() {
        let small = LinearImage::black(10, 30);
        assert_eq!(ssim([&small, &small], 1.0), None);
        let fits = LinearImage::black(11, 11);
        assert_eq!(ssim([&fits, &fits], 1.0), Some(1.0));
    }
}
