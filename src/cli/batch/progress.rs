//! Progress display of a batch.

use super::super::args::BatchArgs;
use super::super::progress::{Progress, Verbosity};

/// Returns the progress display that the arguments request.
pub(super) fn progress(args: &BatchArgs) -> Progress {
    let verbosity = if args.quiet {
        Verbosity::Quiet
    } else {
        Verbosity::Normal
    };
    Progress::of_kind(args.watching.progress, verbosity)
}
