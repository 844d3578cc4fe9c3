//! Vertex fetch: positions and vertex normals of the triangles that the sixteen rays of a packet hit.

use glam::{DVec3, Vec3};

use crate::accel::{NO_HIT, RayPacket};
use crate::mesh::Mesh;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::scene::{Effect, EffectSet};
use crate::shading::ray_cone::triangle_curvature;

/// Slices of the arrays of a mesh, resolved once, because a `Buffer` tests at every access where its values
/// are.
pub(super) struct MeshView<'s> {
    pub(super) positions: &'s [[f32; 3]],
    pub(super) triangles: &'s [[u32; 3]],
    pub(super) normals: Option<&'s [[f32; 3]]>,
    pub(super) tex_coords: Vec<&'s [[f32; 2]]>,
    pub(super) tangents: Option<&'s [[f32; 4]]>,
    pub(super) colors: Option<&'s [[f32; 4]]>,
}

/// Vertex positions and normals of the hit triangles. Lanes without a hit keep values of an earlier packet.
pub(super) struct FetchedVertices {
    pub(super) corners: [Lanes3<f32>; 3],
    pub(super) normals: [Lanes3<f32>; 3],
    /// Lanes whose triangle has vertex normals; the others are flat.
    pub(super) smooth: Lanes<bool>,
    /// True if some lanes are not world-space triangles, but are computed with the transforms of their instances.
    pub(super) needs_object_space: bool,
    /// True if some lanes are world-space triangles.
    pub(super) has_world_triangles: bool,
}

impl FetchedVertices {
    pub(super) fn new() -> FetchedVertices {
        FetchedVertices {
            // Valid triangle in the xy plane, for lanes that have not been filled yet.
            corners: [
                [[0.0; LANES]; 3],
                [[1.0; LANES], [0.0; LANES], [0.0; LANES]],
                [[0.0; LANES], [1.0; LANES], [0.0; LANES]],
            ],
            normals: [[[0.0; LANES]; 3]; 3],
            smooth: [false; LANES],
            needs_object_space: false,
            has_world_triangles: false,
        }
    }

    /// Returns the curvatures of all lanes that their vertex normals imply, in object space.
    #[inline(always)]
    pub(super) fn curvatures(&self) -> Lanes<f64> {
        let mut curvatures = [0.0; LANES];
        for l in 0..LANES {
            let wide = |v: &Lanes3<f32>| DVec3::new(v[0][l].into(), v[1][l].into(), v[2][l].into());
            let [p0, p1, p2] = &self.corners;
            let [n0, n1, n2] = &self.normals;
            let unit = |n: DVec3| {
                let squared = n.length_squared();
                n * if squared > 0.0 {
                    squared.sqrt().recip()
                } else {
                    0.0
                }
            };
            let normals = [unit(wide(n0)), unit(wide(n1)), unit(wide(n2))];
            curvatures[l] = triangle_curvature([wide(p0), wide(p1), wide(p2)], normals);
        }
        curvatures
    }
}

impl<'s> MeshView<'s> {
    /// Returns the arrays of `mesh` that the effects need.
    pub(super) fn of(mesh: &'s Mesh, effects: EffectSet) -> MeshView<'s> {
        MeshView {
            positions: &mesh.positions,
            triangles: &mesh.triangles,
            normals: mesh
                .normals
                .as_deref()
                .filter(|_| effects.has(Effect::SmoothNormals)),
            tex_coords: mesh.tex_coords.iter().map(|set| &set[..]).collect(),
            tangents: mesh.tangents.as_deref(),
            colors: mesh
                .colors
                .as_deref()
                .filter(|_| effects.has(Effect::VertexColor)),
        }
    }
}

impl MeshView<'_> {
    /// Fetches the vertices of one triangle, with vertex normals if the mesh has any, for all lanes.
    #[inline(always)]
    pub(super) fn gather_everywhere(&self, primitive: u32, gathered: &mut FetchedVertices) {
        let vertices = self.triangles[primitive as usize].map(|vertex| vertex as usize);
        for (corner, vertex) in vertices.into_iter().enumerate() {
            gathered.corners[corner] = self.positions[vertex].map(|axis| [axis; LANES]);
        }
        gathered.smooth = [self.normals.is_some(); LANES];
        if let Some(normals) = self.normals {
            for (corner, vertex) in vertices.into_iter().enumerate() {
                gathered.normals[corner] = normals[vertex].map(|axis| [axis; LANES]);
            }
        }
    }

