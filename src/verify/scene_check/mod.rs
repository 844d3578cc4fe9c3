//! Checks of a scene: cross-check of its own rays, and defects of its meshes.

mod cross_check;
mod feature;
mod mesh_diagnostics;
mod rays_file;

pub(crate) use cross_check::compare_shadow;
pub use cross_check::{BackendComparison, Difference, MAX_DIFFERENCES, RayKind, cross_check, retrace};
pub use feature::MeshFeature;
pub use mesh_diagnostics::MeshDiagnostics;
pub use rays_file::{RaysError, RaysFile, RaysOfPair, bits};
