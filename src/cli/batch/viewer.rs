//! The pictures of a batch in the viewer tev while they are made: those of the last frames only, as a night's are many.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use crate::watch::TevViewer;

use super::super::failure::Failure;
use super::super::live::{self, Live};
use super::super::progress::Progress;

/// Pictures that the viewer shows at a time; older ones are closed.
const MAX_SHOWN: usize = 8;

/// A viewer, and what it shows.
pub(super) struct Viewer {
    tev: TevViewer,
    /// The oldest first.
    shown: Mutex<VecDeque<String>>,
}

impl Viewer {
    /// The viewer that listens at an address, if one is given.
    pub(super) fn connect(address: Option<&str>) -> Result<Option<Viewer>, Failure> {
        let viewer = live::connect(address)?;
        Ok(viewer.map(|tev| Viewer {
            tev,
            shown: Mutex::default(),
        }))
    }

    /// Shows a black picture for a frame that is begun.
    pub(super) fn begin<'a>(&'a self, name: &'a str, size: [u32; 2]) -> Live<'a> {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if shown.len() == MAX_SHOWN {
            shown.pop_front().iter().for_each(|oldest| self.tev.close(oldest));
        }
        shown.push_back(name.to_owned());
        Live::begin(&self.tev, name, size)
    }

    /// Says it, once, if the viewer has gone away.
    pub(super) fn warn_if_gone(&self, progress: &Progress) {
        live::warn_if_gone(Some(&self.tev), progress);
    }

    /// Lets the viewer take what it has not yet, within reason.
    pub(super) fn finish(self, progress: &Progress) {
        live::finish(Some(self.tev), progress);
    }
}
