//! Flags of progress reports and of the live preview.

use clap::Args as ArgGroup;

use crate::cli::progress::ProgressKind;

/// Flag of progress reports.
#[derive(Clone, Debug, ArgGroup)]
pub(in crate::cli) struct ProgressFormatArgs {
    /// Format of the progress on standard error: a bar on a terminal, JSON lines for programs, or none
    #[arg(
        long,
        value_enum,
        value_name = "auto|json|none",
        default_value = "auto",
        hide_possible_values = true
    )]
    pub(in crate::cli) progress: ProgressKind,
}

/// Flags of progress reports and of the live preview.
#[derive(Clone, Debug, ArgGroup)]
pub(in crate::cli) struct ProgressArgs {
    #[command(flatten)]
    pub(in crate::cli) format: ProgressFormatArgs,

    /// Show the image during rendering in the viewer tev, which listens at this address, by default localhost:14158
    #[arg(long, value_name = "HOST:PORT")]
    pub(in crate::cli) tev: Option<String>,
}
