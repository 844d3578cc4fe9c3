//! Live preview of an image in the viewer tev, for the flag `--tev`.

use std::time::Duration;

use super::failure::Failure;
use super::progress::Progress;
use whit::image::LinearImage;
use whit::render::FinishedTile;
use whit::watch::{Rectangle, TevViewer};

/// Timeout for connecting to a viewer.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Timeout at the end of a render without progress of the transfer, after which the remaining data is dropped.
const FINISH_TIMEOUT: Duration = Duration::from_secs(2);

const CHANNELS: [&str; 3] = ["R", "G", "B"];

/// Connects to the viewer that the arguments name, if any.
pub(super) fn connect(address: Option<&str>) -> Result<Option<TevViewer>, Failure> {
    let viewer = address.map(|address| TevViewer::connect(address, CONNECT_TIMEOUT));
    viewer
        .transpose()
        .map_err(|error| Failure::Input(error.to_string()))
}

/// Image that is shown in a viewer.
#[derive(Clone, Copy)]
pub(super) struct Live<'a> {
    viewer: &'a TevViewer,
    name: &'a str,
}

impl<'a> Live<'a> {
    /// Shows a black image of the given name and size.
    pub(super) fn begin(viewer: &'a TevViewer, name: &'a str, [width, height]: [u32; 2]) -> Live<'a> {
        viewer.create(name, width, height, &CHANNELS);
        Live::of_shown(viewer, name)
    }

    /// Returns an image that is shown already.
    pub(super) fn of_shown(viewer: &'a TevViewer, name: &'a str) -> Live<'a> {
        Live { viewer, name }
    }

    /// Shows a rectangle of the image.
    pub(super) fn show(&self, tile: FinishedTile) {
        let rectangle = Rectangle {
            x: tile.x,
            y: tile.y,
            width: tile.width,
            height: tile.height,
        };
        // Split the pixels into planes, one per channel
        let planes = [0, 1, 2].map(|channel| -> Vec<f32> {
            let values = tile.pixels.iter().map(|pixel| pixel[channel]);
            values.collect()
        });
        let planes = [&planes[0][..], &planes[1], &planes[2]];
        self.viewer.update(self.name, rectangle, &CHANNELS, &planes);
    }

    /// Shows the final image, which is filtered, and replaces rectangles that the viewer has missed.
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

/// Warns once if the connection to the viewer is lost.
pub(super) fn warn_if_gone(viewer: Option<&TevViewer>, progress: &Progress) {
    if let Some(trouble) = viewer.and_then(TevViewer::trouble) {
        progress.warn(&trouble);
    }
}

/// Waits for the viewer to accept the remaining data, up to a timeout.
pub(super) fn finish(viewer: Option<TevViewer>, progress: &Progress) {
    if let Some(trouble) = viewer.and_then(|viewer| viewer.finish(FINISH_TIMEOUT)) {
        progress.warn(&trouble);
    }
}
