//! Job files: a TOML format that lists the frames to render, of one or more scenes.
//!
//! ```toml
//! # What all jobs have, unless they say otherwise; also `scene`, `camera`, `split` and `image`.
//! settings = { size = "320x240", spp = 16 }       # the long flags of `whit render`
//!
//! [[job]]
//! name = "turn"                                   # else its number
//! scene = "whitted_1980.toml"                     # or several: ["a.glb", "b.toml"], beside this file
//! frames = 24                                     # 1 to 24; or "10-20", or every other: "1-24x2"
//! turntable = { turns = 1 }                       # the camera goes round what there is, about +y
//! image = "{scene}.{frame:04}.png"                # also .exr
//!
//! [[job]]
//! scene = "walk.glb"
//! camera = ["front", "top"]                       # names or numbers; each frame is made with each of them
//! frames = "1-48"
//! animation = { name = "Walk", fps = 24, from = 0 }
//!
//! [[job]]
//! scene = "gems.toml"
//! frames = 60
//! path = [                                        # where the camera is at some frames, and smoothly between them
//!     { frame = 1, from = [0, 1, 5], at = [0, 0, 0], fov = 40 },
//!     { frame = 60, from = [4, 2, 3], at = [0, 1, 0], fov = 30, roll = 10 },
//! ]
//! interpolation = "smooth"                        # or "linear"
//!
//! [[job]]
//! scene = "metals.toml"
//! sweep = { "material.ball.roughness" = [0, 0.1, 0.2], "light.0.intensity" = { from = 10, to = 40, steps = 4 } }
//! settings = { spp = 64, backend = "bsp" }        # beside what all have
//! split = { bands = 4, shares = 2 }               # each frame in eight pieces, which may be made anywhere
//! image = "{scene}.{roughness}.{intensity}.exr"
//! ```
//!
//! * **Settings** are flags of `whit render`: `true` is a flag without a value, `false` removes a flag that all jobs
//!   have.
//! * **Frames** are numbered as written. Scenes, cameras, values of sweeps and frames multiply. A job without `frames`
//!   has the frames of its path, or of its animation from `from` to `to`, else one.
//! * **Turntable**: frame k of n, counted from 0, is rotated by k/n of the turns, so that the last frame does not
//!   repeat the first; frames that a step leaves out are counted. `axis` is a direction, +y by default; `center` is a
//!   point, by default the centre of the scene's bounds.
//! * **Paths**: a smooth path follows cubics whose slope at a key is that of the parabola through the key and its
//!   neighbours; it passes through all keys. `up` is +y by default; `fov` and `roll`, by which the camera rolls to its
//!   right, are in degrees.
//! * **Animations**: the first frame is at `from` seconds, and each following number is 1/`fps` later, also where a
//!   step leaves numbers out.
//! * **Sweeps** change a scene file before it is parsed: tables by name or, from 0, by index; parts that contain points
//!   are quoted, as in `'material."a.b".ior'`. The last part may be a key that the file does not have. Steps are
//!   integers if the ends are and the steps allow it. With `zip = true` keys do not multiply but are combined in step:
//!   their first values, their second, ...
//! * **Names** of images may contain `{scene}`, `{camera}`, `{job}`, `{frame}`, `{time}`, and the last part of each
//!   swept key, or as many last parts as distinguish it from the others, as in `{ball.roughness}`; a width as in
//!   `{frame:04}` pads with zeros. Any character other than a letter, a digit, a space or one of `-_+.,=@` becomes `_`.
//!   No two frames may have the same name.
//!
//! This module does not open scenes.

mod camera_motion;
mod camera_path;
mod expand;
mod output_paths;
mod range;
mod spec;
mod sweep;
mod template;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use camera_path::{CameraPose, OrbitView};

use crate::scene_file::{Edit, SceneFileError};

/// Frames of a job file, fully expanded.
#[derive(Clone, Debug)]
pub struct Jobs {
    /// Path of the job file.
    pub path: PathBuf,
    /// All frames, in the order of the file.
    pub frames: Vec<Frame>,
}

/// One image to render, with its scene, camera and settings.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Path of the scene file.
    pub scene: PathBuf,
    /// Name or index of the camera; the scene's first camera if absent.
    pub camera: Option<String>,
    /// Change of the camera's position and orientation.
    pub view: OrbitView,
    /// Animation and time at which the scene is posed; absent for a scene at rest.
    pub moment: Option<Moment>,
    /// Overrides of keys in the scene file.
    pub edits: Vec<Edit>,
    /// Render settings, shared by all frames of a job.
    pub settings: Arc<JobSettings>,
    /// Path of the image file relative to the output folder, without `..` or a leading `/`.
    pub image: PathBuf,
}

/// Point in time of an animation.
#[derive(Clone, Debug, PartialEq)]
pub struct Moment {
    /// Name or index of the animation; all animations if absent.
    pub animation: Option<String>,
    /// Time in seconds from the start of the animation.
    pub seconds: f64,
}

/// Render settings of all frames of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSettings {
    /// Name of the job.
    pub job: String,
    /// Line of the job file where the job begins, counted from 1.
    pub line: usize,
    /// Flags of `whit render` without their dashes, with their values.
    pub flags: Vec<(String, FlagValue)>,
    /// Number of bands of rows that a frame is split into; at least 1.
    pub bands: u32,
    /// Number of shares that the samples of a frame are split into; at least 1.
    pub shares: u32,
}

/// Value of a command-line flag.
#[derive(Clone, Debug, PartialEq)]
pub enum FlagValue {
    /// No value: the flag is a switch.
    None,
    /// String or number, in the spelling of the command line.
    Word(String),
}

impl Jobs {
    /// Parses a job file and expands it to frames.
    ///
    /// # Errors
    ///
    /// One sentence for: a file that is no TOML, unknown keys, invalid frames, names or numbers, missing scene files,
    /// and two frames with the same image name.
    pub fn load(path: &Path) -> Result<Jobs, SceneFileError> {
        expand::load(path)
    }
}
