//! Ray tracing options of a request: the path by which hits are found, and threads.

use std::thread;

use super::error::RequestError;
use crate::accel::{AccelOptions, Backend, BuildQuality, Instancing, Precision};

/// Intersection backend with the options of its acceleration structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct HitPath {
    /// Intersection backend: Embree, or the BSP tree.
    pub backend: Backend,
    /// Precision of triangle hits; the BSP has fast (f32) and is exact otherwise.
    pub precision: Precision,
    /// Representation of instanced meshes in Embree.
    pub instancing: Instancing,
    /// Build quality of Embree's BVHs.
    pub build_quality: BuildQuality,
    /// Compact mode, which saves memory rather than time.
    pub compact: bool,
}

impl HitPath {
    /// BSP that computes every hit in f64.
    pub const BSP: HitPath = HitPath {
        backend: Backend::Bsp,
        precision: Precision::Watertight,
        instancing: Instancing::Auto,
        build_quality: BuildQuality::Medium,
        compact: false,
    };

    /// Returns the path's name in reports.
    pub fn name(&self) -> String {
        match (self.backend, self.precision) {
            (Backend::Embree, precision) => precision.to_string(),
            (Backend::Bsp, Precision::Fast) => "bsp f32".to_owned(),
            (backend, _) => backend.to_string(),
        }
    }
}

/// Ray tracing options for any backend.
#[derive(Clone, Debug, PartialEq)]
pub struct TracingOptions {
    /// Precision of triangle hits.
    pub precision: Precision,
    /// Representation of instanced meshes in Embree.
    pub instancing: Instancing,
    /// Build quality of Embree's BVHs.
    pub build_quality: BuildQuality,
    /// Compact mode of Embree, which saves memory.
    pub compact: bool,
    /// Instruction set that Embree is limited to; the best one if absent.
    pub isa: Option<String>,
    /// Number of threads, at least 1.
    pub threads: usize,
}

impl TracingOptions {
    /// Returns the default options with `threads` threads; 0 takes one per processor.
    pub fn of_threads(threads: u32) -> TracingOptions {
        TracingOptions {
            precision: Precision::default(),
            instancing: Instancing::default(),
            build_quality: BuildQuality::default(),
            compact: false,
            isa: None,
            threads: match threads {
                0 => thread::available_parallelism().map_or(1, usize::from),
                n => n as usize,
            },
        }
    }

    /// Returns the options for building an acceleration structure.
    pub fn options(&self) -> AccelOptions<'static> {
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

    /// Returns the hit path from which a study with this backend starts.
    pub fn path(&self, backend: Backend) -> HitPath {
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
    ///
    /// # Errors
    ///
    /// If the system does not have that many threads.
    pub fn pool(&self) -> Result<rayon::ThreadPool, RequestError> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(self.threads)
            .build()
            .map_err(|error| RequestError::Threads {
                threads: self.threads,
                error,
            })
    }
}

/// Returns the precision that triangle hits really get: the BSP has two, brute force one.
pub fn effective_precision(backend: Backend, requested: Precision) -> Precision {
    match (backend, requested) {
        (Backend::Embree, _) | (Backend::Bsp, Precision::Fast) => requested,
        (Backend::Bsp | Backend::Brute, _) => Precision::Watertight,
    }
}
