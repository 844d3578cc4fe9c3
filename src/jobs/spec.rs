//! Serde input types of a job file, before validation.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Value;

use super::camera_path::Interpolation;
use super::range::FrameRange;
use crate::scene_file::forms::forms;
use crate::scene_file::value::Located;

/// Top level of a job file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobDocument {
    pub(super) scene: Option<Located<ScalarList>>,
    pub(super) camera: Option<ScalarList>,
    #[serde(default)]
    pub(super) settings: BTreeMap<String, Located<Value>>,
    pub(super) split: Option<Located<SplitSpec>>,
    pub(super) image: Option<Located<String>>,
    #[serde(default)]
    pub(super) job: Vec<Located<JobSpec>>,
}

/// Table `[[job]]` of a job file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobSpec {
    pub(super) name: Option<Located<String>>,
    pub(super) scene: Option<Located<ScalarList>>,
    pub(super) camera: Option<ScalarList>,
    pub(super) frames: Option<FrameRange>,
    pub(super) turntable: Option<Located<TurntableSpec>>,
    #[serde(default)]
    pub(super) path: Vec<Located<KeySpec>>,
    pub(super) interpolation: Option<Located<Interpolation>>,
    pub(super) animation: Option<Located<AnimationSpec>>,
    #[serde(default)]
    pub(super) sweep: BTreeMap<String, Located<SweepSpec>>,
    pub(super) zip: Option<Located<bool>>,
    #[serde(default)]
    pub(super) settings: BTreeMap<String, Located<Value>>,
    pub(super) split: Option<Located<SplitSpec>>,
    pub(super) image: Option<Located<String>>,
}

/// Table `turntable`: rotation of the camera about an axis.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TurntableSpec {
    #[serde(default = "one")]
    pub(super) turns: f64,
    #[serde(default = "up")]
    pub(super) axis: [f64; 3],
    pub(super) center: Option<[f64; 3]>,
}

/// Key of a camera path.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct KeySpec {
    pub(super) frame: f64,
    pub(super) from: [f64; 3],
    pub(super) at: [f64; 3],
    #[serde(default = "up")]
    pub(super) up: [f64; 3],
    /// Vertical field of view in degrees.
    pub(super) fov: Option<f64>,
    /// Roll to the right in degrees.
    #[serde(default)]
    pub(super) roll: f64,
}

/// Table `animation`: clip, frame rate and time range of a glTF animation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AnimationSpec {
    pub(super) name: Option<Word>,
    #[serde(default = "default_fps")]
    pub(super) fps: f64,
    #[serde(default)]
    pub(super) from: f64,
    pub(super) to: Option<f64>,
}

/// Values of a swept key: a list, or equidistant steps.
#[derive(Debug)]
pub(super) enum SweepSpec {
    List(Vec<Value>),
    Steps(StepsSpec),
}

forms! {
    ['de] SweepSpec, "a list of values, or as in { from = 0, to = 1, steps = 5 }";
    list list => Vec::deserialize(list).map(SweepSpec::List);
    table table => StepsSpec::deserialize(table).map(SweepSpec::Steps);
}

/// Equidistant values from `from` to `to`, both included.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepsSpec {
    pub(super) from: Value,
    pub(super) to: Value,
    pub(super) steps: u32,
}

/// Table `split`: number of pieces of a frame.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SplitSpec {
    #[serde(default = "one_piece")]
    pub(super) bands: u32,
    #[serde(default = "one_piece")]
    pub(super) shares: u32,
}

fn one() -> f64 {
    1.0
}

fn up() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

/// Returns the default frame rate, in frames per second, that of cinema films.
fn default_fps() -> f64 {
    24.0
}

fn one_piece() -> u32 {
    1
}

/// Name or index, written as a string or an integer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Word(pub(super) String);

/// One or more names or indices.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ScalarList(pub(super) Vec<String>);

forms! {
    ['de] Word, "a name or a number";
    text word => Ok(Word(word.to_owned()));
    integer number => Ok(Word(number.to_string()));
}

forms! {
    ['de] ScalarList, "a name, a number, or a list of them";
    text word => Ok(ScalarList(vec![word.to_owned()]));
    integer number => Ok(ScalarList(vec![number.to_string()]));
    list list => {
        let words: Vec<Word> = Vec::deserialize(list)?;
        Ok(ScalarList(words.into_iter().map(|word| word.0).collect()))
    };
}
