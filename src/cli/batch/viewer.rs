//! Live preview of a batch in the viewer tev, limited to the most recent frames.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use whit::render::FinishedTile;
use whit::watch::TevViewer;

use super::super::failure::Failure;
use super::super::preview::{self, Live};

/// Largest number of images in the viewer; older ones are closed.
const MAX_SHOWN: usize = 8;

/// Connection to a viewer with the names of the images that it shows.
pub(super) struct Viewer {
    pub(super) tev: TevViewer,
    /// Names of the images, the oldest first.
    shown: Mutex<VecDeque<String>>,
}

impl Viewer {
    /// Connects to the viewer at an address, if one is given.
    pub(super) fn connect(address: Option<&str>) -> Result<Option<Viewer>, Failure> {
        let viewer = preview::connect(address)?;
        Ok(viewer.map(|tev| Viewer {
            tev,
            shown: Mutex::default(),
        }))
    }

    /// Shows a black image for a frame that starts, and closes the oldest if there are too many.
    pub(super) fn begin(&self, name: &str, size: [u32; 2]) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if shown.len() == MAX_SHOWN {
            shown.pop_front().iter().for_each(|oldest| self.tev.close(oldest));
        }
        shown.push_back(name.to_owned());
        Live::begin(&self.tev, name, size);
    }

    /// Shows a rectangle of a frame's image.
    pub(super) fn show(&self, name: &str, tile: FinishedTile) {
        Live::of_shown(&self.tev, name).show(tile);
    }
}
