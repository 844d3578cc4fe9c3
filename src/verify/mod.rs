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

mod backend_comparison;
mod box_slabs;
mod coincident;
mod cross_check;
mod degenerate;
mod determinism;
mod expansion;
mod false_hits;
mod feature;
mod figure_data;
mod fresnel;
mod furnace;
mod instance_seams;
mod invalid_rays;
mod invariance;
mod leaks;
mod mesh_diagnostics;
mod nan_injection;
mod nested_dielectrics;
mod ray_continuation;
mod ray_marching;
mod rays_file;
mod reference;
mod regressions;
mod runner;
mod self_intersection;
mod self_intersection_instanced;
mod slivers;
mod solids;
mod spheres;
mod split_planes;
mod summation;
mod terminator;
mod test_meshes;
mod test_scenes;
mod thin_ellipsoids;
mod transforms;
mod variant;
mod verdict_cache;
mod watertight;
mod wireframe;

use std::time::Instant;

use serde::Serialize;

pub use cross_check::{Comparison, Difference, MAX_DIFFERENCES, QueryResult, RayKind, cross_check, retrace};
pub use feature::MeshFeature;
pub use figure_data::{Axis, CloseUp, Error, FigureData, TracedRay};
pub use mesh_diagnostics::MeshDiagnostics;
pub use rays_file::{RaysError, RaysFile, bits};
pub use runner::{Build, Correctness, Counts, Formulas, Render, SystemUnderTest, describe, describe_ray};
pub use variant::{BackendVariant, VARIANTS, Watertightness};
pub use verdict_cache::VerdictCache;
pub use wireframe::{Wireframe, view};

use crate::accel::{self, Accel, AccelError, AccelOptions, Backend, EmbreeIdentity};
use crate::scene::Scene;
use runner::CaseRunner;

/// Kind of code that a case tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CaseKind {
    /// Triangle intersection, on every variant that finds hits.
    Triangles,
    /// Intersection of analytic shapes, on every variant that finds hits.
    Shapes,
    /// Formulas that need no scene.
    Formulas,
}

/// Numerically hard test case with its oracle and error bound.
#[derive(Clone, Copy, Serialize)]
pub struct Case {
    /// Identifier of the case: `H` and two digits.
    pub id: &'static str,
    /// Name of the case in reports.
    pub title: &'static str,
    /// Description of the rays or arguments that the case generates.
    pub construction: &'static str,
    /// Description of the oracle that yields the expected results.
    pub oracle: &'static str,
    /// Largest admissible error of a result, in words.
    pub bound: &'static str,
    /// Unit of the largest error; empty if the case measures none.
    pub unit: &'static str,
    /// Kind of code that the case tests.
    #[serde(rename = "asks")]
    pub kind: CaseKind,
    /// Least watertightness from which on a variant must return nothing wrong.
    pub required: Watertightness,
    #[serde(skip)]
    run: fn(&CaseRunner) -> Result<Counts, AccelError>,
}

/// Verdict on a case on one variant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Verdict for a case without wrong results.
    Holds,
    /// Wrong results on a variant that does not guarantee better.
    Measured,
    /// Wrong results on a variant that must not have any.
    Fails,
}

/// Result of a case on one variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Counts of rays, wrong results and ties.
    #[serde(flatten)]
    pub tally: Counts,
    /// Verdict that follows from the counts.
    pub verdict: Verdict,
    /// Flag for a variant that must return nothing wrong.
    pub required: bool,
    /// Version and instruction set of Embree, if the variant uses it.
    pub embree: Option<EmbreeIdentity>,
    /// Run time in seconds, including ray generation and the oracle.
    pub seconds: f64,
}

/// Returns all cases, sorted by identifier.
pub fn cases() -> Vec<&'static Case> {
    // Collect the cases of all modules
    let rooms = [
        spheres::CASES,
        solids::CASES,
        box_slabs::CASES,
        watertight::CASES,
        invalid_rays::CASES,
        slivers::CASES,
        self_intersection::CASES,
        self_intersection_instanced::CASES,
        transforms::CASES,
        coincident::CASES,
        split_planes::CASES,
        fresnel::CASES,
        summation::CASES,
        ray_marching::CASES,
        determinism::CASES,
        thin_ellipsoids::CASES,
        regressions::CASES,
        leaks::CASES,
        false_hits::CASES,
        ray_continuation::CASES,
        degenerate::CASES,
        nan_injection::CASES,
        backend_comparison::CASES,
        invariance::CASES,
        nested_dielectrics::CASES,
        furnace::CASES,
        terminator::CASES,
        instance_seams::CASES,
    ];
    // Sort them by identifier
    let mut all: Vec<&Case> = rooms.into_iter().flatten().collect();
    all.sort_by_key(|case| case.id);
    all
}

impl Case {
    /// Returns whether the case can run on `variant`.
    pub fn applies_to(&self, path: &BackendVariant) -> bool {
        (self.kind == CaseKind::Formulas) == path.accel.is_none()
    }

    /// Returns whether the case must have no wrong results on `variant`.
    pub fn requires(&self, path: &BackendVariant) -> bool {
        path.closes >= self.required
    }

