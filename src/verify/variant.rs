//! Table of the backend variants that cases run on.

use serde::Serialize;

use crate::accel::{Backend, Kernel, Precision};

/// Watertightness that a backend variant guarantees for triangle meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Watertightness {
    /// Only the interior of triangles is tight: rays may slip through along shared edges.
    Faces,
    /// Edges are tight too: rays may slip through where several triangles share a vertex.
    Edges,
    /// Faces, edges and vertices of a closed mesh are tight.
    Vertices,
}

/// Backend configuration under test, or the formulas without a backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct BackendVariant {
    /// Name of the variant in tables.
    pub name: &'static str,
    /// Backend, precision and kernel; `None` for formulas, which need no scene.
    #[serde(skip)]
    pub accel: Option<(Backend, Precision, Kernel)>,
    /// Watertightness that the variant guarantees for triangles. Analytic shapes use the same f64 functions on every
    /// variant, as Embree's user geometry or in leaves of the BSP.
    pub closes: Watertightness,
}

/// All variants, sorted by ascending guarantee.
pub const VARIANTS: &[BackendVariant] = &[
    // Embree with its own fast, then robust triangle test
    BackendVariant {
        name: "embree fast",
        accel: Some((Backend::Embree, Precision::Fast, Kernel::Packet)),
        closes: Watertightness::Faces,
    },
    BackendVariant {
        name: "embree robust",
        accel: Some((Backend::Embree, Precision::Robust, Kernel::Packet)),
        closes: Watertightness::Edges,
    },
    BackendVariant {
        name: "embree single",
        accel: Some((Backend::Embree, Precision::Robust, Kernel::Single)),
        closes: Watertightness::Edges,
    },
    // Embree with watertight clusters
    BackendVariant {
        name: "embree watertight",
        accel: Some((Backend::Embree, Precision::Watertight, Kernel::Packet)),
        closes: Watertightness::Vertices,
    },
    // BSP with watertight triangle test
    BackendVariant {
        name: "bsp",
        accel: Some((Backend::Bsp, Precision::Watertight, Kernel::Packet)),
        closes: Watertightness::Vertices,
    },
    BackendVariant {
        name: "bsp single",
        accel: Some((Backend::Bsp, Precision::Watertight, Kernel::Single)),
        closes: Watertightness::Vertices,
    },
    // No backend: functions of the renderer alone
    BackendVariant {
        name: "formulas",
        accel: None,
        closes: Watertightness::Vertices,
    },
];

impl BackendVariant {
    /// Returns whether the variant uses Embree.
    pub fn is_embree(&self) -> bool {
        matches!(self.accel, Some((Backend::Embree, ..)))
    }

    /// Returns whether this build contains the variant: without the feature `embree` some are missing.
    pub fn is_built_in(&self) -> bool {
        cfg!(feature = "embree") || !self.is_embree()
    }
}
