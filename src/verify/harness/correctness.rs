//! Verdict on one result against the exact one.

use serde::Serialize;

use crate::accel::hit_compare::HitComparison;

/// Verdict on one result against the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Correctness {
    /// Result as exact as the case requires.
    Right,
    /// Different result that rounding explains.
    Tie,
    /// Different result that rounding does not explain.
    Wrong,
}

impl Correctness {
    /// Returns `Wrong` if `is_wrong`, else `Right`.
    pub(in crate::verify) fn wrong_if(is_wrong: bool) -> Correctness {
        if is_wrong {
            Correctness::Wrong
        } else {
            Correctness::Right
        }
    }

    /// Returns `Tie` if `is_tie`, else `Wrong`.
    pub(in crate::verify) fn tie_if(is_tie: bool) -> Correctness {
        if is_tie {
            Correctness::Tie
        } else {
            Correctness::Wrong
        }
    }
}

impl From<HitComparison> for Correctness {
    fn from(comparison: HitComparison) -> Correctness {
        match comparison {
            HitComparison::Same => Correctness::Right,
            HitComparison::Tie => Correctness::Tie,
            HitComparison::Wrong => Correctness::Wrong,
        }
    }
}
