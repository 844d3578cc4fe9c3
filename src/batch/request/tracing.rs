//! Ray tracing options of a request: the path by which hits are found, and threads.

use std::thread;

use super::error::RequestError;
use crate::accel::{AccelOptions, Backend, BuildQuality, Instancing, Precision, RayForecast};
use crate::render::{RenderSettings, forecast_rays};
use crate::scene::ValidScene;

/// Intersection backend with the options of its acceleration structure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct HitPath {
    /// Intersection backend that finds the hits.
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

    /// Returns the options for building an acceleration structure, on the default number of threads.
    pub fn options(&self) -> AccelOptions<'static> {
        AccelOptions {
            precision: self.precision,
            instancing: self.instancing,
            build_quality: self.build_quality,
            compact: self.compact,
            ..AccelOptions::default()
        }
    }

    /// Returns the options for building the acceleration structure of an image, on the default number of threads.
    pub fn options_for(&self, scene: ValidScene, settings: &RenderSettings) -> AccelOptions<'static> {
        let rays = match self.backend {
            Backend::Auto => forecast_rays(scene, settings),
            _ => RayForecast::default(),
        };
        AccelOptions {
            rays,
            ..self.options()
        }
    }

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
    /// Requested path of hits, whose options some backends do not have: see [`TracingOptions::path`].
    pub requested: HitPath,
    /// Instruction set that Embree is limited to; the best one if absent.
    pub isa: Option<String>,
    /// Number of threads, at least 1.
    pub threads: usize,
}

impl TracingOptions {
    /// Returns the default options with `threads` threads; 0 takes one per processor.
    pub fn of_threads(threads: u32) -> TracingOptions {
        TracingOptions {
            requested: HitPath::default(),
            isa: None,
            threads: match threads {
                0 => thread::available_parallelism().map_or(1, usize::from),
                n => n as usize,
            },
        }
    }

    /// Returns the options for building the acceleration structure of an image.
    pub fn options_for(&self, scene: ValidScene, settings: &RenderSettings) -> AccelOptions<'static> {
        AccelOptions {
            threads: self.threads,
            isa: self.isa.clone(),
            ..self.requested.options_for(scene, settings)
        }
    }

    /// Returns the options for building an acceleration structure.
    pub fn options(&self) -> AccelOptions<'static> {
        AccelOptions {
            threads: self.threads,
            isa: self.isa.clone(),
            ..self.requested.options()
        }
    }

    /// Returns the path by which hits are found, without options that the backend does not have.
    pub fn path(&self) -> HitPath {
        match self.requested.backend {
            Backend::Embree | Backend::Auto => self.requested,
            // The others have no instancing and no build options
            backend @ (Backend::Native | Backend::Bsp | Backend::Brute) => HitPath {
                backend,
                precision: effective_precision(backend, self.requested.precision),
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
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.threads).build();
        pool.map_err(|error| RequestError::Threads(self.threads, error))
    }
}

/// Returns the precision that triangle hits really get: the BSP has two, the others have one.
fn effective_precision(backend: Backend, requested: Precision) -> Precision {
    match (backend, requested) {
        (Backend::Embree | Backend::Auto, _) | (Backend::Bsp, Precision::Fast) => requested,
        (Backend::Native | Backend::Bsp | Backend::Brute, _) => Precision::Watertight,
    }
}
