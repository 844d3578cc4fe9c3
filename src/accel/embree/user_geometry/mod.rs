//! User geometry: the primitives that callbacks from Embree test, and their tests.

pub(super) mod callbacks;
mod hit_record;
mod point_cluster;
pub(super) mod primitives;
mod sphere_cluster;
mod sphere_cull;
mod sphere_test;
pub(super) mod triangle_cluster;
mod triangle_test;
