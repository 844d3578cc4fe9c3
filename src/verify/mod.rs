//! Hard cases with exact answers, put to every way of finding hits: where each one stands, measured.
//!
//! A [`Case`] constructs rays, or arguments of a formula, that sit where rounding decides: on edges and corners, at
//! tangents, beside the critical angle. Its oracle knows the exact answer: by exact sums of floats where a decision is
//! the sign of a polynomial, by numbers of 106 bits elsewhere, by a closed surface around the origin of a ray. What
//! differs from it is sorted into wrong, where the exact answer is farther from a flip than the bound on rounding
//! explains, and ties, where it is not. Only wrong answers count, and only on the paths that promise better; on the
//! others they are measured.
//!
//! A scene's own rays have no exact answers that are known beforehand: [`compare_all`] puts them to two structures and
//! sorts what differs, and [`Hygiene`] tells what is wrong with a mesh before any ray is sent.
//!
//! Each case can fail: the tests put a careless formula or structure in the place of ours and see it caught.

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

/// What a case is put to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Asks {
    /// Triangles, on every path that finds hits.
    Triangles,
    /// Analytic shapes, on every path that finds hits.
    Shapes,
    /// Formulas without a scene.
    Formulas,
}

/// A hard case.
#[derive(Clone, Copy, Serialize)]
pub struct Case {
    /// `H` and two digits.
    pub id: &'static str,
    /// What it is called.
    pub title: &'static str,
    /// What is asked.
    pub construction: &'static str,
    /// What knows the answer.
    pub oracle: &'static str,
    /// What an answer may be off by.
    pub bound: &'static str,
    /// What the largest error is measured in; empty where none is.
    pub unit: &'static str,
    /// What it is put to.
    pub asks: Asks,
    /// Paths that close this and more must answer nothing wrong.
    pub required: Closes,
    #[serde(skip)]
    run: fn(&Trial) -> Result<Tally, AccelError>,
}

/// How a case went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing was wrong.
    Holds,
    /// Something was wrong on a path that promises no better.
    Measured,
    /// Something was wrong that must not be.
    Fails,
}

/// How a case went on a path.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// What was counted.
    #[serde(flatten)]
    pub tally: Tally,
    /// What to make of it.
    pub verdict: Verdict,
    /// Whether the path must answer nothing wrong.
    pub required: bool,
    /// Which Embree answered, if one did.
    pub embree: Option<EmbreeIdentity>,
    /// Seconds that it took, with making the rays and working out what the answers should be.
    pub seconds: f64,
}

/// All cases, in the order of their names.
pub fn cases() -> Vec<&'static Case> {
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
    let mut all: Vec<&Case> = rooms.into_iter().flatten().collect();
    all.sort_by_key(|case| case.id);
    all
}

impl Case {
    /// Whether the case can be put to that path.
    pub fn applies_to(&self, path: &Path) -> bool {
        (self.asks == Asks::Formulas) == path.accel.is_none()
    }

    /// Whether nothing may be wrong on that path.
    pub fn requires(&self, path: &Path) -> bool {
        path.closes >= self.required
    }

    /// Puts the case to `subject` with about `rays` questions.
    ///
    /// # Errors
    ///
    /// Where a structure cannot be built.
    pub fn ask(&self, rays: u64, subject: &Subject) -> Result<Tally, AccelError> {
        (self.run)(&Trial::new(self.id, rays.max(1), subject))
    }

    /// As [`Case::ask`], with lines of what the first rays are sent into: [`Tally::sketch`] is whole.
    fn ask_drawn(&self, rays: u64, subject: &Subject) -> Result<Tally, AccelError> {
        (self.run)(&Trial::new(self.id, rays.max(1), subject).drawn())
    }
}

/// Puts a case to a path with about `rays` questions; Embree is held to the instruction set `isa` if one is given.
/// `judged` is for all paths that are asked as many questions of the case.
///
/// # Errors
///
/// Where a structure cannot be built: without Embree, on a machine without the instruction set.
pub fn check(
    (case, rays): (&Case, u64),
    path: &Path,
    isa: Option<&str>,
    judged: &Judged,
) -> Result<Outcome, AccelError> {
    outcome(case, path, (isa, judged), |subject| case.ask(rays, subject))
}

/// As [`check`], with lines of what the first rays are sent into in [`Tally::sketch`].
///
/// # Errors
///
/// As for [`check`].
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
    let start = Instant::now();
    let tally = ask(&subject)?;
    let seconds = start.elapsed().as_secs_f64();
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

/// Whether Embree can be held to that instruction set on this machine.
pub fn has_instruction_set(isa: &str) -> bool {
    let options = AccelOptions {
        isa: Some(isa.to_owned()),
        ..AccelOptions::default()
    };
    let scene = Scene::default();
    let built = accel::build(&scene, Backend::Embree, &options);
    // Asked for more than the machine has, Embree takes what there is.
    built.is_ok_and(|accel| accel.report().embree.is_some_and(|embree| embree.isa == isa))
}

/// What finds hits on that path; brute force where it finds none. Embree is held to the instruction set `isa` if one is
/// given.
///
/// # Errors
///
/// Where it cannot be built: without Embree, on a machine without the instruction set.
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
        // As many as the pool has that this runs in.
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
