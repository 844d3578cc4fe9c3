//! Manifest of a batch's output folder.

use std::io;
use std::path::Path;

use whit::batch::{Manifest, Shard};

use super::super::args::BatchArgs;
use super::super::failure::Failure;

/// Returns the error for a complete image that could not be added to the manifest.
pub(super) fn manifest_error(image: &Path, error: &io::Error) -> Failure {
    Failure::Work(format!(
        "{} cannot be added to the manifest: {error}",
        image.display()
    ))
}

/// Opens the manifest; rejects an output folder with results of an earlier run, unless these are to be kept.
pub(super) fn manifest(args: &BatchArgs) -> Result<Manifest, Failure> {
    let out = args.out.display();
    let unreadable = |error| Failure::Input(format!("cannot open the manifest in {out}: {error}"));
    if !args.resume && args.shard == Shard::ALL && !Manifest::read(&args.out).map_err(unreadable)?.is_empty()
    {
        return Err(Failure::Input(format!(
            "{out} has results of an earlier run: give `--resume` to keep them, or another `--out`"
        )));
    }
    Manifest::open(&args.out, args.shard).map_err(unreadable)
}
