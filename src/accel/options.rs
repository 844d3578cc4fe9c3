//! Settings for building and traversing an acceleration structure.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::mesh_cache::MeshCache;
use super::quality::BuildQuality;
use super::ray_forecast::RayForecast;

/// Backend that intersects rays with the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// The system's Embree library.
    Embree,
    /// A bounding volume hierarchy in Rust, which groups of rays with a common origin traverse together.
    Native,
    /// The sooner of `embree` and `native` for each kind of ray, by a forecast.
    Auto,
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
            Backend::Native => "native",
            Backend::Auto => "auto",
            Backend::Bsp => "bsp",
            Backend::Brute => "brute",
        })
    }
}

/// Guarantee for rays that pass close to the edges and vertices of triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
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
///
/// Construct it with `..AccelOptions::default()`: further fields may be added.
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
    /// Expected rays, on which the choice of [`Backend::Auto`] depends.
    pub rays: RayForecast,
    /// Number of build threads; 0 means one per processor.
    pub threads: usize,
    /// Instruction set that Embree and the kernels of the other backends are restricted to (`sse2`, `sse4.2`, `avx`,
    /// `avx2`, `avx512`); the best of this machine if absent. Below AVX2 whit's own kernels, those of its callbacks in
    /// Embree included, take their portable form.
    pub isa: Option<String>,
    /// Cache of per-mesh build results, for a scene that is one of several.
    pub mesh_cache: Option<&'a MeshCache>,
    /// Callback that receives the finished fraction during the build, from any thread.
    pub progress: Option<&'a (dyn Fn(f64) + Sync)>,
}
