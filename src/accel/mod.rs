//! Ray-scene intersection for packets of rays: nearest hit and occlusion, by one of three backends with equal results.
//!
//! * [`embree`]: the system's Embree, with shapes and instances as user geometry.
//! * [`bsp`]: an axis-aligned BSP tree, in Rust.
//! * [`brute`]: a loop over every primitive, the reference for tests.
//!
//! [`extents`] are the bounding volumes that a ray is tested against before an object.
//!
//! Ties go to the smallest `t`, then the lowest instance, then the lowest primitive, also between coincident triangles.
//! There is one exception: where a ray hits two different native triangles of Embree at the same `t`, at a shared edge
//! or where they partly overlap in one plane, Embree decides. [`hit_compare`] counts such results as ties, not as
//! wrong.

pub mod brute;
pub mod bsp;
#[cfg(feature = "embree")]
mod clusters;
#[cfg(feature = "embree")]
pub mod embree;
pub mod extents;
pub mod hit_compare;
mod mesh_cache;
mod packet;
mod planes;
mod quality;
mod scene_stats;
mod shape_query;

use std::fmt;

use serde::{Deserialize, Serialize};

#[cfg(feature = "embree")]
#[doc(hidden)]
pub use clusters::cluster_count;
pub use mesh_cache::{MeshCache, MeshCounts};
pub use packet::{ACTIVE, Hit, LANES, NO_HIT, RayPacket};
pub use quality::BuildQuality;
pub use scene_stats::PrimitiveCounts;

use crate::scene::Scene;

/// Nearest-hit and occlusion queries for a batch of 16-lane packets against one built scene.
///
/// Queries take a batch so that a backend may interleave many rays: memory latency is the limit on large meshes. Lanes
/// whose ray is not traceable (see [`RayPacket::drop_untraceable`]) are deactivated, never traced.
pub trait Accel: Send + Sync {
    /// Finds the nearest hit of every active lane within its interval.
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence);

    /// Marks every active lane as blocked whose ray hits anything within its interval.
    fn occluded(&self, packets: &mut [RayPacket], order: Coherence);

    /// Returns statistics of the structure that was built.
    fn report(&self) -> AccelReport;
}

/// Coherence hint for the rays of a packet. It changes the speed, never the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coherence {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Rays without spatial coherence, for example after a bounce.
    Incoherent,
}

/// Backend that intersects rays with the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// The system's Embree library.
    Embree,
    /// An axis-aligned BSP tree, in Rust.
    Bsp,
    /// A loop over every primitive: slow, the reference for tests.
    Brute,
}

impl Default for Backend {
    /// Returns Embree if it was compiled in, else the BSP.
    fn default() -> Backend {
        if cfg!(feature = "embree") {
            Backend::Embree
        } else {
            Backend::Bsp
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Backend::Embree => "embree",
            Backend::Bsp => "bsp",
            Backend::Brute => "brute",
        })
    }
}

/// Guarantee for rays that pass close to the edges and vertices of triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Rays may slip through edges; the BSP decides about triangles in f32 alone.
    Fast,
    /// Edges are closed; rays aimed exactly at a vertex may slip through.
    Robust,
    /// Nothing slips through. Brute force always is watertight, and the BSP unless it is [`Precision::Fast`].
    #[default]
    Watertight,
}

impl Precision {
    /// All levels, in order of increasing guarantee.
    pub const ALL: [Precision; 3] = [Precision::Fast, Precision::Robust, Precision::Watertight];
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Precision::Fast => "fast",
            Precision::Robust => "robust",
            Precision::Watertight => "watertight",
        })
    }
}

/// Method by which Embree intersects meshes whose instance has a transform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Instancing {
    /// The faster of the two that gives the requested precision.
    #[default]
    Auto,
    /// As user geometry, whose callbacks transform the rays into object space in f64.
    Callback,
    /// As Embree's own instances, which transform rays by an f32 inverse: a mesh is hit as if it stood some roundings
    /// of its coordinates aside, and between instances at the same `t` Embree decides.
    Native,
}

impl Instancing {
    /// Returns the method used at a precision: [`Instancing::Callback`] or [`Instancing::Native`]. Watertight meshes
    /// always use callbacks, as the boxes that Embree puts around its own instances are not rounded outward.
    pub fn resolved(self, precision: Precision) -> Instancing {
        match (self, precision) {
            (Instancing::Auto, Precision::Fast) => Instancing::Native,
            (Instancing::Auto, Precision::Robust) | (_, Precision::Watertight) => Instancing::Callback,
            (chosen, _) => chosen,
        }
    }

    /// Returns the method that `self` is not, out of callback and native.
    pub fn other(self) -> Instancing {
        match self {
            Instancing::Native => Instancing::Callback,
            Instancing::Auto | Instancing::Callback => Instancing::Native,
        }
    }
}

impl fmt::Display for Instancing {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Instancing::Auto => "auto",
            Instancing::Callback => "callback",
            Instancing::Native => "native",
        })
    }
}

