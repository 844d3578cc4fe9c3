//! Results of a study of a scene.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::target::Target;
use super::{GeometricErrors, Interval, Knob, ParetoPoint, Timing, knee};

/// All measurements of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Study {
    /// Width and height of the measured images, in pixels.
    pub size: [u32; 2],
    /// Width and height of the complete image where the measured ones are a grid of its patches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pieces_of: Option<[u32; 2]>,
    /// Number of threads that rendered.
    pub threads: usize,
    /// Reference that errors are taken against.
    pub reference: Reference,
    /// Conditions under which times were measured.
    pub timing: Timing,
    /// All configurations; the first is the base.
    pub points: Vec<Point>,
    /// Knobs with several levels, with the fall of the error as they take more time.
    pub curves: Vec<Curve>,
    /// Settings chosen for the target, if one was given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub choice: Option<Choice>,
}

/// Settings that were chosen for a target, with their measurements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Target that the settings were chosen for.
    pub target: Target,
    /// True if the settings reach the target: the whole interval of the error or of the time does, in images that were
    /// not used for the choice.
    pub reached: bool,
    /// Complete configuration as names and values; the nearest one if none reaches the target.
    pub settings: BTreeMap<String, String>,
    /// Predicted root mean squared error.
    pub foretold_rmse: f64,
    /// Predicted seconds for the complete image.
    pub foretold_seconds: f64,
    /// Root mean squared error of displayed values.
    pub rmse: Interval,
    /// Seconds for the samples of an image of the measured size.
    pub seconds: Interval,
    /// Seconds for the complete image, scaled by its number of pixels, setup included.
    pub whole_seconds: Interval,
    /// Number of settings that were measured during the search.
    pub tried: usize,
    /// Smallest error predicted for any settings, and the knob that would lower it if its range went further.
    pub floor: Option<(f64, Knob)>,
}

/// Reference image that errors are taken against, in two independent halves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Smallest number of samples per pixel of each half; pixels with much noise have more.
    pub spp: u32,
    /// Intersection backends of the two halves.
    pub paths: [String; 2],
    /// Root mean squared error of the mean of the halves, in displayed values (black is 0, white 1).
    pub noise: f64,
    /// Checks that the reference must pass.
    pub checks: Vec<Check>,
}

impl Reference {
    /// Returns whether all checks hold, so that errors are reliable.
    pub fn has_converged(&self) -> bool {
        self.checks.iter().all(|check| check.holds)
    }
}

/// Check of a reference and its result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Check {
    /// Short name, of one or two words.
    pub name: String,
    /// True if the check passes.
    pub holds: bool,
    /// Measured value and its bound, in words.
    pub words: String,
}

/// Measured configuration with its times and errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Knob that differs from the base; `None` for the base.
    pub knob: Option<Knob>,
    /// Level of the knob in words; `base` for the base.
    pub level: String,
    /// Complete configuration as names and values.
    pub settings: BTreeMap<String, String>,
    /// Seconds to build the acceleration structure, once per scene.
    pub build_seconds: f64,
    /// Bytes of the acceleration structure, without the vertices that it shares with the scene.
    #[serde(default)]
    pub build_bytes: u64,
    /// Seconds before the first sample, once per image of any size: mip maps, light tables. 0 for images with photons,
    /// whose share of them counts as time of the samples.
    pub ready_seconds: f64,
    /// Seconds for the samples of an image.
    pub seconds: Interval,
    /// Seconds relative to the base's.
    pub time_ratio: Interval,
    /// Root mean squared error of displayed values (black is 0, white 1), without the reference's noise.
    pub rmse: Interval,
    /// Part of the squared error that remains however many images are averaged.
    pub bias_squared: Interval,
    /// Part of the squared error that differs between images.
    pub variance: f64,
    /// Relative mean squared error: mean squared error of radiance over the squared reference.
    pub rel_mse: f64,
    /// Mean LDR-FLIP error of one image.
    pub flip: f64,
    /// Largest error of a displayed channel in one image.
    pub max: f64,
    /// Fraction of one image's pixels with a visible error: a channel differs by more than 1/255.
    pub changed_share: f64,
    /// Number of non-finite pixels in one image.
    pub non_finite: u64,
    /// Number of rays of an image.
    pub rays: u64,
    /// Instructions per pixel on one thread; absent where they were not counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instructions: Option<f64>,
    /// Wrong hits of recorded rays; absent where the knob cannot change which hits are found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub geometry: Option<GeometricErrors>,
    /// True if no other point is both faster and more accurate (Pareto front).
    pub on_front: bool,
}

/// Fall of the error along the levels of a knob.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Knob whose levels form the curve.
    pub knob: Knob,
    /// Points of the curve in order of time, as indices into [`Study::points`].
    pub points: Vec<usize>,
    /// Slope of log error over log time, if there are enough points for a line.
    pub slope: Option<Interval>,
}

impl Point {
    /// Returns a point with the given error and time (the latter also as ratio to the base), all else zero.
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

    /// Returns the mean squared error of displayed values.
    pub fn mean_square(&self) -> f64 {
        self.rmse.value.powi(2)
    }
}

impl Study {
    /// Returns the index of the Pareto front's knee, beyond which less error costs much time; the base where there is
    /// no knee.
    pub fn knee(&self) -> usize {
        let place = |point: &Point| ParetoPoint {
            time: point.time_ratio,
            error: point.rmse,
        };
        let places: Vec<ParetoPoint> = self.points.iter().map(place).collect();
        let on_front: Vec<bool> = self.points.iter().map(|point| point.on_front).collect();
        knee(&places, &on_front).unwrap_or(0)
    }

    /// Returns the factor by which time grows for half the error along the curve, by its slope: `None` where the error
    /// does not fall.
    pub fn time_factor_of_half_error(&self, curve: &Curve) -> Option<Interval> {
        let slope = curve.slope?;
        // Error grows like time^slope, so that half the error takes 2^(-1/slope) times the time.
        let price = |slope: f64| 2f64.powf(-1.0 / slope);
        (slope.high < 0.0).then(|| Interval {
            value: price(slope.value),
            low: price(slope.low),
            high: price(slope.high),
        })
    }
}
