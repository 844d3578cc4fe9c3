//! Flags of where rays start that leave surfaces.

use clap::Args as ArgGroup;

use crate::numeric::SpawnPolicy;

/// Where rays start that leave surfaces.
#[derive(Clone, Copy, Debug, ArgGroup)]
pub(in crate::cli) struct LeavingArgs {
    /// Where rays start that leave a surface: off it by a bound on the rounding error, by a fixed part of the scene's
    /// size, as in fixed:0.0001, or not at all
    #[arg(long, value_name = "bounded|fixed:PART|none", default_value_t = SpawnPolicy::default())]
    pub(in crate::cli) spawn: SpawnPolicy,
}
