//! Result of an experiment: the study with its images.

use super::view::View;
use super::{Configuration, DisplayImage, ImageSums, Interval, SplitReference, Study};
use crate::accel::EmbreeIdentity;
use crate::image::{LinearImage, ToneMap};
use crate::render::RenderSettings;

/// Result of an experiment: the study with its images.
pub struct StudyResult {
    /// Numerical results of the study.
    pub study: Study,
    /// Mean image of the reference's halves.
    pub reference: LinearImage,
    /// First image of each point, in the order of the study's points.
    pub images: Vec<LinearImage>,
    /// Configuration of each point, in the order of the study's points.
    pub configurations: Vec<Configuration>,
    /// Configuration chosen for the target; `None` without a target.
    pub chosen: Option<Configuration>,
    /// Data to compute the complete image's error, if there is a target.
    pub patch_reference: Option<PatchReference>,
    /// Identity of the Embree library that the base used, if it used Embree.
    pub embree: Option<EmbreeIdentity>,
}

/// Measured patches of an image with the two halves of their reference.
pub struct PatchReference {
    pub(super) view: View,
    pub(super) settings: RenderSettings,
    pub(super) tone: ToneMap,
    pub(super) halves: SplitReference,
}

impl PatchReference {
    /// Returns the root mean squared error, in displayed values, of an image of the base's size, which must not be one
    /// of the measured images; `None` where the size differs.
    pub fn rmse(&self, image: &LinearImage) -> Option<Interval> {
        let RenderSettings { width, height, .. } = self.settings;
        if [image.width, image.height] != [width, height] {
            return None;
        }
        // Extract the patches that the reference covers
        let shown = match self.view {
            View::Whole(size) if size == [width, height] => DisplayImage::new(image, self.tone),
            View::Whole(_) => return None,
            View::Patches(mosaic) => self.view.with_blocks(DisplayImage::new(
                &mosaic.of_picture(&self.settings, image),
                self.tone,
            )),
        };
        // Estimate the error against both halves
        let mut sums = ImageSums::new(&self.halves);
        sums.add(&self.halves, &shown);
        Some(sums.estimate(&self.halves, 0).rmse())
    }
}
