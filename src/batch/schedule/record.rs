//! Records of the frames that a process has rendered, for the page of a batch.

use super::built_scene::BuiltScene;
use super::frame::FrameResult;
use crate::render::RenderProfile;

/// Record of a frame that a process has rendered, or failed to render.
#[derive(Clone, Debug)]
pub enum FrameRecord {
    /// Frame that is rendered, or pieces of it.
    Rendered {
        /// True if the image is complete in its place; otherwise only pieces are on disk.
        is_whole: bool,
        /// Width and height in pixels.
        size: [u32; 2],
        /// Number of samples per pixel that the settings request.
        spp: u32,
        /// Mean number of samples per pixel.
        samples: f64,
        /// Seconds of loading and building; 0 except for the first frame of a scene.
        setup_seconds: [f64; 2],
        /// Seconds of rendering and writing.
        seconds: [f64; 2],
        /// Rays and seconds by effect.
        ledger: Box<RenderProfile>,
    },
    /// Frame that has no image, with the reason.
    Failed(String),
}

impl FrameRecord {
    pub(super) fn of(made: &FrameResult, stage: &BuiltScene) -> FrameRecord {
        FrameRecord::Rendered {
            is_whole: made.is_whole,
            size: made.head.size,
            spp: made.head.spp,
            samples: made.samples,
            setup_seconds: stage.seconds_once(),
            seconds: [made.render_seconds, made.write_seconds],
            ledger: Box::new(made.ledger),
        }
    }
}
