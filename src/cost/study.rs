//! What a study of a scene found.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::choose::Target;
use super::{GeometricErrors, Interval, Knob, Place, knee};

/// Everything that was measured of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Study {
    /// Width and height of the pictures that were measured.
    pub size: [u32; 2],
    /// Where they were put together from pieces of a larger one: its width and height.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pieces_of: Option<[u32; 2]>,
    /// Threads that rendered.
    pub threads: usize,
    /// What errors are held against.
    pub reference: Reference,
    /// How times were taken.
    pub timing: Timing,
    /// Every configuration; the first is the base.
    pub points: Vec<Point>,
    /// Knobs that were turned to several places, with how the error falls as they take more time.
    pub curves: Vec<Curve>,
    /// What was chosen, if a target was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub choice: Option<Choice>,
}

/// Settings that were chosen for a target, and measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// For what.
    pub target: Target,
    /// Whether they reach it: the whole interval of the error or of the time does, in pictures that had no part in the
    /// choice.
    pub reached: bool,
    /// The whole configuration, as the settings' names and values; the nearest one if none reaches it.
    pub settings: BTreeMap<String, String>,
    /// Root of the mean squared error that was foretold.
    pub foretold_rmse: f64,
    /// Seconds of the whole picture that were foretold.
    pub foretold_seconds: f64,
    /// Root of the mean squared error as displayed.
    pub rmse: Interval,
    /// Seconds of the samples of a picture of the measured size.
    pub seconds: Interval,
    /// Seconds of the whole picture, by its number of pixels, with what is made ready for it.
    pub whole_seconds: Interval,
    /// Settings that were measured on the way.
    pub tried: usize,
    /// The least error that is foretold of any settings, and the knob that would lower it if it could be turned further.
    pub floor: Option<(f64, Knob)>,
}

/// The picture that errors are held against, in two independent halves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Samples a pixel of each half.
    pub spp: u32,
    /// What found the hits of each half.
    pub paths: [String; 2],
    /// Root of the mean square that the mean of the halves still errs by, as displayed (black is 0, white 1).
    pub noise: f64,
    /// What was asked of it.
    pub checks: Vec<Check>,
}

impl Reference {
    /// Whether errors may be trusted.
    pub fn has_converged(&self) -> bool {
        self.checks.iter().all(|check| check.holds)
    }
}

/// Something that was asked of a reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// A word or two.
    pub name: String,
    /// Whether the answer is as it must be.
    pub holds: bool,
    /// What was measured, against what bound.
    pub words: String,
}

/// How times were taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Blocks in which every configuration took one turn, and which count.
    pub blocks: usize,
    /// Blocks that do not, as the machine was busy with something else.
    pub dropped: usize,
    /// Largest deviation of the kernel that says so among those that count, as a share of its median.
    pub calibration_spread: f64,
    /// Seconds that everything took.
    pub spent: f64,
    /// Seconds that it was to take.
    pub budget: f64,
}

/// A configuration and what was measured of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// The knob that is turned; the base turns none.
    pub knob: Option<Knob>,
    /// To where, as the knob words it; `base` for the base.
    pub level: String,
    /// The whole configuration, as the settings' names and values.
    pub settings: BTreeMap<String, String>,
    /// Seconds to build what finds the hits, once a scene.
    pub build_seconds: f64,
    /// Bytes of what finds hits, the vertices that it shares with the scene not counted.
    #[serde(default)]
    pub build_bytes: u64,
    /// Seconds before the first sample, once a picture of any size: levels of images, tables of lights.
    pub ready_seconds: f64,
    /// Seconds of the samples of a picture.
    pub seconds: Interval,
    /// Those over the base's.
    pub time_ratio: Interval,
    /// Root of the mean squared error as displayed (black is 0, white 1), the reference's own noise not counted.
    pub rmse: Interval,
    /// The part of the squared error that stays however many pictures are averaged.
    pub bias_squared: Interval,
    /// The part that differs from picture to picture.
    pub variance: f64,
    /// Mean squared error of radiance over the reference's square.
    pub rel_mse: f64,
    /// Mean LDR-FLIP error of one picture.
    pub flip: f64,
    /// Largest error of a channel as displayed, of one picture.
    pub max: f64,
    /// Part of the pixels of one picture that are visibly off: a channel by more than 1/255.
    pub changed_share: f64,
    /// Pixels of one picture that are no numbers.
    pub non_finite: u64,
    /// Rays of a picture.
    pub rays: u64,
    /// Instructions of a pixel, by one thread; absent where none were counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instructions: Option<f64>,
    /// What it errs by where hits are found; absent where its knob cannot change which are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geometry: Option<GeometricErrors>,
    /// Whether no other is known to be both faster and closer.
    pub on_front: bool,
}

/// How the error falls along a knob.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Which.
    pub knob: Knob,
    /// Its points, by time, as places in [`Study::points`].
    pub points: Vec<usize>,
    /// Of the logarithm of the error over that of the time, if there are points enough for a line.
    pub slope: Option<Interval>,
}

impl Point {
    /// One of which only the time, which is its ratio to the base's too, and the error are told.
    #[cfg(test)]
    pub(crate) fn plain(knob: Option<Knob>, time: f64, rmse: f64) -> Point {
        Point {
            knob,
            level: String::new(),
            settings: BTreeMap::new(),
            build_seconds: 0.0,
            build_bytes: 0,
            ready_seconds: 0.0,
            seconds: Interval::exact(time),
            time_ratio: Interval::exact(time),
            rmse: Interval::exact(rmse),
            bias_squared: Interval::exact(0.0),
            variance: rmse * rmse,
            rel_mse: 0.0,
            flip: 0.0,
            max: 0.0,
            changed_share: 0.0,
            non_finite: 0,
            rays: 0,
            instructions: None,
            geometry: None,
            on_front: false,
        }
    }

    /// The mean squared error.
    pub fn mean_square(&self) -> f64 {
        self.rmse.value.powi(2)
    }
}

impl Study {
    /// The point from which on less error is dear and before which less time is; the base where nothing tells.
    pub fn knee(&self) -> usize {
        let place = |point: &Point| Place {
            time: point.time_ratio,
            error: point.rmse,
        };
        let places: Vec<Place> = self.points.iter().map(place).collect();
        let on_front: Vec<bool> = self.points.iter().map(|point| point.on_front).collect();
        knee(&places, &on_front).unwrap_or(0)
    }

    /// How many times the time is that half the error takes along the curve, by its slope: `None` where the error does
    /// not fall.
    pub fn price_of_half(&self, curve: &Curve) -> Option<Interval> {
        let slope = curve.slope?;
        let price = |slope: f64| 2f64.powf(-1.0 / slope);
        (slope.high < 0.0).then(|| Interval {
            value: price(slope.value),
            low: price(slope.low),
            high: price(slope.high),
        })
    }
}
