//! Flags of where hits lie and where rays start that leave them.

use clap::Args as ArgGroup;

use crate::numeric::SpawnPolicy;
use crate::render::HitPoint;

/// Where hits lie and where rays start that leave them.
#[derive(Clone, Copy, Debug, ArgGroup)]
pub(in crate::cli) struct LeavingArgs {
    /// Where rays start that leave a surface: off it by a bound on the rounding error, by a fixed part of the scene's
    /// size, as in fixed:0.0001, or not at all
    #[arg(long, value_name = "bounded|fixed:PART|none", default_value_t = SpawnPolicy::default())]
    pub(in crate::cli) spawn: SpawnPolicy,

    /// Where hits lie: worked out again in f64 from the primitive, or where the f32 parameter along the ray says
    #[arg(long, value_enum, default_value_t = HitPoint::default())]
    pub(in crate::cli) hit_points: HitPoint,
}
