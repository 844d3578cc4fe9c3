//! Result rows of `whit bench`: the speed of a tracing method for one kind of ray, and its build.

use std::path::PathBuf;

use serde::Serialize;

use super::ray_workload::RayKind;
use super::replay::Mode;
use crate::accel::{Backend, EmbreeIdentity, Instancing, Precision};
use crate::measure::Interval;

/// Measurement of one tracing method for one kind of ray in one scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BenchRow {
    /// Path of the scene as given on the command line.
    pub scene: PathBuf,
    /// Number of triangles of the scene, counted once per instance.
    pub triangles: u64,
    /// Intersection backend that was measured.
    pub backend: Backend,
    /// Representation of instanced meshes in Embree; absent for other backends and scenes without instanced meshes.
    pub instancing: Option<Instancing>,
    /// Precision of triangle hits.
    pub precision: Precision,
    /// Kind of rays that were traced.
    pub rays: RayKind,
    /// Grouping of the rays per call.
    pub mode: Mode,
    /// Million rays per second of processor time on one thread: the median over the repetitions.
    pub mrays_per_s: f64,
    /// Million rays per second of the slowest repetition.
    pub mrays_per_s_min: f64,
    /// Million rays per second of the fastest repetition.
    pub mrays_per_s_max: f64,
    /// Number of rays replayed in each repetition.
    pub ray_count: u64,
    /// Build seconds on `threads` threads: the median over the repetitions.
    pub build_seconds: f64,
    /// Build seconds of the fastest repetition.
    pub build_seconds_min: f64,
    /// Build seconds of the slowest repetition.
    pub build_seconds_max: f64,
    /// Memory of the acceleration structure in bytes.
    pub bytes: u64,
    /// Number of results that differ from the first backend's packets by more than rounding; raw calls are compared
    /// with their own backend's packets.
    pub mismatches: u64,
    /// Number of results that differ within the documented rounding.
    pub ties: u64,
    /// Number of threads of the build.
    pub threads: usize,
    /// Fraction of its time in which a calibration kernel waited for a processor: other programs used it.
    pub waiting: f64,
    /// Identity of the Embree library, where it is the backend.
    pub embree: Option<EmbreeIdentity>,
    /// Time of the whole frame on one thread, where raw packets were timed: with Embree at this precision, otherwise
    /// with the first backend.
    pub frame: Option<FrameTime>,
    /// Speeds by number of threads in ascending order; empty unless requested.
    pub scaling: Vec<Scaled>,
    /// Build times by number of threads in ascending order.
    pub build_scaling: Vec<ScaledBuild>,
}

/// Speed of several threads together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scaled {
    /// Number of threads that traced rays.
    pub threads: usize,
    /// Million rays per second of all threads together: the median over the repetitions.
    pub mrays_per_s: f64,
    /// Million rays per second of the slowest repetition.
    pub mrays_per_s_min: f64,
    /// Million rays per second of the fastest repetition.
    pub mrays_per_s_max: f64,
}

impl Scaled {
    /// Returns million rays per second as median with extremes.
    pub(crate) fn speed(&self) -> Interval {
        Interval {
            value: self.mrays_per_s,
            low: self.mrays_per_s_min,
            high: self.mrays_per_s_max,
        }
    }
}

/// Build time on several threads.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScaledBuild {
    /// Number of threads that built the structure.
    pub threads: usize,
    /// Wall-clock seconds: the median over the repetitions.
    pub build_seconds: f64,
    /// Wall-clock seconds of the fastest repetition.
    pub build_seconds_min: f64,
    /// Wall-clock seconds of the slowest repetition.
    pub build_seconds_max: f64,
}

/// Time of the render loop, compared with bare traces of equal rays.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameTime {
    /// Median processor seconds of the render phase on one thread.
    pub seconds: f64,
    /// Number of rays of the frame.
    pub rays: u64,
    /// Ratio of `seconds` to the time that the first backend's raw packets take for these rays.
    pub over_raw: f64,
    /// Fraction of `seconds` that is spent within the backend.
    pub trace_share: f64,
}

impl BenchRow {
    /// Returns the backend's name with its precision, where that is a choice, and its kind of instancing.
    pub(crate) fn name(&self) -> String {
        let precision = match self.backend {
            Backend::Embree => format!(" {}", self.precision),
            Backend::Native | Backend::Auto | Backend::Bsp | Backend::Brute => String::new(),
        };
        let instancing = self.instancing.map_or(String::new(), |kind| format!(" {kind}"));
        format!("{}{precision}{instancing}", self.backend)
    }

    /// Returns the key of the acceleration structure that the row used.
    pub(crate) fn structure(&self) -> (Backend, Precision, Option<Instancing>) {
        (self.backend, self.precision, self.instancing)
    }

    /// Returns million rays per second as median with extremes.
    pub(crate) fn speed(&self) -> Interval {
        Interval {
            value: self.mrays_per_s,
            low: self.mrays_per_s_min,
            high: self.mrays_per_s_max,
        }
    }

    /// Returns build seconds as median with extremes.
    pub(crate) fn build(&self) -> Interval {
        Interval {
            value: self.build_seconds,
            low: self.build_seconds_min,
            high: self.build_seconds_max,
        }
    }

    /// Returns the structure's bytes per triangle; `None` without triangles.
    pub(crate) fn bytes_per_triangle(&self) -> Option<f64> {
        (self.triangles > 0).then(|| self.bytes as f64 / self.triangles as f64)
    }
}
