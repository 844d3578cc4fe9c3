//! Tangents for meshes whose file has none: MikkTSpace (Mikkelsen, "Simulation of Wrinkled Surfaces Revisited", 2008),
//! the tangent frames for which normal maps are baked.
//!
//! The algorithm computes a tangent for every corner of every triangle. Corners at one vertex mostly agree; where they
//! do not, along seams and mirrored halves, the vertex is split. Texture coordinates run downwards, the frames of
//! normal maps upwards, so the second coordinate is negated.
//!
//! The library walks around a vertex by recursion and compares its triangles with each other. A mesh that makes this
//! too deep or too slow gets each triangle's own tangents instead.

use std::collections::HashMap;

use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
use bytemuck::Pod;
use glam::{DVec3, Vec3};

use super::Mesh;
use crate::buffer::Buffer;
use crate::parallel;

/// Largest number of triangles around a vertex, which limits the depth of the recursion: a quarter of a megabyte of
/// stack.
const MAX_VERTEX_TRIANGLES: u64 = 1024;
/// Number of comparisons that is always allowed, as it takes negligible time.
const FREE_COMPARISONS: u64 = 1 << 24;
/// Number of comparisons allowed a corner; six triangles around every vertex need six.
const COMPARISONS_A_CORNER: u64 = 32;

impl Mesh {
    /// Returns the mesh with tangents computed from texture coordinate set `set`, which has a pair for each vertex. A
    /// flat-shaded mesh gets those of its geometric normals. Vertices keep their indices; copies are appended.
    ///
    /// Every index must be in range and every position and coordinate finite.
    pub fn with_tangents(&self, set: usize) -> Mesh {
        let mut corners = Corners {
            mesh: self,
            tex_coords: &self.tex_coords[set],
            position_scale: scale_to_one(bytemuck::cast_slice(&self.positions)),
            tex_coord_scale: scale_to_one(bytemuck::cast_slice(&self.tex_coords[set])),
            tangents: vec![[[0.0; 4]; 3]; self.triangles.len()],
        };
        // The library reports no errors; tangents that it leaves at zero are filled in below.
        if !corners.exceeds_library_limits() && generate_tangents(&mut corners).is_err() {
            corners.tangents.fill([[0.0; 4]; 3]);
        }
        let filled: Vec<[[f32; 4]; 3]> = parallel::generate(self.triangles.len(), |face| {
            std::array::from_fn(|corner| corners.tangent_or_fallback(face, corner))
        });
        self.split(&filled)
    }

    /// Assigns to each vertex the tangent of its first corner, and adds a copy of the vertex for every other tangent.
    fn split(&self, tangents_of_triangles: &[[[f32; 4]; 3]]) -> Mesh {
        const NONE_YET: [f32; 4] = [1.0, 0.0, 0.0, 0.0];
        const UNUSED: [f32; 4] = [1.0, 0.0, 0.0, 1.0];
        let vertex_count = self.positions.len();
        let mut triangles = self.triangles.to_vec();
        let mut tangents = vec![NONE_YET; vertex_count];
        let mut copied: Vec<u32> = Vec::new();
        let mut copies: HashMap<(u32, [u32; 4]), u32> = HashMap::new();
        let corners = triangles.as_flattened_mut().iter_mut();
        // Compare each corner's tangent with that of its vertex
        for (vertex, &tangent) in corners.zip(tangents_of_triangles.as_flattened()) {
            let first = &mut tangents[*vertex as usize];
            if *first == NONE_YET {
                *first = tangent;
            }
            // Indices end at 2^32: a vertex without a free index keeps its first tangent.
            let Ok(next) = u32::try_from(vertex_count + copied.len()) else {
                continue;
            };
            // Find or add the copy of the vertex with this tangent
            if *first != tangent {
                let original = *vertex;
                *vertex = *copies
                    .entry((original, tangent.map(f32::to_bits)))
                    .or_insert_with(|| {
                        copied.push(original);
                        tangents.push(tangent);
                        next
                    });
            }
        }
        // Give unused vertices a unit tangent
        let unused = tangents.iter_mut().filter(|t| **t == NONE_YET);
        unused.for_each(|t| *t = UNUSED);
        let tangents = Some(Buffer::from(tangents));
        if copied.is_empty() {
            return Mesh {
                tangents,
                ..self.clone()
            };
        }
        // Append the attributes of the copies
        Mesh {
            positions: append_copies(&self.positions, &copied),
            triangles: Buffer::from(triangles),
            normals: self.normals.as_ref().map(|n| append_copies(n, &copied)),
            tangents,
            tex_coords: self
                .tex_coords
                .iter()
                .map(|t| append_copies(t, &copied))
                .collect(),
            colors: self.colors.as_ref().map(|c| append_copies(c, &copied)),
        }
    }
}

