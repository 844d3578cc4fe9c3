//! Planned frames of a batch, before any scene is opened.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::BatchError;
use super::request::RenderRequest;
use crate::image::check_writable;
use crate::jobs::{Frame, Jobs};
use crate::render::{Pattern, RenderSettings, Share};
use crate::scene::image_settings::VisibleBackground;

/// Frame of a batch with the image that its settings request.
#[derive(Clone, Debug)]
pub struct PlannedFrame {
    /// Index of the frame in the batch.
    pub number: usize,
    /// Frame as the job file describes it.
    pub frame: Frame,
    /// Requested image, shared by all frames of a job that have the same image format.
    pub request: Arc<RenderRequest>,
    /// Folder of the job file, which paths in settings are relative to.
    pub jobs_folder: Arc<Path>,
}

impl PlannedFrame {
    /// Returns the name of the frame in messages: its image path.
    pub fn name(&self) -> String {
        self.frame.image.display().to_string()
    }

    /// Returns whether both frames can share one loaded scene.
    pub fn shares_scene_with(&self, other: &PlannedFrame) -> bool {
        let (a, b) = (&self.frame, &other.frame);
        Arc::ptr_eq(&a.settings, &b.settings)
            && Arc::ptr_eq(&self.request, &other.request)
            && (&a.scene, &a.moment, &a.edits) == (&b.scene, &b.moment, &b.edits)
    }

    /// Returns the number of pieces that the job divides the frame into.
    pub fn piece_count(&self) -> usize {
        self.frame.settings.bands as usize * self.frame.settings.shares as usize
    }

    /// Returns an error if the frame cannot be divided as its job requests, given the settings of its scene.
    pub(super) fn check_shares(
        &self,
        settings: &RenderSettings,
        time: Option<f64>,
    ) -> Result<(), BatchError> {
        let (image, spp) = (self.name(), settings.spp);
        let most = Share::most(spp);
        if self.frame.settings.shares > most {
            return Err(BatchError::TooManyShares { image, spp, most });
        }
        let is_divided = self.frame.settings.shares > 1 || time.is_some();
        if is_divided && settings.background == VisibleBackground::Transparent {
            return Err(BatchError::DividedAlpha(image));
        }
        let in_order = matches!(settings.pattern, Pattern::Sobol | Pattern::R2);
        match time.is_some() && !in_order {
            true => Err(BatchError::UnorderedPattern(image)),
            false => Ok(()),
        }
    }
}

/// Checks that no frame that must be rendered at once is to be divided, by pieces or by the time limit `time`.
///
/// # Errors
///
/// The error of the first such frame.
pub fn check_division(plans: &[PlannedFrame], time: Option<f64>) -> Result<(), BatchError> {
    for plan in plans {
        let image = plan.name();
        if plan.request.must_render_at_once() && (plan.piece_count() > 1 || time.is_some()) {
            return Err(BatchError::DividedAtOnce(image));
        }
        if (plan.frame.settings.shares > 1 || time.is_some()) && plan.request.has_first_hit_aovs() {
            return Err(BatchError::DividedChannels(image));
        }
    }
    Ok(())
}

/// Creates the folders of all images, and checks that files can be written to them.
///
/// # Errors
///
/// The path of a folder that cannot be created or written to.
pub fn make_folders(jobs: &Jobs, out: &Path) -> Result<(), BatchError> {
    let mut folders = BTreeSet::from([out.to_owned()]);
    folders.extend(image_folders(jobs.frames.iter().map(|frame| &frame.image), out));
    for folder in folders {
        fs::create_dir_all(&folder).map_err(|error| BatchError::CreateFolder(folder.clone(), error))?;
        check_writable(&folder.join("picture.png"))?;
    }
    Ok(())
}

/// Removes temporary files that killed processes have left in the folders of the images.
pub(super) fn remove_leftovers(plans: &[PlannedFrame], out: &Path) {
    let folders = image_folders(plans.iter().map(|plan| &plan.frame.image), out);
    let entries = folders.iter().filter_map(|folder| fs::read_dir(folder).ok());
    for entry in entries.flatten().flatten() {
        let name = entry.file_name();
        let is_left_over = |name: &str| name.starts_with(".whit-") && name.ends_with(".tmp");
        if name.to_str().is_some_and(is_left_over) {
            // Files that cannot be removed do no harm.
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// Returns the folders of images within the output folder, each once.
fn image_folders<'a>(images: impl Iterator<Item = &'a PathBuf>, out: &Path) -> BTreeSet<PathBuf> {
    images
        .filter_map(|image| Some(out.join(image.parent()?)))
        .collect()
}
