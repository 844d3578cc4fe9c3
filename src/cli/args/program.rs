//! Arguments of the commands that describe the program itself: `whit help`, `whit man` and `whit completions`.

use std::path::PathBuf;

use clap::Args as ArgGroup;

/// Arguments of `whit help`.
#[derive(Debug, ArgGroup)]
pub(crate) struct HelpArgs {
    /// Topic of the manual or command; without one, commands and topics are listed
    #[arg(value_name = "TOPIC")]
    pub(crate) topic: Option<String>,
}

/// Arguments of `whit man`.
#[derive(Debug, ArgGroup)]
#[command(after_help = "Example:\n  whit man . && man ./whit-render.1")]
pub(crate) struct ManArgs {
    /// Existing folder to write whit.1, whit-render.1 and so on into
    #[arg(value_name = "DIR")]
    pub(crate) folder: PathBuf,
}

/// Arguments of `whit completions`.
#[derive(Debug, ArgGroup)]
#[command(after_help = "Example:\n  whit completions bash > ~/.local/share/bash-completion/completions/whit")]
pub(crate) struct CompletionsArgs {
    /// Shell to print completions for
    #[arg(value_name = "SHELL")]
    pub(crate) shell: clap_complete::Shell,
}
