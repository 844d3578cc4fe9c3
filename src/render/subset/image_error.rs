//! Estimate of a finished image's error, from two more images of a few blocks of its pixels.
//!
//! For an image X and two images A and B that have the same mean and independent errors, the mean of (X - A)(X - B) is
//! the squared error of X, however large the errors of A and B are: they take a quarter of the samples, in the pattern
//! whose positions differ between pixels and seeds. What A and B share with X is not seen: limits of depth, cut-off
//! weights, steps through volumes.

use serde::Serialize;

use super::super::context::RenderContext;
use super::super::monitor::{Cancelled, Monitor};
use super::super::settings::RenderSettings;
use super::super::tile::Tile;
use super::super::wavefront::RendererPool;
use super::tiles::{inner, pixels, spread};
use crate::image::LinearImage;
use crate::image::metrics::as_displayed;
use crate::parallel;
use crate::scene::image_settings::Pattern;

/// Fraction of the image's samples that A and B take together, unless [`MIN_PIXELS`] take more.
const SAMPLE_FRACTION: f64 = 0.02;
/// Smallest number of pixels that are rendered again.
const MIN_PIXELS: f64 = 4096.0;
/// Side of a block of these pixels: small, as many blocks represent the image better.
const SIDE: u32 = 8;
/// Ratio of the image's samples per pixel to those of A and of B.
const SAMPLE_RATIO: f64 = 4.0;
/// Differences between the seeds of A and B and that of the image.
const SEEDS: [u32; 2] = [0x6a09_e667, 0xbb67_ae85];
/// Smallest and largest rate r at which the error of n samples falls as 1 / n^r: that of random samples, and that of
/// evenly distributed samples of smooth functions.
const RATES: [f64; 2] = [0.5, 1.5];
/// Standard errors on either side of a 95 % interval.
const STANDARD_ERRORS: f64 = 2.0;

/// Estimated error of an image by its noise, in displayed values: black is 0, white 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ImageError {
    /// Root mean square error over pixels and channels.
    pub rmse: f64,
    /// Ends of the interval that contains it with 95 % probability, as far as the pixels represent the image.
    pub interval: [f64; 2],
    /// Stops of exposure of the displayed values.
    pub stops: f32,
    /// Number of pixels that were rendered again.
    pub pixels: u64,
    /// Factor of the samples for half the error; `None` where it is not measured: pixels have different numbers of samples,
    /// these are not of the Sobol pattern, or two per pixel.
    pub samples_of_half_error: Option<f64>,
}

/// Sums over the pixels and channels of a block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct BlockSums {
    count: f64,
    /// Sum of (X - A)(X - B).
    products: f64,
    /// Sum of (A - B)².
    squares: f64,
}

impl BlockSums {
    /// Compares the pixels of `image` in `block` with those of `a` and `b`, which have the size of the block.
    fn new(image: &LinearImage, block: Tile, [a, b]: [&LinearImage; 2], gain: f64) -> BlockSums {
        let shown = |channel: f32| as_displayed(gain * f64::from(channel));
        let rows = image.pixels.chunks(image.width as usize);
        let rows = rows.skip(block.y as usize).take(block.height as usize);
        let columns = block.x as usize..(block.x + block.width) as usize;
        let x = rows.flat_map(|row| &row[columns.clone()]);
        let mut sums = BlockSums::default();
        for ((x, a), b) in x.zip(&a.pixels).zip(&b.pixels) {
            for channel in 0..3 {
                let [x, a, b] = [x, a, b].map(|pixel| shown(pixel[channel]));
                sums.count += 1.0;
                sums.products += (x - a) * (x - b);
                sums.squares += (a - b) * (a - b);
            }
        }
        sums
    }
}

/// Estimates the error of an image of `frame` that took a mean number of samples per pixel, as displayed with `stops` of
/// exposure. Afterwards no more of the image can be rendered with `frame`.
pub(in crate::render) fn image_error(
    mut frame: RenderContext,
    (image, taken): (&LinearImage, f64),
    stops: f32,
    monitor: &Monitor,
) -> Result<ImageError, Cancelled> {
    let settings = frame.settings;
    let RenderSettings { width, height, .. } = settings;
    // At least two samples: a single one is in the middle of each pixel, where the error at edges does not show
    let pixel_count = f64::from(width) * f64::from(height);
    let spp = ((taken / SAMPLE_RATIO) as u32).max(2);
    let sample_ratio = taken / f64::from(spp);
    let aimed = 0.5 * SAMPLE_FRACTION * sample_ratio * pixel_count;
    let blocks = blocks(&settings, aimed.max(MIN_PIXELS));
    // Render the blocks with either seed
    let mut images = Vec::with_capacity(2);
    for seed in SEEDS {
        frame.set_samples(settings.seed.wrapping_add(seed), spp, Pattern::Sobol);
        let waves = RendererPool::new(&frame);
        let render = |index: usize| {
            monitor.check()?;
            let block = blocks[index];
            let (result, _) = waves.acquire().render_tile(block, None);
            Ok(pixels(
                block,
                inner(block, &frame.settings),
                result,
                &frame.settings,
            ))
        };
        let rendered: Result<Vec<LinearImage>, Cancelled> =
            parallel::map(blocks.len(), &render).into_iter().collect();
        images.push(rendered?);
    }
    // Compare them with the image
    let gain = f64::from(stops).exp2();
    let sums: Vec<BlockSums> = blocks
        .iter()
        .zip(images[0].iter().zip(&images[1]))
        .map(|(&block, (a, b))| BlockSums::new(image, inner(block, &frame.settings), [a, b], gain))
        .collect();
    let is_measured = settings.has_equal_counts() && settings.pattern == Pattern::Sobol;
    Ok(ImageError {
        stops,
        ..summary(&sums, is_measured.then_some(sample_ratio))
    })
}

