//! Meshes in a scene file: vertices and convex polygons, which are split into fans of triangles.

use glam::{DVec3, Vec3};
use schemars::JsonSchema;
use serde::Deserialize;

use super::shape_diagnostic::ShapeDiagnostic;
use super::value::{Located, Vector};
use crate::buffer::Buffer;
use crate::mesh::Mesh;
use crate::numeric::Bounds;

/// A mesh of convex polygons.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PolygonsForm {
    /// Vertices of the mesh.
    vertices: Vec<Vector>,
    /// Faces as lists of vertex numbers from 0, counter-clockwise seen from the front; flat and convex.
    faces: Vec<Located<Vec<u32>>>,
    /// Texture coordinates, as many as vertices.
    uv: Option<Vec<[f32; 2]>>,
    /// Smooth shading over all faces, with normals averaged at the vertices.
    #[serde(default)]
    smooth: bool,
}

/// Largest distance of a vertex from its face's plane, relative to the mesh's size: the rounding error of numbers
/// written with six digits.
const FLATNESS: f64 = 1.0 / (1 << 20) as f64;

impl PolygonsForm {
    pub(super) fn mesh(&self) -> Result<Mesh, ShapeDiagnostic> {
        let count = self.vertices.len();
        // Check the texture coordinates
        if let Some(uv) = &self.uv
            && (uv.len() != count || !uv.as_flattened().iter().all(|x| x.is_finite()))
        {
            return Err(format!(
                "has {} texture coordinates for {count} vertices, or not all finite: give a finite pair for each",
                uv.len()
            )
            .into());
        }
        // Triangulate the faces
        let points: Vec<DVec3> = self.vertices.iter().map(|v| v.0).collect();
        let slack = FLATNESS * Bounds::of_points(points.iter().copied()).extent().max_element();
        let mut triangles = Vec::new();
        for (number, face) in self.faces.iter().enumerate() {
            let fan = fan(&points, face, slack).map_err(|fault| ShapeDiagnostic {
                span: Some(face.span.clone()),
                sentence: format!("face {} of the mesh {fault}", number + 1),
            })?;
            triangles.extend(fan);
        }
        // Round the vertices, and remove triangles that lose their area
        let positions: Vec<[f32; 3]> = points.iter().map(|p| p.as_vec3().to_array()).collect();
        triangles.retain(|&triangle| has_area(&positions, triangle));
        if triangles.is_empty() {
            return Err(String::from("is a mesh without a face: give `faces`").into());
        }
        Ok(Mesh {
            normals: self.smooth.then(|| smooth_normals(&points, &triangles)),
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
            tex_coords: self.uv.iter().map(|uv| Buffer::from(uv.clone())).collect(),
            ..Mesh::default()
        })
    }
}

/// Returns the triangles of a flat convex polygon, all from its first vertex.
fn fan(points: &[DVec3], face: &[u32], slack: f64) -> Result<Vec<[u32; 3]>, String> {
    if let Some(bad) = face.iter().find(|v| **v as usize >= points.len()) {
        return Err(format!(
            "refers to vertex {bad} of {}: correct the number",
            points.len()
        ));
    }
    if face.len() < 3 {
        return Err(format!("has {} vertices: give at least three", face.len()));
    }
    let corner = |i: usize| points[face[i % face.len()] as usize];
    // Newell's normal, twice as long as the area.
    let normal: DVec3 = (1..face.len() - 1)
        .map(|i| (corner(i) - corner(0)).cross(corner(i + 1) - corner(0)))
        .sum();
    let Some(n) = normal.try_normalize() else {
        return Err("has no area: give vertices that are not on one line".into());
    };
    // Check that all vertices are in the plane
    if (0..face.len()).any(|i| (corner(i) - corner(0)).dot(n).abs() > slack) {
        return Err("is not flat: split it or move its vertices onto one plane".into());
    }
    // In a convex polygon all corners turn left, and all the fan's triangles are on one side: a dent fails the first
    // test, a star the second.
    let turns_right = |a: DVec3, b: DVec3| a.cross(b).dot(n) < -slack * (a.length() + b.length());
    let has_dent =
        (0..face.len()).any(|i| turns_right(corner(i + 1) - corner(i), corner(i + 2) - corner(i + 1)));
    let crosses = (1..face.len() - 1).any(|i| turns_right(corner(i) - corner(0), corner(i + 1) - corner(0)));
    if has_dent || crosses {
        return Err("is not convex: split it into convex faces".into());
    }
    Ok((1..face.len() - 1)
        .map(|i| [face[0], face[i], face[i + 1]])
        .collect())
}