/// Returns the values with those of the `copied` vertices appended; an empty array stays empty.
fn append_copies<T: Pod>(values: &Buffer<T>, copied: &[u32]) -> Buffer<T> {
    if values.is_empty() {
        return values.clone();
    }
    let copies = copied.iter().map(|&v| values[v as usize]);
    Buffer::from(values.iter().copied().chain(copies).collect::<Vec<_>>())
}

/// Returns the power of two that brings the largest value near 1, so that products of f32 neither overflow nor
/// underflow.
fn scale_to_one(values: &[f32]) -> f64 {
    const CHUNK: usize = 1 << 16;
    let largest_of = |values: &[f32]| values.iter().map(|x| x.abs()).fold(0.0, f32::max);
    let largest = parallel::map_chunks(values, CHUNK, &|_, chunk| largest_of(chunk));
    let largest = f64::from(largest_of(&largest));
    if largest > 0.0 && largest < f64::INFINITY {
        2f64.powi(-largest.log2().floor() as i32)
    } else {
        1.0
    }
}

/// Adapter of a mesh for the library, which collects its tangents.
struct Corners<'a> {
    mesh: &'a Mesh,
    tex_coords: &'a [[f32; 2]],
    position_scale: f64,
    tex_coord_scale: f64,
    tangents: Vec<[[f32; 4]; 3]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, corner: usize) -> usize {
        self.mesh.triangles[face][corner] as usize
    }

    /// Returns whether so many triangles share a vertex that the library would need too much stack or time. Corners
    /// share a vertex if their position, normal and texture coordinates are equal.
    fn exceeds_library_limits(&self) -> bool {
        let face_count = self.mesh.triangles.len();
        if (face_count as u64) <= MAX_VERTEX_TRIANGLES {
            return false;
        }
        // Count the corners at each distinct vertex
        let mut around: HashMap<[u32; 8], u64> = HashMap::new();
        for (face, corner) in (0..face_count).flat_map(|face| (0..3).map(move |corner| (face, corner))) {
            let ([x, y, z], [a, b, c]) = (self.position(face, corner), self.normal(face, corner));
            let [u, v] = self.tex_coord(face, corner);
            let key = [x, y, z, a, b, c, u, v].map(f32::to_bits);
            *around.entry(key).or_insert(0) += 1;
        }
        // The library compares all corners at a vertex with each other
        let comparisons: u64 = around.values().map(|n| n * n).sum();
        let allowed = FREE_COMPARISONS + COMPARISONS_A_CORNER * 3 * face_count as u64;
        comparisons > allowed || around.values().any(|&n| n > MAX_VERTEX_TRIANGLES)
    }

    /// Returns the tangent that the library computed for a corner; else the triangle's own; if the texture coordinates
    /// have no direction, any unit vector perpendicular to the normal.
    fn tangent_or_fallback(&self, face: usize, corner: usize) -> [f32; 4] {
        let [x, y, z, handedness] = self.tangents[face][corner];
        // The library returns unit vectors or zero.
        if handedness != 0.0 && Vec3::new(x, y, z).length_squared() > 0.5 {
            return [x, y, z, handedness];
        }
        // Orthogonalise the triangle's own tangent
        let n = DVec3::from_array(self.normal(face, corner).map(f64::from)).normalize_or(DVec3::Z);
        let (along, handedness) = self.triangle_tangent(face);
        let across = along - n * n.dot(along);
        let tangent = across.try_normalize().unwrap_or(n.any_orthonormal_vector());
        tangent.as_vec3().extend(handedness).to_array()
    }

    /// Returns the direction in which a triangle's first texture coordinate grows, and the handedness.
    fn triangle_tangent(&self, face: usize) -> (DVec3, f32) {
        let p = [0, 1, 2].map(|corner| DVec3::from_array(self.position(face, corner).map(f64::from)));
        let t = [0, 1, 2].map(|corner| self.tex_coord(face, corner).map(f64::from));
        let [[u1, v1], [u2, v2]] = [1, 2].map(|i| [t[i][0] - t[0][0], t[i][1] - t[0][1]]);
        let side = if u1 * v2 - v1 * u2 < 0.0 { -1.0 } else { 1.0 };
        (((p[1] - p[0]) * v2 - (p[2] - p[0]) * v1) * f64::from(side), side)
    }
}

