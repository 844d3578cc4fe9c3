//! Numerically hard intersection cases with exact oracles, run on every backend variant.
//!
//! A [`Case`] constructs rays, or arguments of a formula, for which rounding decides the result: on edges and corners,
//! at tangents, at the critical angle. Its oracle returns the exact result: by exact sums of floats where a decision is
//! the sign of a polynomial, by 106-bit numbers elsewhere, or by a closed surface around the origin of a ray. Results
//! that differ from the oracle are sorted into wrong results, where the exact result is farther from a flip than the
//! rounding error bound explains, and ties, where it is not. Only wrong results count, and only on the variants that
//! guarantee better; on the others they are measured.
//!
//! No exact results are known beforehand for a scene's own rays: [`compare_all`] traces them through two structures and
//! sorts the differences, and [`Hygiene`] reports the defects of a mesh before any ray is traced.
//!
//! Each case can fail: the tests replace a formula or structure of the renderer by a careless one and check that the
//! case detects it.

mod backends;
mod boxes;
mod carried;
mod cells;
mod closed;
mod degenerate;
mod exact;
mod false_hits;
mod frames;
mod furnace;
mod holes;
mod hygiene;
mod interfaces;
mod judged;
mod marches;
mod meshes;
mod nested;
mod odd_rays;
mod outline;
mod own;
mod passages;
mod path;
mod place;
mod placed;
mod poison;
mod quadrics;
mod rays_file;
mod referee;
mod regressions;
mod seams;
mod sketch;
mod slivers;
mod solids;
mod spawned;
mod spheres;
mod stacked;
mod sums;
mod terminator;
mod transforms;
mod trial;
mod worlds;

use std::time::Instant;

use serde::Serialize;

pub use hygiene::Hygiene;
pub use judged::Judged;
pub use outline::{Outline, view};
pub use own::{Comparison, Difference, MAX_DIFFERENCES, RayKind, Reply, ask_again, compare_all};
pub use path::{Closes, PATHS, Path};
pub use place::Place;
pub use rays_file::{RaysError, RaysFile, bits};
pub use sketch::{Asked, Axis, CloseUp, Error, Sketch};
pub use trial::{Answer, Build, Formulas, Render, Subject, Tally, describe, describe_ray};

use crate::accel::{self, Accel, AccelError, AccelOptions, Backend, EmbreeIdentity};
use crate::scene::Scene;
use trial::Trial;

/// Kind of code that a case tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Asks {
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
    pub asks: Asks,
    /// Least watertightness from which on a variant must return nothing wrong.
    pub required: Closes,
    #[serde(skip)]
    run: fn(&Trial) -> Result<Tally, AccelError>,
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
    pub tally: Tally,
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
        boxes::CASES,
        closed::CASES,
        odd_rays::CASES,
        slivers::CASES,
        spawned::CASES,
        placed::CASES,
        transforms::CASES,
        stacked::CASES,
        cells::CASES,
        interfaces::CASES,
        sums::CASES,
        marches::CASES,
        frames::CASES,
        quadrics::CASES,
        regressions::CASES,
        holes::CASES,
        false_hits::CASES,
        passages::CASES,
        degenerate::CASES,
        poison::CASES,
        backends::CASES,
        carried::CASES,
        nested::CASES,
        furnace::CASES,
        terminator::CASES,
        seams::CASES,
    ];
    // Sort them by identifier
    let mut all: Vec<&Case> = rooms.into_iter().flatten().collect();
    all.sort_by_key(|case| case.id);
    all
}

impl Case {
    /// Returns whether the case can run on `path`.
    pub fn applies_to(&self, path: &Path) -> bool {
        (self.asks == Asks::Formulas) == path.accel.is_none()
    }

    /// Returns whether the case must have no wrong results on `path`.
    pub fn requires(&self, path: &Path) -> bool {
        path.closes >= self.required
    }

    /// Runs the case on `subject` with about `rays` queries.
    ///
    /// # Errors
    ///
    /// Fails if an acceleration structure cannot be built.
    pub fn ask(&self, rays: u64, subject: &Subject) -> Result<Tally, AccelError> {
        (self.run)(&Trial::new(self.id, rays.max(1), subject))
    }

    /// Runs the case as [`Case::ask`] does, and adds line drawings of the scenes to [`Tally::sketch`].
    fn ask_drawn(&self, rays: u64, subject: &Subject) -> Result<Tally, AccelError> {
        (self.run)(&Trial::new(self.id, rays.max(1), subject).drawn())
    }
}

/// Runs a case on one backend variant with about `rays` queries; restricts Embree to the instruction set `isa` if one
/// is given. `judged` may be shared by all variants that run the case with the same number of rays.
///
/// # Errors
///
/// Fails if the structure cannot be built: without Embree, or on a machine without the instruction set.
pub fn check(
    (case, rays): (&Case, u64),
    path: &Path,
    isa: Option<&str>,
    judged: &Judged,
) -> Result<Outcome, AccelError> {
    outcome(case, path, (isa, judged), |subject| case.ask(rays, subject))
}

/// Runs a case as [`check`] does, and adds line drawings of the scenes to [`Tally::sketch`].
///
/// # Errors
///
/// Fails if the structure cannot be built, as [`check`] does.
pub fn check_drawn(
    (case, rays): (&Case, u64),
    path: &Path,
    isa: Option<&str>,
    judged: &Judged,
) -> Result<Outcome, AccelError> {
    outcome(case, path, (isa, judged), |subject| case.ask_drawn(rays, subject))
}

fn outcome(
    case: &Case,
    path: &Path,
    (isa, judged): (Option<&str>, &Judged),
    ask: impl FnOnce(&Subject) -> Result<Tally, AccelError>,
) -> Result<Outcome, AccelError> {
    // Set up the system under test
    let build: &Build = &|scene| build_path(scene, path, isa);
    let subject = Subject {
        build,
        formulas: Formulas::OURS,
        judged,
    };
    let embree = if path.is_embree() {
        trial::embree_identity(&subject)?
    } else {
        None
    };
    // Run the case and measure its time
    let start = Instant::now();
    let tally = ask(&subject)?;
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
pub fn build_path<'s>(
    scene: &'s Scene,
    path: &Path,
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
    fn every_case_has_a_name_of_its_own_and_says_what_it_does() {
        let all = cases();
        for pair in all.windows(2) {
            assert!(pair[0].id < pair[1].id, "{}", pair[1].id);
        }
        for case in all {
            for text in [case.title, case.construction, case.oracle, case.bound] {
                assert!(!text.is_empty() && !text.ends_with('.'), "{}: {text}", case.id);
            }
            assert!(
                PATHS
                    .iter()
                    .any(|path| case.applies_to(path) && case.requires(path))
            );
        }
    }

    #[test]
    fn paths_are_ordered_by_what_they_close() {
        assert!(Closes::Faces < Closes::Edges && Closes::Edges < Closes::Vertices);
        assert!(PATHS.windows(2).all(|pair| pair[0].closes <= pair[1].closes));
    }
}
