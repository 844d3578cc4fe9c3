//! Queries that a group kernel is compiled for.

/// Query and form of the rays, known at compile time.
pub(super) trait GroupQuery {
    /// Flag of queries for any hit on the way to a common target: none needs to be the nearest, and rays may start at
    /// surfaces.
    const IS_ANY: bool;
}

/// Nearest hit of rays from a common origin.
pub(super) struct NearestFromOrigin;

/// Any hit of rays to a common target.
pub(super) struct AnyToTarget;

impl GroupQuery for NearestFromOrigin {
    const IS_ANY: bool = false;
}

impl GroupQuery for AnyToTarget {
    const IS_ANY: bool = true;
}