/// Number of rays that a backend handles at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// As many rays as is fastest.
    #[default]
    Packet,
    /// Single rays, the baseline that packets are measured against.
    Single,
}

/// Settings for building and traversing an acceleration structure.
#[derive(Clone, Default)]
pub struct AccelOptions<'a> {
    /// Guarantee for rays near edges and vertices.
    pub precision: Precision,
    /// Packets or single rays.
    pub kernel: Kernel,
    /// Method for instanced meshes in Embree; ignored by the other backends.
    pub instancing: Instancing,
    /// Build quality of Embree's trees; ignored by the other backends.
    pub build_quality: BuildQuality,
    /// Flag that makes Embree save memory rather than time; ignored by the other backends.
    pub compact: bool,
    /// Number of build threads; 0 means one per processor.
    pub threads: usize,
    /// Instruction set that Embree is restricted to (`sse2`, `sse4.2`, `avx`, `avx2`, `avx512`); Embree's own choice if
    /// absent.
    pub isa: Option<String>,
    /// Cache of per-mesh build results, for a scene that is one of several.
    pub mesh_cache: Option<&'a MeshCache>,
    /// Callback that receives the finished fraction during the build, from any thread.
    pub progress: Option<&'a (dyn Fn(f64) + Sync)>,
}

/// Statistics of a built acceleration structure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AccelReport {
    /// Bytes in use after the build, without vertex and index arrays shared with the scene.
    pub bytes: u64,
    /// Peak bytes in use at any time of the build.
    pub peak_bytes: u64,
    /// Version and instruction set, if the backend is Embree.
    pub embree: Option<EmbreeIdentity>,
    /// One line for people: kind and size of the structure.
    pub summary: String,
    /// Breakdown of `bytes` by use; the sizes add up to it.
    pub parts: Vec<AccelPart>,
}

/// A part of an acceleration structure, with its memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccelPart {
    /// Memory category: `triangles` or `user-geometry` (shapes and instanced meshes) if the part serves one of them
    /// alone, `tree` if both; `extents` for bounding volumes tested before objects.
    pub holder: &'static str,
    /// Human-readable label of the part.
    pub what: &'static str,
    /// Size of the part in bytes.
    pub bytes: u64,
}

/// Returns the memory category of a tree over this many triangles and this many objects tested as a whole.
pub(crate) fn holder_of_tree(triangle_count: usize, object_count: usize) -> &'static str {
    match (triangle_count, object_count) {
        (_, 0) => "triangles",
        (0, _) => "user-geometry",
        _ => "tree",
    }
}

/// Version and instruction set of an Embree device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmbreeIdentity {
    /// Version number, for example `3.13.5`.
    pub version: String,
    /// Instruction set, for example `avx2`.
    pub isa: String,
}

/// Returns the Embree that would be used when restricted to an instruction set; `None` for another backend.
///
/// # Errors
/// If Embree does not start, or was not compiled in.
pub fn identity(backend: Backend, isa: Option<&str>) -> Result<Option<EmbreeIdentity>, AccelError> {
    if backend != Backend::Embree {
        return Ok(None);
    }
    #[cfg(feature = "embree")]
    return embree::identity(isa).map(Some);
    #[cfg(not(feature = "embree"))]
    {
        let _ = isa;
        Err(AccelError::NoEmbree)
    }
}

/// Reason for which an acceleration structure could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AccelError {
    /// The program was compiled without Embree.
    #[error(
        "this whit was built without Embree: use `--backend bsp`, or build whit with the feature `embree`"
    )]
    NoEmbree,
    /// An Embree call failed.
    #[error("Embree could not {action}: {message}")]
    Embree {
        /// Operation that was attempted.
        action: &'static str,
        /// Error message from Embree.
        message: String,
    },
    /// There is not enough memory.
    #[error("not enough memory for the acceleration structure: use a smaller scene or `--backend bsp`")]
    OutOfMemory,
    /// The running library is not the version that the headers described.
    #[error("whit was built against Embree {built} but runs with {running}: rebuild whit on this machine")]
    VersionMismatch {
        /// Version of the headers at compile time.
        built: String,
        /// Version of the running library.
        running: String,
    },
}

/// Builds the acceleration structure of a validated scene.
pub fn build<'s>(
    scene: &'s Scene,
    backend: Backend,
    options: &AccelOptions,
) -> Result<Box<dyn Accel + 's>, AccelError> {
    match backend {
        #[cfg(feature = "embree")]
        Backend::Embree => Ok(Box::new(embree::EmbreeAccel::build(scene, options)?)),
        #[cfg(not(feature = "embree"))]
        Backend::Embree => Err(AccelError::NoEmbree),
        Backend::Bsp => Ok(Box::new(bsp::BspAccel::build(scene, options)?)),
        Backend::Brute => Ok(Box::new(brute::BruteAccel::new(scene))),
    }
}
