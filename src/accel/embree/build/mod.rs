//! Construction of Embree's scenes: the assignment of meshes to scenes, and their attachment.

mod duplicate_triangles;
mod plan;
pub(super) mod scene_build;
