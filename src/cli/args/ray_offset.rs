//! Flags of hit points on surfaces and of the origins of rays that leave them.

use clap::Args as ArgGroup;

use whit::numeric::SpawnPolicy;
use whit::render::HitPoint;

/// Flags of hit points on surfaces and of the origins of rays that leave them.
#[derive(Clone, Copy, Debug, ArgGroup)]
pub(in crate::cli) struct RayOffsetArgs {
    /// Offset of the origins of rays that leave a surface: a bound on the rounding error, a fixed part of the scene's
    /// size, as in fixed:0.0001, or none
    #[arg(long, value_name = "bounded|fixed:PART|none", default_value_t = SpawnPolicy::default())]
    pub(in crate::cli) spawn: SpawnPolicy,

    /// Computation of hit points: in f64 from the primitive, or from the f32 parameter along the ray
    #[arg(long, value_enum, default_value_t = HitPoint::default())]
    pub(in crate::cli) hit_points: HitPoint,
}
