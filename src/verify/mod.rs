//! Numerically hard intersection cases with exact oracles, run on every backend variant.
//!
//! A [`Case`] constructs rays, or arguments of a formula, for which rounding decides the result: on edges and corners,
//! at tangents, at the critical angle. Its oracle returns the exact result: by exact sums of floats where a decision is
//! the sign of a polynomial, by 106-bit numbers elsewhere, or by a closed surface around the origin of a ray. Results
//! that differ from the oracle are sorted into wrong results, where the exact result is farther from a flip than the
//! rounding error bound explains, and ties, where it is not. Only wrong results count, and only on the variants that
//! guarantee better; on the others they are measured.
//!
//! No exact results are known beforehand for a scene's own rays: [`cross_check`] traces them through two structures and
//! sorts the differences, and [`MeshDiagnostics`] reports the defects of a mesh before any ray is traced.
//!
//! Each case can fail: the tests replace a formula or structure of the renderer by a careless one and check that the
//! case detects it.

mod cases;
mod harness;
mod scene_check;

pub use cases::cases;
pub use harness::{
    BackendVariant, Build, Case, CaseKind, CloseUp, Correctness, Counts, Error, FigureAxis, FigureData,
    Formulas, Outcome, QueryResult, Recording, Render, SystemUnderTest, TracedRay, VARIANTS, Verdict,
    VerdictCache, Watertightness, Wireframe, build_variant, check, describe, describe_ray,
    has_instruction_set, view,
};
pub(crate) use scene_check::compare_shadow;
pub use scene_check::{
    BackendComparison, Difference, MAX_DIFFERENCES, MeshDiagnostics, MeshFeature, RayKind, RaysError,
    RaysFile, RaysOfPair, bits, cross_check, retrace,
};
