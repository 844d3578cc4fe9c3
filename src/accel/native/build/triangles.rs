//! Triangles of several meshes with consecutive indices.

use glam::Vec3A;

use crate::accel::morton::Box4;
use crate::mesh::Mesh;

/// Triangles of several meshes with consecutive indices.
pub(super) struct NumberedTriangles<'a> {
    meshes: Vec<NumberedMesh<'a>>,
    /// Number of triangles of all meshes.
    pub(super) count: usize,
}

/// Arrays of a mesh, and the index of its first triangle.
struct NumberedMesh<'a> {
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    first: usize,
}

impl<'a> NumberedTriangles<'a> {
    /// Numbers the triangles of the meshes one after the other; `None` if their number overflows.
    pub(super) fn new(meshes: &[&'a Mesh]) -> Option<NumberedTriangles<'a>> {
        let mut count = 0usize;
        let mut arrays = Vec::with_capacity(meshes.len());
        for mesh in meshes {
            arrays.push(NumberedMesh {
                positions: &mesh.positions,
                triangles: &mesh.triangles,
                first: count,
            });
            count = count.checked_add(mesh.triangles.len())?;
        }
        // A mesh without triangles is never looked up.
        arrays.retain(|mesh| !mesh.triangles.is_empty());
        Some(NumberedTriangles {
            meshes: arrays,
            count,
        })
    }

    /// Returns the vertices of a triangle by its index.
    #[inline(always)]
    pub(super) fn corners(&self, number: usize) -> [Vec3A; 3] {
        let mesh = match &self.meshes[..] {
            [only] => only,
            several => &several[several.partition_point(|mesh| mesh.first <= number) - 1],
        };
        let [a, b, c] = mesh.triangles[number - mesh.first];
        [a, b, c].map(|vertex| Vec3A::from(mesh.positions[vertex as usize]))
    }

    /// Returns twice the midpoint of a triangle's bounds.
    #[inline(always)]
    pub(super) fn twice_centre(&self, number: usize) -> Vec3A {
        let [a, b, c] = self.corners(number);
        a.min(b).min(c) + a.max(b).max(c)
    }

    /// Returns the bounds of all vertices.
    pub(super) fn vertex_bounds(&self) -> Box4 {
        let mut bounds = Box4::EMPTY;
        for mesh in &self.meshes {
            bounds.add(&Box4::around(mesh.positions));
        }
        bounds
    }
}