/// Returns whether a triangle has an area after its corners were rounded. Corners on an edge of a polygon give some
/// that have none.
fn has_area(positions: &[[f32; 3]], triangle: [u32; 3]) -> bool {
    let [a, b, c] = triangle.map(|v| Vec3::from(positions[v as usize]).as_dvec3());
    (b - a).cross(c - a) != DVec3::ZERO
}

/// Returns the normals of the vertices: the area-weighted means of the triangles around them.
fn smooth_normals(points: &[DVec3], triangles: &[[u32; 3]]) -> Buffer<[f32; 3]> {
    let mut sums = vec![DVec3::ZERO; points.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|v| points[v as usize]);
        for &v in triangle {
            sums[v as usize] += (b - a).cross(c - a);
        }
    }
    // A vertex without a face, or of opposite ones, gets an arbitrary normal.
    let normal = |sum: DVec3| sum.try_normalize().unwrap_or(DVec3::Z).as_vec3().to_array();
    Buffer::from(sums.into_iter().map(normal).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;

    fn mesh(text: &str) -> Result<Mesh, String> {
        from_text::<PolygonsForm>(text)
            .unwrap()
            .mesh()
            .map_err(|fault| fault.sentence)
    }

    #[test]
    fn pentagon_is_split_into_three_triangles_of_equal_total_area() {
        // Place the corners on the unit circle
        let corners: Vec<String> = (0..5)
            .map(|i| {
                let (y, x) = (f64::from(i) * std::f64::consts::TAU / 5.0).sin_cos();
                format!("[{x}, {y}, 0]")
            })
            .collect();
        let text = |order: &str| format!("vertices = [{}]\nfaces = [{order}]", corners.join(", "));
        let pentagon = mesh(&text("[0, 1, 2, 3, 4]")).unwrap();
        assert_eq!(&pentagon.triangles[..], [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        // The same corners as a star turn left everywhere, but go round twice.
        assert!(
            mesh(&text("[0, 2, 4, 1, 3]"))
                .unwrap_err()
                .contains("is not convex")
        );
    }

    #[test]
    fn collinear_corner_keeps_a_face_convex() {
        let square =
            mesh("vertices = [[0,0,0],[1,0,0],[2,0,0],[2,2,0],[0,2,0]]\nfaces = [[0,1,2,3,4]]").unwrap();
        assert_eq!(square.triangles.len(), 2);
    }

    #[test]
    fn non_convex_faces_are_rejected() {
        let vertices = "vertices = [[0,0,0],[2,0,0],[2,2,0],[1.5,0.5,0],[0,2,0.5]]\n";
        for (faces, words) in [
            ("[[0, 1, 7]]", "face 1 of the mesh refers to vertex 7 of 5"),
            ("[[0, 1]]", "has 2 vertices"),
            ("[[0, 1, 2], [0, 1, 1]]", "face 2 of the mesh has no area"),
            ("[[0, 1, 2, 4]]", "is not flat"),
            ("[[0, 1, 3, 2]]", "is not convex"),
            ("[]", "without a face"),
        ] {
            let error = mesh(&format!("{vertices}faces = {faces}")).unwrap_err();
            assert!(error.contains(words), "{faces}: {error}");
        }
    }

    #[test]
    fn smooth_normals_are_normalised_means_of_adjacent_faces() {
        let roof =
            mesh("smooth = true\nvertices = [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]\nfaces = [[0,1,2],[0,2,3]]")
                .unwrap();
        // Faces of equal size toward +z and +x share vertex 0.
        let [x, y, z] = roof.normals.unwrap()[0];
        assert!((x - z).abs() < 1e-6 && y == 0.0 && (x * x + z * z - 1.0).abs() < 1e-6);
    }
}
