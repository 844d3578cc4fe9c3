//! Kind of a ray query. Nearest-hit and occlusion queries share their code in every backend.

/// Kind of ray query.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Query {
    /// Query for the nearest hit.
    Nearest,
    /// Query for any hit, that is, occlusion.
    Any,
}
