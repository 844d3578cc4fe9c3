//! Numbers of the tree's triangles by instance.

use crate::mesh::Mesh;
use glam::Vec3;

/// Range of consecutive numbers of triangles in the tree that belong to one instance.
///
/// The mesh's arrays are resolved once, because a `Buffer` tests at every access where its values are.
pub(super) struct TriangleRun<'s> {
    /// Number of the first triangle.
    pub(super) first: u32,
    /// Index of the instance in the scene.
    pub(super) instance: u32,
    /// Vertex indices of the mesh, by triangle.
    triangles: &'s [[u32; 3]],
    /// Vertices of the mesh in world space.
    positions: &'s [[f32; 3]],
}

impl<'s> TriangleRun<'s> {
    /// Returns the run of the triangles of `mesh`, from number `first` on.
    pub(super) fn new(first: u32, instance: u32, mesh: &'s Mesh) -> TriangleRun<'s> {
        TriangleRun {
            first,
            instance,
            triangles: &mesh.triangles,
            positions: &mesh.positions,
        }
    }

    /// Returns the run of a triangle's number.
    #[inline(always)]
    pub(super) fn of<'r>(runs: &'r [TriangleRun<'s>], number: u32) -> &'r TriangleRun<'s> {
        match runs {
            [only] => only,
            runs => &runs[runs.partition_point(|run| run.first <= number) - 1],
        }
    }

    /// Returns the vertices of the triangle of a number.
    #[inline(always)]
    pub(super) fn corners(runs: &[TriangleRun<'s>], number: u32) -> [Vec3; 3] {
        let run = TriangleRun::of(runs, number);
        let vertices = run.triangles[(number - run.first) as usize];
        vertices.map(|vertex| Vec3::from(run.positions[vertex as usize]))
    }
}
