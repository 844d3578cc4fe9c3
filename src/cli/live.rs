//! The picture in the viewer tev while it is made: `--tev`.

use std::time::Duration;

use super::failure::Failure;
use super::progress::Progress;
use crate::image::LinearImage;
use crate::render::FinishedTile;
use crate::watch::{Rectangle, TevViewer};

/// How long a viewer may take to answer.
const ANSWER: Duration = Duration::from_secs(5);
/// How long a viewer may take nothing, at the end, before the rest is left out.
const PATIENCE: Duration = Duration::from_secs(2);

const CHANNELS: [&str; 3] = ["R", "G", "B"];

/// The viewer that the arguments name, if any.
pub(super) fn connect(address: Option<&str>) -> Result<Option<TevViewer>, Failure> {
    let viewer = address.map(|address| TevViewer::connect(address, ANSWER));
    viewer
        .transpose()
        .map_err(|error| Failure::Input(error.to_string()))
}

/// A picture in a viewer.
#[derive(Clone, Copy)]
pub(super) struct Live<'a> {
    viewer: &'a TevViewer,
    name: &'a str,
}

impl<'a> Live<'a> {
    /// Shows a black picture of that name and size.
    pub(super) fn begin(viewer: &'a TevViewer, name: &'a str, [width, height]: [u32; 2]) -> Live<'a> {
        viewer.create(name, width, height, &CHANNELS);
        Live { viewer, name }
    }

    /// Shows a part of it.
    pub(super) fn show(&self, tile: FinishedTile) {
        let rectangle = Rectangle {
            x: tile.x,
            y: tile.y,
            width: tile.width,
            height: tile.height,
        };
        let planes = [0, 1, 2].map(|channel| -> Vec<f32> {
            let values = tile.pixels.iter().map(|pixel| pixel[channel]);
            values.collect()
        });
        let planes = [&planes[0][..], &planes[1], &planes[2]];
        self.viewer.update(self.name, rectangle, &CHANNELS, &planes);
    }

    /// Shows all of it as it is in the end: filtered, and without what the viewer has missed.
    pub(super) fn finish(&self, image: &LinearImage) {
        self.show(FinishedTile {
            x: 0,
            y: 0,
            width: image.width,
            height: image.height,
            pixels: &image.pixels,
        });
    }
}

/// Says it, once, if the viewer has gone away.
pub(super) fn warn_if_gone(viewer: Option<&TevViewer>, progress: &Progress) {
    if let Some(trouble) = viewer.and_then(TevViewer::trouble) {
        progress.warn(&trouble);
    }
}

/// Lets the viewer take what it has not yet, within reason.
pub(super) fn finish(viewer: Option<TevViewer>, progress: &Progress) {
    if let Some(trouble) = viewer.and_then(|viewer| viewer.finish(PATIENCE)) {
        progress.warn(&trouble);
    }
}