impl Geometry for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.triangles.len()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        let p = self.mesh.positions[self.vertex(face, corner)];
        // Adding zero maps -0 to 0, which the library distinguishes.
        p.map(|x| (f64::from(x) * self.position_scale) as f32 + 0.0)
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        match &self.mesh.normals {
            Some(normals) => normals[self.vertex(face, corner)],
            None => {
                let [a, b, c] = self.mesh.corners_f64(face as u32);
                (b - a).cross(c - a).normalize_or(DVec3::Z).as_vec3().to_array()
            }
        }
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        let [u, v] = self.tex_coords[self.vertex(face, corner)];
        [u, -v].map(|x| (f64::from(x) * self.tex_coord_scale) as f32 + 0.0)
    }

    fn set_tangent(&mut self, space: Option<TangentSpace>, face: usize, corner: usize) {
        if let Some(space) = space {
            self.tangents[face][corner] = space.tangent_encoded();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a square in the plane z = 0 of two triangles with shared vertices; texture coordinates grow right and
    /// down.
    fn square() -> Mesh {
        Mesh {
            positions: Buffer::from(vec![[0.0, 1.0, 0.0], [0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2], [0, 2, 3]]),
            normals: Some(Buffer::from(vec![[0.0, 0.0, 1.0]; 4])),
            tex_coords: vec![Buffer::from(vec![[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])],
            ..Mesh::default()
        }
    }

    fn tangents(mesh: &Mesh) -> &[[f32; 4]] {
        mesh.tangents.as_ref().unwrap()
    }

    #[test]
    fn upright_texture_has_tangent_right_and_bitangent_up() {
        // n x t = z x x = y, which is up.
        let mesh = square().with_tangents(0);
        assert_eq!(tangents(&mesh), [[1.0, 0.0, 0.0, 1.0]; 4]);
        let flat = Mesh {
            normals: None,
            ..square()
        };
        assert_eq!(tangents(&flat.with_tangents(0)), [[1.0, 0.0, 0.0, 1.0]; 4]);
    }

    #[test]
    fn tangents_do_not_depend_on_mesh_or_texture_scale() {
        for (scale, tex_scale) in [(1e-38f32, 1e-38f32), (1e38, 1e38), (1e-38, 1e38)] {
            let scaled = Mesh {
                positions: Buffer::from(square().positions.map_all(|x| x * scale)),
                tex_coords: vec![Buffer::from(square().tex_coords[0].map_all(|x| x * tex_scale))],
                ..square()
            };
            assert_eq!(tangents(&scaled.with_tangents(0)), [[1.0, 0.0, 0.0, 1.0]; 4]);
        }
    }

    trait MapAll<const N: usize> {
        fn map_all(&self, f: impl Fn(f32) -> f32) -> Vec<[f32; N]>;
    }

    impl<const N: usize> MapAll<N> for Buffer<[f32; N]>
    where
        [f32; N]: Pod,
    {
        fn map_all(&self, f: impl Fn(f32) -> f32) -> Vec<[f32; N]> {
            self.iter().map(|x| x.map(&f)).collect()
        }
    }

    #[test]
    fn vertex_is_split_at_mirrored_textures_with_its_attributes() {
        // The second triangle's image is mirrored about the shared edge from vertex 0 to vertex 2.
        let mesh = Mesh {
            tex_coords: vec![Buffer::from(vec![[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.0, 1.0]])],
            colors: Some(Buffer::from([0.1, 0.2, 0.3, 0.4].map(|x| [x; 4]).to_vec())),
            ..square()
        };
        let split = mesh.with_tangents(0);
        assert_eq!(split.positions.len(), 6);
        assert_eq!(split.triangles[..], [[0, 1, 2], [4, 5, 3]]);
        for (copy, original) in [(4, 0), (5, 2)] {
            assert_eq!(split.positions[copy], mesh.positions[original]);
            assert_eq!(split.normals.as_ref().unwrap()[copy], [0.0, 0.0, 1.0]);
            assert_eq!(split.tex_coords[0][copy], mesh.tex_coords[0][original]);
            assert_eq!(
                split.colors.as_ref().unwrap()[copy],
                [[0.1, 0.3][original / 2]; 4]
            );
        }
        assert_eq!(tangents(&split)[..3], [[1.0, 0.0, 0.0, 1.0]; 3]);
        // On the second triangle u grows downwards and v to the right, so that the image's up is to the left; n x t = z
        // x -y = x.
        assert_eq!(tangents(&split)[3..], [[0.0, -1.0, 0.0, -1.0]; 3]);
    }

    #[test]
    fn degenerate_texture_coordinates_give_unit_tangents() {
        let mesh = Mesh {
            tex_coords: vec![Buffer::from(vec![[0.5, 0.5]; 4])],
            ..square()
        };
        for &[x, y, z, w] in tangents(&mesh.with_tangents(0)) {
            assert!(z == 0.0 && (x.hypot(y) - 1.0).abs() <= f32::EPSILON && w.abs() == 1.0);
        }
    }

    /// Returns a flat fan of `count` triangles around vertex 0, with the plane's own coordinates as texture
    /// coordinates.
    fn fan(count: u32) -> Mesh {
        let rim = (0..=count).map(|i| std::f64::consts::PI * f64::from(i) / f64::from(count));
        let rim = rim.map(|angle| [angle.cos() as f32, angle.sin() as f32, 0.0]);
        let positions: Vec<[f32; 3]> = std::iter::once([0.0; 3]).chain(rim).collect();
        Mesh {
            tex_coords: vec![Buffer::from(
                positions.iter().map(|p| [p[0], -p[1]]).collect::<Vec<_>>(),
            )],
            normals: Some(Buffer::from(vec![[0.0, 0.0, 1.0]; positions.len()])),
            positions: Buffer::from(positions),
            triangles: Buffer::from((0..count).map(|i| [0, i + 1, i + 2]).collect::<Vec<_>>()),
            ..Mesh::default()
        }
    }

    #[test]
    fn vertex_with_many_triangles_is_processed_in_linear_time() {
        const STACK: usize = 1 << 18;
        for count in [
            MAX_VERTEX_TRIANGLES as u32,
            MAX_VERTEX_TRIANGLES as u32 + 1,
            100_000,
        ] {
            let on_a_small_stack = std::thread::Builder::new().stack_size(STACK);
            let made = on_a_small_stack.spawn(move || fan(count).with_tangents(0));
            let mesh = made.unwrap().join().unwrap();
            for &[x, .., w] in tangents(&mesh) {
                assert!(x > 0.999 && w == 1.0, "{count} triangles: {x} {w}");
            }
        }
    }
}
