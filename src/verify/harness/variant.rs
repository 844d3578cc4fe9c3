//! Table of the backend variants that cases run on.

use serde::Serialize;

use crate::accel::{self, Accel, AccelError, AccelOptions, Backend, Kernel, Precision};
use crate::scene::{Scene, ValidScene};

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
    // Groups of rays
    BackendVariant {
        name: "native",
        accel: Some((Backend::Native, Precision::Watertight, Kernel::Packet)),
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

/// Returns whether Embree can be restricted to the instruction set `isa` on this machine.
pub fn has_instruction_set(isa: &str) -> bool {
    let options = AccelOptions {
        isa: Some(isa.to_owned()),
        ..AccelOptions::default()
    };
    let scene = Scene::default();
    let built = accel::build(ValidScene::assume(&scene), Backend::Embree, &options);
    // Embree silently falls back to what the machine has, so compare the instruction set that it reports.
    built.is_ok_and(|accel| accel.report().embree.is_some_and(|embree| embree.isa == isa))
}

/// Builds the acceleration structure of a variant over `scene`; brute force for the variant without one. Restricts
/// its kernels to the instruction set `isa` if one is given.
///
/// # Errors
///
/// Fails if the structure cannot be built: without Embree, or on a machine without the instruction set.
pub fn build_variant<'s>(
    scene: &'s Scene,
    path: &BackendVariant,
    isa: Option<&str>,
) -> Result<Box<dyn Accel + 's>, AccelError> {
    // Cases check their scenes themselves
    let scene = ValidScene::assume(scene);
    let Some((backend, precision, kernel)) = path.accel else {
        return accel::build(scene, Backend::Brute, &AccelOptions::default());
    };
    let options = AccelOptions {
        precision,
        kernel,
        isa: isa.map(str::to_owned),
        // Use the threads of the pool that this runs in.
        threads: rayon::current_num_threads(),
        ..AccelOptions::default()
    };
    accel::build(scene, backend, &options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_are_ordered_by_watertightness() {
        assert!(
            Watertightness::Faces < Watertightness::Edges && Watertightness::Edges < Watertightness::Vertices
        );
        assert!(VARIANTS.windows(2).all(|pair| pair[0].closes <= pair[1].closes));
    }
}
