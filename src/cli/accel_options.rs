//! Ray tracing flags of the command line: precision, acceleration structures and threads.

use whit::accel::{Backend, BuildQuality, Instancing};
use whit::batch::request::{HitPath, TracingOptions};

use super::args::TracingArgs;
use super::failure::Failure;

/// Returns the options of the arguments, with 0 threads replaced by one per processor.
pub(super) fn tracing_options(args: &TracingArgs, backend: Backend) -> TracingOptions {
    TracingOptions {
        requested: HitPath {
            backend,
            precision: args.precision,
            instancing: args.instancing,
            build_quality: args.build_quality,
            compact: args.compact,
        },
        isa: args.isa.clone(),
        ..TracingOptions::of_threads(args.threads)
    }
}

/// Returns an error if flags for Embree alone are given with another backend.
pub(super) fn check_backend(args: &TracingArgs, backend: Backend) -> Result<(), Failure> {
    let of_embree = [
        ("--instancing", args.instancing != Instancing::Auto),
        ("--build-quality", args.build_quality != BuildQuality::default()),
        ("--compact", args.compact),
    ];
    match of_embree.iter().find(|(_, is_given)| *is_given) {
        Some((flag, _)) if !matches!(backend, Backend::Embree | Backend::Auto) => Err(Failure::Input(
            format!("`{flag}` applies to Embree only: leave it out with `--backend {backend}`"),
        )),
        _ => Ok(()),
    }
}

/// Returns an error if the requested kind of instancing is not available with the requested precision.
pub(super) fn check_instancing(args: &TracingArgs) -> Result<(), Failure> {
    // Accept the kind if the precision does not change it
    if args.instancing.resolved(args.precision) == args.instancing || args.instancing == Instancing::Auto {
        return Ok(());
    }
    Err(Failure::Input(format!(
        "`--instancing {}` is not available with `--precision {}`, which intersects instances through callbacks: \
         choose `--precision fast` or `robust`",
        args.instancing, args.precision
    )))
}
