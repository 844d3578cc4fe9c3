//! Ray tracing options of the command line: precision, acceleration structures and threads.

use std::thread;

use whit::accel::{AccelOptions, Backend, BuildQuality, Instancing, Precision};
use whit::cost::HitPath;

use super::args::TracingArgs;
use super::failure::Failure;

/// Ray tracing options for any backend.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tracing {
    pub(super) precision: Precision,
    pub(super) instancing: Instancing,
    pub(super) build_quality: BuildQuality,
    pub(super) compact: bool,
    pub(super) isa: Option<String>,
    /// Number of threads, at least 1.
    pub(super) threads: usize,
}

impl Tracing {
    /// Returns the options of the arguments, with 0 threads replaced by one per processor.
    pub(super) fn new(args: &TracingArgs) -> Tracing {
        let threads = match args.threads {
            0 => thread::available_parallelism().map_or(1, usize::from),
            n => n as usize,
        };
        Tracing {
            precision: args.precision,
            instancing: args.instancing,
            build_quality: args.build_quality,
            compact: args.compact,
            isa: args.isa.clone(),
            threads,
        }
    }

    /// Returns the options for building an acceleration structure.
    pub(super) fn options(&self) -> AccelOptions<'static> {
        AccelOptions {
            precision: self.precision,
            instancing: self.instancing,
            build_quality: self.build_quality,
            compact: self.compact,
            threads: self.threads,
            isa: self.isa.clone(),
            ..AccelOptions::default()
        }
    }

    /// Returns the default options with `threads` threads; 0 takes one per processor.
    pub(super) fn of_threads(threads: u32) -> Tracing {
        Tracing::new(&TracingArgs {
            precision: Precision::default(),
            instancing: Instancing::default(),
            build_quality: BuildQuality::default(),
            compact: false,
            isa: None,
            threads,
        })
    }

    /// Returns the hit path from which a study with this backend starts.
    pub(super) fn path(&self, backend: Backend) -> HitPath {
        match backend {
            Backend::Embree => HitPath {
                backend,
                precision: self.precision,
                instancing: self.instancing,
                build_quality: self.build_quality,
                compact: self.compact,
            },
            // The BSP has no instancing and no build options
            Backend::Bsp | Backend::Brute => HitPath {
                precision: effective_precision(backend, self.precision),
                ..HitPath::BSP
            },
        }
    }

    /// Starts the thread pool for all of the work.
    pub(super) fn pool(&self) -> Result<rayon::ThreadPool, Failure> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .build()
            .map_err(|error| {
                Failure::Work(format!(
                    "cannot start {} threads: {error}; give fewer `--threads`",
                    self.threads
                ))
            })
    }
}

/// Returns the precision that triangle hits really get: the BSP has two, brute force one.
pub(super) fn effective_precision(backend: Backend, requested: Precision) -> Precision {
    match (backend, requested) {
        (Backend::Embree, _) | (Backend::Bsp, Precision::Fast) => requested,
        (Backend::Bsp | Backend::Brute, _) => Precision::Watertight,
    }
}

/// Returns an error if flags for Embree alone are given with another backend.
pub(super) fn check_backend(args: &TracingArgs, backend: Backend) -> Result<(), Failure> {
    let of_embree = [
        ("--isa", args.isa.is_some()),
        ("--instancing", args.instancing != Instancing::Auto),
        ("--build-quality", args.build_quality != BuildQuality::default()),
        ("--compact", args.compact),
    ];
    match of_embree.iter().find(|(_, is_given)| *is_given) {
        Some((flag, _)) if backend != Backend::Embree => Err(Failure::Input(format!(
            "`{flag}` applies to Embree only: leave it out with `--backend {backend}`"
        ))),
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
