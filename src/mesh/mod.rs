//! Triangle meshes and point clouds: vertex and index arrays, owned or shared with the bytes of a file.

mod bumpy;
mod point_cloud;
pub mod simd;
mod tangents;
pub mod triangle;

use glam::{DVec3, Vec3};

use crate::buffer::Buffer;
use crate::numeric::Bounds;
use crate::parallel;
pub use bumpy::bumpy_sphere;
use point_cloud::box_around;
pub use point_cloud::{PointCloud, position_bounds};

/// Triangle mesh in object space.
///
/// After [`crate::scene::Scene::validate`] every index is in range, every position finite, and no triangle has zero
/// area.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions in object space.
    pub positions: Buffer<[f32; 3]>,
    /// Vertex indices of each triangle, counter-clockwise seen from the front.
    pub triangles: Buffer<[u32; 3]>,
    /// Unit shading normals per vertex; without them the mesh is flat-shaded.
    pub normals: Option<Buffer<[f32; 3]>>,
    /// Unit tangents per vertex, in the direction in which the first texture coordinate of the normal map grows; the
    /// fourth number is the handedness, 1 or -1.
    pub tangents: Option<Buffer<[f32; 4]>>,
    /// Texture coordinates per vertex, one array a set (`TEXCOORD_0`, ...).
    pub tex_coords: Vec<Buffer<[f32; 2]>>,
    /// Linear RGBA per vertex that multiplies the base colour.
    pub colors: Option<Buffer<[f32; 4]>>,
}

impl Mesh {
    /// Returns the three vertices of a triangle.
    #[inline(always)]
    pub fn corners(&self, primitive: u32) -> [Vec3; 3] {
        let [a, b, c] = self.triangles[primitive as usize];
        let corner = |v: u32| Vec3::from(self.positions[v as usize]);
        [corner(a), corner(b), corner(c)]
    }

    /// Returns the three vertices of a triangle, converted to f64 without rounding.
    #[inline(always)]
    pub fn corners_f64(&self, primitive: u32) -> [DVec3; 3] {
        self.corners(primitive).map(|p| p.as_dvec3())
    }

    /// Returns the smallest box around all vertices that a triangle uses.
    pub fn bounds(&self) -> Bounds {
        const CHUNK: usize = 1 << 14;
        // Bound chunks of triangles in parallel
        let positions = &self.positions[..];
        let chunks = parallel::map_chunks(&self.triangles, CHUNK, &|_, triangles| {
            let vertices = triangles.as_flattened().iter();
            box_around(vertices.map(|&v| positions[v as usize]))
        });
        chunks.into_iter().fold(Bounds::EMPTY, Bounds::union)
    }

    /// Returns the size of all arrays in bytes, shared or owned.
    pub fn byte_count(&self) -> usize {
        let of = |len: usize, floats: usize| len * floats * size_of::<f32>();
        of(self.positions.len(), 3)
            + of(self.triangles.len(), 3)
            + self.normals.as_ref().map_or(0, |n| of(n.len(), 3))
            + self.tex_coords.iter().map(|t| of(t.len(), 2)).sum::<usize>()
            + self.tangents.as_ref().map_or(0, |t| of(t.len(), 4))
            + self.colors.as_ref().map_or(0, |c| of(c.len(), 4))
    }
}
