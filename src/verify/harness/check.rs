//! Outcome of a case on one backend variant.

use std::time::Instant;

use serde::Serialize;

use super::case::Case;
use super::counts::Counts;
use super::engine::embree_identity;
use super::formulas::Formulas;
use super::runner::Recording;
use super::system_under_test::{Build, SystemUnderTest};
use super::variant::{BackendVariant, build_variant};
use super::verdict_cache::VerdictCache;
use crate::accel::{AccelError, EmbreeIdentity};

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

/// Runs a case on one backend variant with about `rays` queries; restricts its kernels to the instruction set `isa`
/// if one is given. `verdict_cache` may be shared by all variants that run the case with the same number of rays.
///
/// # Errors
///
/// Fails if the structure cannot be built: without Embree, or on a machine without the instruction set.
pub fn check(
    (case, rays, recording): (&Case, u64, Recording),
    path: &BackendVariant,
    isa: Option<&str>,
    verdict_cache: &VerdictCache,
) -> Result<Outcome, AccelError> {
    // Set up the system under test
    let build: &Build = &|scene| build_variant(scene, path, isa);
    let subject = SystemUnderTest {
        build,
        formulas: Formulas::RENDERER,
        verdict_cache,
    };
    let embree = if path.is_embree() {
        embree_identity(&subject)?
    } else {
        None
    };
    // Run the case and measure its time
    let start = Instant::now();
    let tally = case.run_recording(recording, rays, &subject)?;
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
