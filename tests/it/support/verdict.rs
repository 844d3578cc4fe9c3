//! Comparison of an image with the reference tracer's, pixel by pixel.

use std::collections::BTreeMap;

use glam::DVec3;
use whit::accel::Backend;
use whit::image::LinearImage;

use super::hits::Decision;
use super::textbook::Pixel;

/// Largest fraction of pixels that may differ, by more than their bound or visibly, each with an uncertain decision.
pub const EXPLAINED_SHARE: f64 = 0.005;

/// Threshold of a visible difference, relative to the pixel or to the image's mean, whichever is larger. Bounds follow
/// the worst case and are infinite behind several boundaries of glass, where nearly all pixels still agree to a few
/// roundings.
pub const VISIBLE: f64 = 1e-4;

/// Returns all backends of this build.
pub fn backends() -> Vec<Backend> {
    let mut backends = vec![Backend::Brute, Backend::Bsp, Backend::Native];
    if cfg!(feature = "embree") {
        backends.push(Backend::Embree);
    }
    backends
}

/// Asserts that every pixel of `image` is within its bound of the reference, except for a few with uncertain decisions.
pub fn assert_agree(what: &str, image: &LinearImage, referee: &[Pixel]) {
    assert_agree_but_for(EXPLAINED_SHARE, what, image, referee);
}

/// Asserts agreement with another fraction of pixels that may differ visibly, each within its bound or uncertain.
pub fn assert_agree_but_for(share: f64, what: &str, image: &LinearImage, referee: &[Pixel]) {
    assert_eq!(image.pixels.len(), referee.len());
    let mut explained = BTreeMap::<Decision, usize>::new();
    let mut wrong = Vec::new();
    let mut worst = 0.0f64;
    let mean = mean_radiance(referee);
    let (mut unpromised, mut visible) = (0, 0);
    // Classify each pixel: within its bound, unknown, uncertain or wrong
    for (index, (&got, pixel)) in image.pixels.iter().zip(referee).enumerate() {
        let expected = pixel.radiance;
        let off = (DVec3::from(got.map(f64::from)) - expected.value()).abs();
        let is_visible = !off
            .cmple(VISIBLE * expected.value().abs().max(DVec3::splat(mean)))
            .all();
        visible += usize::from(is_visible);
        // A NaN is never within a bound; infinite bounds are treated below.
        if off.is_finite() && expected.error().is_finite() && off.cmple(expected.error()).all() {
            let used = (off / expected.error()).to_array();
            // 0 / 0 if both are exact; `max` ignores the NaN.
            worst = used.into_iter().fold(worst, f64::max);
        } else if !is_visible && !expected.error().is_finite() {
            unpromised += 1;
        } else if pixel.doubt.may_flip() && off.is_finite() {
            *explained.entry(pixel.doubt.decision).or_default() += 1;
        } else {
            let (x, y) = (index as u32 % image.width, index as u32 / image.width);
            wrong.push(format!(
                "pixel ({x}, {y}): {got:?}, the reference has {:?} ± {:?}; least certain: {:?}",
                expected.value(),
                expected.error(),
                pixel.doubt
            ));
        }
    }
    // Report and check
    let doubtful = referee.iter().filter(|p| p.doubt.may_flip()).count();
    println!(
        "{what}: worst difference {worst:.3} of its bound; {doubtful} doubtful pixels, of which outside all bounds \
         {explained:?}; {unpromised} equal without a useful bound; {visible} visibly different"
    );
    let shown = wrong.len().min(8);
    assert!(
        wrong.is_empty(),
        "{what}: {} wrong pixels\n{}",
        wrong.len(),
        wrong[..shown].join("\n")
    );
    let differing: usize = explained.values().sum::<usize>().max(visible);
    assert!(
        differing as f64 <= share * referee.len() as f64,
        "{what}: {explained:?}, {visible} visibly different"
    );
}

/// Returns the mean of the pixels' brightest channels.
pub fn mean_radiance(referee: &[Pixel]) -> f64 {
    let radiances = referee.iter().map(|p| p.radiance.value().max_element());
    radiances.sum::<f64>() / referee.len() as f64
}

/// Returns the bound, in units of the image's mean radiance, that holds for this fraction of the pixels.
pub fn relative_bound(referee: &[Pixel], share: f64) -> f64 {
    let mean = mean_radiance(referee);
    let mut bounds: Vec<f64> = referee
        .iter()
        .map(|p| p.radiance.error().max_element() / mean)
        .collect();
    bounds.sort_by(f64::total_cmp);
    bounds[((bounds.len() - 1) as f64 * share) as usize]
}
