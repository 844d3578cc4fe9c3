//! Numbers of the tree's triangles by instance.

/// Range of consecutive numbers of triangles in the tree that belong to one instance.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleRun {
    /// Number of the first triangle.
    pub(super) first: u32,
    /// Index of the instance in the scene.
    pub(super) instance: u32,
}

impl TriangleRun {
    /// Returns the run of a triangle's number.
    #[inline(always)]
    pub(super) fn of(runs: &[TriangleRun], number: u32) -> &TriangleRun {
        match runs {
            [only] => only,
            runs => &runs[runs.partition_point(|run| run.first <= number) - 1],
        }
    }
}