    /// Fetches the vertices of the triangle of each lane, with vertex normals if the mesh has any.
    ///
    /// Reads one array after the other, so that the loads of all lanes overlap. Lanes that missed use the first
    /// triangle, which avoids a branch.
    #[inline(always)]
    pub(super) fn gather_lanes(&self, packet: &RayPacket, gathered: &mut FetchedVertices) {
        // Look up the vertex indices of all lanes
        let mut vertices = [[0; 3]; LANES];
        for l in 0..LANES {
            if packet.instance[l] != NO_HIT {
                vertices[l] = self.triangles[packet.primitive[l] as usize];
            }
        }
        // Transpose vertices from the mesh into lanes
        let columns = |array: &[[f32; 3]], out: &mut [Lanes3<f32>; 3]| {
            for l in 0..LANES {
                for corner in 0..3 {
                    let value = array[vertices[l][corner] as usize];
                    for axis in 0..3 {
                        out[corner][axis][l] = value[axis];
                    }
                }
            }
        };
        columns(self.positions, &mut gathered.corners);
        gathered.smooth = [self.normals.is_some(); LANES];
        if let Some(normals) = self.normals {
            columns(normals, &mut gathered.normals);
        }
    }

    /// Fetches the vertices of the triangle of lane `l`, with vertex normals if the mesh has any.
    #[inline(always)]
    pub(super) fn gather(&self, packet: &RayPacket, l: usize, gathered: &mut FetchedVertices) {
        let vertices = self.triangles[packet.primitive[l] as usize].map(|vertex| vertex as usize);
        for (corner, vertex) in vertices.into_iter().enumerate() {
            let position = self.positions[vertex];
            for axis in 0..3 {
                gathered.corners[corner][axis][l] = position[axis];
            }
        }
        if let Some(normals) = self.normals {
            gathered.smooth[l] = true;
            for (corner, vertex) in vertices.into_iter().enumerate() {
                let normal = normals[vertex];
                for axis in 0..3 {
                    gathered.normals[corner][axis][l] = normal[axis];
                }
            }
        }
    }

    /// Returns the derivatives of the point by the texture coordinates, in object space; zero where the coordinates
    /// of the triangle are degenerate.
    pub(super) fn derivatives(&self, set: &[[f32; 2]], primitive: u32) -> [DVec3; 2] {
        let vertices = self.triangles[primitive as usize].map(|vertex| vertex as usize);
        let [a, b, c] = vertices.map(|vertex| Vec3::from(self.positions[vertex]).as_dvec3());
        let [ta, tb, tc] = vertices.map(|vertex| set[vertex].map(f64::from));
        let (e1, e2) = (b - a, c - a);
        let ([u1, v1], [u2, v2]) = ([tb[0] - ta[0], tb[1] - ta[1]], [tc[0] - ta[0], tc[1] - ta[1]]);
        // Solve (e1, e2) = (dp/du, dp/dv) times the matrix of coordinate differences.
        let inverse = (u1 * v2 - u2 * v1).recip();
        let derivatives = [(e1 * v2 - e2 * v1) * inverse, (e2 * u1 - e1 * u2) * inverse];
        // Degenerate coordinates give infinite or NaN derivatives.
        derivatives.map(|d| if d.is_finite() { d } else { DVec3::ZERO })
    }

    /// Interpolates a vertex attribute at the hit of lane `l`.
    pub(super) fn interpolate<const N: usize>(
        &self,
        values: &[[f32; N]],
        packet: &RayPacket,
        l: usize,
    ) -> [f32; N] {
        let [a, b, c] = self.triangles[packet.primitive[l] as usize];
        let (a, b, c) = (values[a as usize], values[b as usize], values[c as usize]);
        let (u, v) = (packet.u[l], packet.v[l]);
        let w = 1.0 - u - v;
        std::array::from_fn(|i| w * a[i] + u * b[i] + v * c[i])
    }
}
