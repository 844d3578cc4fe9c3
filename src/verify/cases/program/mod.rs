//! Cases of the program as a whole.

pub(super) mod determinism;
pub(super) mod invariance;
pub(super) mod nan_injection;
