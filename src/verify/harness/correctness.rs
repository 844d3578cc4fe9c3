//! Verdict on one result against the exact one.

use serde::Serialize;

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
}
