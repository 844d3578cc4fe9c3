//! Finding hits: two questions, asked of packets, with three answers that must agree.
//!
//! * [`embree`]: the system's Embree, with shapes and instances as user geometry.
//! * [`bsp`]: an axis-aligned BSP tree of our own.
//! * [`brute`]: a loop over everything, the referee.
//!
//! [`extents`] are what a ray is tested against before an object.
//!
//! Ties go to the smallest `t`, then the lowest instance, then the lowest primitive, also between triangles that
//! coincide. Only between two different triangles of its own that a ray meets at the same `t`, at a shared edge or
//! where they overlap in part in one plane, Embree decides, and [`hit_compare`] counts such answers as ties, not as
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

/// Nearest hit and any hit for a batch of 16-lane packets against one built scene.
///
/// A batch, so that a backend may interleave many rays: memory latency is the limit on large meshes. Lanes that no
/// backend may be asked about are switched off, never traced.
pub trait Accel: Send + Sync {
    /// Finds the nearest hit of every active lane within its interval.
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder);

    /// Marks every active lane blocked that meets anything within its interval.
    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder);

    /// What was built.
    fn report(&self) -> AccelReport;
}

/// Whether the lanes of a packet run side by side. A hint: it changes the speed, never the answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayOrder {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Anything else.
    Incoherent,
}

/// Which backend finds the hits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// The system's Embree.
    Embree,
    /// Our own axis-aligned BSP tree, in Rust.
    Bsp,
    /// A loop over every primitive: slow, the referee.
    Brute,
}

impl Default for Backend {
    /// Embree where it was built in, else the BSP.
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

/// How much a triangle hit may be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Rays may slip through edges; of the BSP, f32 alone decides about triangles.
    Fast,
    /// Edges are closed; rays aimed exactly at a vertex may slip through.
    Robust,
    /// Nothing slips through. Brute force always is, and the BSP unless it is [`Precision::Fast`].
    #[default]
    Watertight,
}

impl Precision {
    /// All, the one that may be trusted least first.
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

/// How Embree is given the meshes that stand elsewhere than in their own space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Instancing {
    /// The faster of the two that gives the precision asked for.
    #[default]
    Auto,
    /// As user geometry, whose callbacks carry the rays into object space in f64.
    Callback,
    /// As Embree's own instances, which carry rays by an f32 inverse: a mesh is met as if it stood some roundings of
    /// its coordinates aside, and between instances at the same `t` Embree decides.
    Native,
}

impl Instancing {
    /// [`Instancing::Callback`] or [`Instancing::Native`]: what it means at a precision. Watertight meshes are placed by
    /// callbacks whatever is wished, as the boxes that Embree puts around its own instances are not rounded outward.
    pub fn resolved(self, precision: Precision) -> Instancing {
        match (self, precision) {
            (Instancing::Auto, Precision::Fast) => Instancing::Native,
            (Instancing::Auto, Precision::Robust) | (_, Precision::Watertight) => Instancing::Callback,
            (chosen, _) => chosen,
        }
    }

    /// Of the two, the one that is not `self`.
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

/// How many rays a backend handles at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// As many as pays.
    #[default]
    Packet,
    /// One by one: what packets are measured against.
    Single,
}

/// How an acceleration structure is built and asked.
#[derive(Clone, Default)]
pub struct AccelOptions<'a> {
    /// How much a triangle hit may be trusted.
    pub precision: Precision,
    /// Packets or single rays.
    pub kernel: Kernel,
    /// How Embree is given placed meshes; nothing to the other backends.
    pub instancing: Instancing,
    /// How much work Embree puts into its trees; nothing to the other backends.
    pub build_quality: BuildQuality,
    /// Whether Embree is to save memory rather than time; nothing to the other backends.
    pub compact: bool,
    /// Threads that build; 0 takes one a processor.
    pub threads: usize,
    /// Instruction set that Embree is held to (`sse2`, `sse4.2`, `avx`, `avx2`, `avx512`); its own choice if absent.
    pub isa: Option<String>,
    /// What need not be built again, where a scene is one of several.
    pub mesh_cache: Option<&'a MeshCache>,
    /// Told the finished fraction while building, from any thread.
    pub progress: Option<&'a (dyn Fn(f64) + Sync)>,
}

/// What was built, for statistics.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AccelReport {
    /// Bytes in use after the build, vertex and index arrays that are shared with the scene not counted.
    pub bytes: u64,
    /// Most bytes in use at any time of the build.
    pub peak_bytes: u64,
    /// Version and instruction set, where the backend is Embree.
    pub embree: Option<EmbreeIdentity>,
    /// One line a person may read: what kind of structure, how large.
    pub summary: String,
    /// What `bytes` are for; they add up to it.
    pub parts: Vec<AccelPart>,
}

/// A part of an acceleration structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccelPart {
    /// `triangles` or `user-geometry` (shapes and placed meshes) if it serves one of them alone, `tree` if both;
    /// `extents` for what is asked before objects.
    pub holder: &'static str,
    /// What it is.
    pub what: &'static str,
    /// Its size.
    pub bytes: u64,
}

/// The holder of a tree over this many triangles and this many objects that are asked as a whole.
pub(crate) fn holder_of_tree(triangle_count: usize, object_count: usize) -> &'static str {
    match (triangle_count, object_count) {
        (_, 0) => "triangles",
        (0, _) => "user-geometry",
        _ => "tree",
    }
}

/// Which Embree answered.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmbreeIdentity {
    /// For example `3.13.5`.
    pub version: String,
    /// For example `avx2`.
    pub isa: String,
}

/// Which Embree would find the hits, held to an instruction set; nothing where another backend does.
///
/// # Errors
/// Where Embree does not start, or the program has none.
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

/// Why an acceleration structure could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AccelError {
    /// The program has no Embree in it.
    #[error("this whit was built without Embree: use `--backend bsp`, or build it with the feature `embree`")]
    NoEmbree,
    /// Embree refused.
    #[error("Embree could not {action}: {message}")]
    Embree {
        /// What was attempted.
        action: &'static str,
        /// What Embree said.
        message: String,
    },
    /// There is not enough memory.
    #[error("not enough memory for the acceleration structure: use a smaller scene or `--backend bsp`")]
    OutOfMemory,
    /// The running library is not the one that the headers described.
    #[error("whit was built against Embree {built} but runs with {running}: build it again on this machine")]
    VersionMismatch {
        /// The headers' version.
        built: String,
        /// The library's version.
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
