//! Cases of analytic shapes and transforms.

pub(super) mod solids;
pub(super) mod spheres;
pub(super) mod thin_ellipsoids;
pub(super) mod transforms;
