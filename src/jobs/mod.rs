//! Job files: which frames are to be made of which scenes, as a person writes it.
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
//! * **Settings** are given as flags are: `true` is a flag without a value, `false` takes away one that all jobs have.
//! * **Frames** are numbered as written. Scenes, cameras, values of sweeps and frames multiply. A job without `frames`
//!   has those of its path, or of its animation from `from` to `to`, else one.
//! * **Turntable**: frame k of n, from 0, stands at k/n of the turns, so that the last does not repeat the first; frames
//!   that a step leaves out are counted. `axis` is a direction, +y unless given; `center` a point, else the middle of
//!   what there is.
//! * **Paths**: a smooth one follows cubics whose slope at a key is that of the parabola through it and its neighbours;
//!   it goes through all keys. `up` is +y unless given; `fov` and `roll`, with which the camera leans to its right, are
//!   degrees.
//! * **Animations**: the first frame is at `from` seconds, and each number more is 1/`fps` later, also where a step
//!   leaves numbers out.
//! * **Sweeps** change a scene file before it is read: tables by name or, from 0, by number; parts with points in quotes,
//!   as in `'material."a.b".ior'`. The last word may be new to the file. Steps are whole numbers where the ends are and
//!   the steps allow it. With `zip = true` keys do not multiply but go together: their first values, their second, ...
//! * **Names** may have `{scene}`, `{camera}`, `{job}`, `{frame}`, `{time}`, and the last word of each swept key, or as
//!   many last words as tell it from the others, as in `{ball.roughness}`; a width as in `{frame:04}` fills up with
//!   zeros. What is neither a letter, a digit, a space nor one of `-_+.,=@` becomes `_`. No two frames may have the same
//!   name.
//!
//! Nothing here opens a scene.

mod expand;
mod form;
mod motion;
mod names;
mod range;
mod sweep;
mod template;
#[cfg(test)]
mod tests;
mod view;

use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use view::{Pose, View};

use crate::scene_file::{Edit, SceneFileError};

/// All frames of a job file.
#[derive(Clone, Debug)]
pub struct Jobs {
    /// The file.
    pub path: PathBuf,
    /// In their order.
    pub frames: Vec<Frame>,
}

/// One picture that is to be made.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its scene.
    pub scene: PathBuf,
    /// Name or number of its camera; the scene's first if none is said.
    pub camera: Option<String>,
    /// How that camera stands.
    pub view: View,
    /// At which moment of which animation.
    pub moment: Option<Moment>,
    /// What is changed in the scene's file.
    pub edits: Vec<Edit>,
    /// How it is rendered, the same for all frames of a job.
    pub settings: Arc<JobSettings>,
    /// Its file, within the folder of results: a name without folders above.
    pub image: PathBuf,
}

/// A moment of an animation.
#[derive(Clone, Debug, PartialEq)]
pub struct Moment {
    /// Name or number of the animation; all of them if none is said.
    pub animation: Option<String>,
    /// In seconds.
    pub seconds: f64,
}

/// How the frames of a job are rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSettings {
    /// The job's name.
    pub job: String,
    /// Line of the job file where the job begins, counted from 1.
    pub line: usize,
    /// Flags of `whit render` without their dashes, with their values.
    pub flags: Vec<(String, FlagValue)>,
    /// Bands of rows that a frame is cut into; at least 1.
    pub bands: u32,
    /// Shares that its samples are taken in; at least 1.
    pub shares: u32,
}

/// What a flag is given.
#[derive(Clone, Debug, PartialEq)]
pub enum FlagValue {
    /// Nothing: its name says it.
    None,
    /// A word or a number.
    Word(String),
}

impl Jobs {
    /// Reads a job file.
    ///
    /// # Errors
    ///
    /// One sentence: a file that is no TOML, keys that are not known, frames, names or numbers that make no sense, scenes
    /// that are not there, two frames of one name.
    pub fn load(path: &Path) -> Result<Jobs, SceneFileError> {
        expand::load(path)
    }
}
