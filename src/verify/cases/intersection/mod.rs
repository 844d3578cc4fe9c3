//! Cases of ray intersection with triangles.

pub(super) mod backend_comparison;
pub(super) mod box_slabs;
pub(super) mod coincident;
pub(super) mod degenerate;
pub(super) mod false_hits;
pub(super) mod instance_seams;
pub(super) mod invalid_rays;
pub(super) mod leaks;
pub(super) mod ray_continuation;
pub(super) mod regressions;
pub(super) mod self_intersection;
pub(super) mod self_intersection_instanced;
pub(super) mod slivers;
pub(super) mod split_planes;
pub(super) mod watertight;
