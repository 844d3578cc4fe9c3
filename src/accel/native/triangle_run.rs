//! Numbers of the tree's triangles by instance.

use crate::mesh::Mesh;

/// Range of consecutive numbers of triangles in the tree that belong to one instance.
pub(super) struct TriangleRun<'s> {
    /// Number of the first triangle.
    pub(super) first: u32,
    /// Index of the instance in the scene.
    pub(super) instance: u32,
    /// Mesh of the instance, in world space.
    pub(super) mesh: &'s Mesh,
}

impl<'s> TriangleRun<'s> {
    /// Returns the run of a triangle's number.
    #[inline(always)]
    pub(super) fn of<'r>(runs: &'r [TriangleRun<'s>], number: u32) -> &'r TriangleRun<'s> {
        match runs {
            [only] => only,
            runs => &runs[runs.partition_point(|run| run.first <= number) - 1],
        }
    }
}
