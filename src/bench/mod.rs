//! Measurements of backends on recorded rays, of bounding volumes, and of effects: `whit bench` and
//! `whit info --prices`.

mod ablation;
mod backends;
mod bounding_volumes;
mod error;
mod options;
mod ray_workload;
mod replay;
mod rows;
mod structures;
mod times;

pub use ablation::{Ablation, AblationOptions, AblationStudy, TimeChange, ablation_study};
pub use backends::measure_backends;
pub use bounding_volumes::{BoundingVolumeRow, measure_bounding_volumes};
pub use error::BenchError;
pub use options::{BenchOptions, MeasuredScene};
pub use ray_workload::RayKind;
pub use replay::Mode;
pub use rows::{BenchRow, FrameTime, Scaled, ScaledBuild};