    /// Runs the case on `subject` with about `rays` queries.
    ///
    /// # Errors
    ///
    /// Fails if an acceleration structure cannot be built.
    pub fn run_case(&self, rays: u64, subject: &SystemUnderTest) -> Result<Counts, AccelError> {
        (self.run)(&CaseRunner::new(self.id, rays.max(1), subject))
    }

    /// Runs the case as [`Case::run_case`] does, and adds line drawings of the scenes to [`Counts::figure_data`].
    fn run_case_with_drawings(&self, rays: u64, subject: &SystemUnderTest) -> Result<Counts, AccelError> {
        (self.run)(&CaseRunner::new(self.id, rays.max(1), subject).with_drawings())
    }
}

/// Runs a case on one backend variant with about `rays` queries; restricts Embree to the instruction set `isa` if one
/// is given. `verdict_cache` may be shared by all variants that run the case with the same number of rays.
///
/// # Errors
///
/// Fails if the structure cannot be built: without Embree, or on a machine without the instruction set.
pub fn check(
    (case, rays): (&Case, u64),
    path: &BackendVariant,
    isa: Option<&str>,
    verdict_cache: &VerdictCache,
) -> Result<Outcome, AccelError> {
    outcome(case, path, (isa, verdict_cache), |subject| {
        case.run_case(rays, subject)
    })
}

/// Runs a case as [`check`] does, and adds line drawings of the scenes to [`Counts::figure_data`].
///
/// # Errors
///
/// Fails if the structure cannot be built, as [`check`] does.
pub fn check_with_drawings(
    (case, rays): (&Case, u64),
    path: &BackendVariant,
    isa: Option<&str>,
    verdict_cache: &VerdictCache,
) -> Result<Outcome, AccelError> {
    outcome(case, path, (isa, verdict_cache), |subject| {
        case.run_case_with_drawings(rays, subject)
    })
}

fn outcome(
    case: &Case,
    path: &BackendVariant,
    (isa, verdict_cache): (Option<&str>, &VerdictCache),
    run_case: impl FnOnce(&SystemUnderTest) -> Result<Counts, AccelError>,
) -> Result<Outcome, AccelError> {
    // Set up the system under test
    let build: &Build = &|scene| build_variant(scene, path, isa);
    let subject = SystemUnderTest {
        build,
        formulas: Formulas::RENDERER,
        verdict_cache,
    };
    let embree = if path.is_embree() {
        runner::embree_identity(&subject)?
    } else {
        None
    };
    // Run the case and measure its time
    let start = Instant::now();
    let tally = run_case(&subject)?;
    let seconds = start.elapsed().as_secs_f64();
    // Derive the verdict
    let required = case.requires(path);
    let verdict = match (tally.wrong, required) {
        (0, _) => Verdict::Holds,
        (_, true) => Verdict::Fails,
        (_, false) => Verdict::Measured,
    };
    Ok(Outcome {
        tally,
        verdict,
        required,
        embree,
        seconds,
    })
}

/// Returns whether Embree can be restricted to the instruction set `isa` on this machine.
pub fn has_instruction_set(isa: &str) -> bool {
    let options = AccelOptions {
        isa: Some(isa.to_owned()),
        ..AccelOptions::default()
    };
    let scene = Scene::default();
    let built = accel::build(&scene, Backend::Embree, &options);
    // Embree silently falls back to what the machine has, so compare the instruction set that it reports.
    built.is_ok_and(|accel| accel.report().embree.is_some_and(|embree| embree.isa == isa))
}

/// Builds the acceleration structure of a variant over `scene`; brute force for the variant without one. Restricts
/// Embree to the instruction set `isa` if one is given.
///
/// # Errors
///
/// Fails if the structure cannot be built: without Embree, or on a machine without the instruction set.
pub fn build_variant<'s>(
    scene: &'s Scene,
    path: &BackendVariant,
    isa: Option<&str>,
) -> Result<Box<dyn Accel + 's>, AccelError> {
    let Some((backend, precision, kernel)) = path.accel else {
        return accel::build(scene, Backend::Brute, &AccelOptions::default());
    };
    let options = AccelOptions {
        precision,
        kernel,
        isa: isa.filter(|_| path.is_embree()).map(str::to_owned),
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
    fn every_case_has_unique_id_and_descriptions() {
        let all = cases();
        for pair in all.windows(2) {
            assert!(pair[0].id < pair[1].id, "{}", pair[1].id);
        }
        for case in all {
            for text in [case.title, case.construction, case.oracle, case.bound] {
                assert!(!text.is_empty() && !text.ends_with('.'), "{}: {text}", case.id);
            }
            assert!(
                VARIANTS
                    .iter()
                    .any(|path| case.applies_to(path) && case.requires(path))
            );
        }
    }

    #[test]
    fn variants_are_ordered_by_watertightness() {
        assert!(
            Watertightness::Faces < Watertightness::Edges && Watertightness::Edges < Watertightness::Vertices
        );
        assert!(VARIANTS.windows(2).all(|pair| pair[0].closes <= pair[1].closes));
    }
}