/// Returns evenly distributed blocks of about `count` pixels together, with the pixels around them that a filter needs.
fn blocks(settings: &RenderSettings, count: f64) -> Vec<Tile> {
    let RenderSettings { width, height, .. } = *settings;
    let reach = settings.reach();
    let columns = width.div_ceil(SIDE) as usize;
    let along = |cell: usize, size: u32| {
        let start = cell as u32 * SIDE;
        let first = start.saturating_sub(reach);
        (first, (start + SIDE + reach).min(size) - first)
    };
    spread([columns, height.div_ceil(SIDE) as usize])
        .take((count / f64::from(SIDE * SIDE)).ceil() as usize)
        .map(|cell| {
            let (x, width) = along(cell % columns, width);
            let (y, height) = along(cell / columns, height);
            Tile { x, y, width, height }
        })
        .collect()
}

/// Returns the estimate by the sums of all blocks; `sample_ratio` is the ratio of the image's samples per pixel to those
/// of A and B, which have the same pattern.
fn summary(sums: &[BlockSums], sample_ratio: Option<f64>) -> ImageError {
    let total = |of: fn(&BlockSums) -> f64| sums.iter().map(of).sum::<f64>();
    let count = total(|block| block.count).max(1.0);
    let square = total(|block| block.products) / count;
    // Compute the standard error from the differences between blocks
    let deviations = sums
        .iter()
        .map(|block| (block.products - square * block.count).powi(2))
        .sum::<f64>();
    let blocks = sums.len() as f64;
    let error = STANDARD_ERRORS * (deviations * blocks / (blocks - 1.0).max(1.0)).sqrt() / count;
    let root = |square: f64| square.max(0.0).sqrt();
    // Compare the errors at the two numbers of samples
    let of_fewer = root(0.5 * total(|block| block.squares) / count);
    let rate = sample_ratio
        .filter(|ratio| *ratio != 1.0 && square > 0.0)
        .map(|ratio| ((of_fewer / root(square)).ln() / ratio.ln()).clamp(RATES[0], RATES[1]));
    ImageError {
        rmse: root(square),
        interval: [root(square - error), root(square + error)],
        stops: 0.0,
        pixels: (count / 3.0).round() as u64,
        samples_of_half_error: rate.map(|rate| rate.recip().exp2()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_and_rate_of_known_sums() {
        // X has an error of 0.1 and four times the samples of A and B, whose error is 0.2: the rate is 1/2.
        let sums = [BlockSums {
            count: 100.0,
            products: 1.0,
            squares: 8.0,
        }; 5];
        let error = summary(&sums, Some(4.0));
        assert!((error.rmse - 0.1).abs() < 1e-12, "{error:?}");
        assert!(
            error.interval.iter().all(|end| (end - 0.1).abs() < 1e-7),
            "{error:?}"
        );
        assert!(
            (error.samples_of_half_error.unwrap() - 4.0).abs() < 1e-9,
            "{error:?}"
        );
        assert_eq!(summary(&sums, None).samples_of_half_error, None);
    }

    #[test]
    fn interval_grows_with_the_differences_between_blocks() {
        let of = |products| BlockSums {
            count: 100.0,
            products,
            squares: 8.0,
        };
        let even = summary(&[of(1.0); 8], Some(4.0));
        let uneven = summary(&[0.0, 2.0, 0.0, 2.0, 0.0, 2.0, 0.0, 2.0].map(of), Some(4.0));
        assert!((even.rmse - uneven.rmse).abs() < 1e-12);
        assert!(
            uneven.interval[0] < 0.6 * even.rmse && uneven.interval[1] > 1.2 * even.rmse,
            "{uneven:?}"
        );
    }

    #[test]
    fn image_without_noise_has_no_error() {
        let sums = [BlockSums {
            count: 100.0,
            ..BlockSums::default()
        }; 4];
        let error = summary(&sums, Some(4.0));
        assert_eq!(
            (error.rmse, error.interval, error.samples_of_half_error),
            (0.0, [0.0; 2], None)
        );
    }
}
