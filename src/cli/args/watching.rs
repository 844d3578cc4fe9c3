//! Flags of how the work is watched from outside.

use clap::Args as ArgGroup;

use crate::cli::progress::ProgressKind;

/// How the work is watched from outside.
#[derive(Clone, Debug, ArgGroup)]
pub(in crate::cli) struct WatchingArgs {
    /// How progress is shown on standard error: a bar on a terminal, JSON lines for programs, or not at all
    #[arg(
        long,
        value_enum,
        value_name = "auto|json|none",
        default_value = "auto",
        hide_possible_values = true
    )]
    pub(in crate::cli) progress: ProgressKind,

    /// Show the picture while it is made in the viewer tev, which listens there, at localhost:14158 where nothing else
    /// was said to it
    #[arg(long, value_name = "HOST:PORT")]
    pub(in crate::cli) tev: Option<String>,
}
