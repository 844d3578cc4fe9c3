//! Closed test meshes, and test scenes of one or more geometries.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::mesh::Mesh;
use crate::numeric::SplitMix64;
use crate::scene::{Geometry, Instance, Material, Scene};
use crate::shape::{Cone, Cylinder, HalfSpace, Polyhedron, Shape, Sphere};

/// Returns a mesh of the vertices and triangles, with positions rounded to f32.
pub(in crate::verify) fn mesh(positions: &[DVec3], triangles: Vec<[u32; 3]>) -> Mesh {
    let positions: Vec<[f32; 3]> = positions.iter().map(|p| p.as_vec3().to_array()).collect();
    Mesh {
        positions: positions.into(),
        triangles: triangles.into(),
        ..Mesh::default()
    }
}

/// Returns the vertices of a box and its triangles, two a side, with vertex indices from `first` on.
pub(in crate::verify) fn box_of([low, high]: [DVec3; 2], first: u32) -> ([DVec3; 8], Vec<[u32; 3]>) {
    // Outward quads; bit k of a vertex index chooses the upper end along axis k
    const SIDES: [[u32; 4]; 6] = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let at = |corner: usize, axis: usize| {
        if corner >> axis & 1 == 1 {
            high[axis]
        } else {
            low[axis]
        }
    };
    let corners = std::array::from_fn(|corner| DVec3::new(at(corner, 0), at(corner, 1), at(corner, 2)));
    let faces = SIDES.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let numbered = faces.map(|face| face.map(|corner| first + corner));
    (corners, numbered.collect())
}

/// Returns convex solids that contain the ball of radius 1/4 about the origin.
pub(in crate::verify) fn convex_solids() -> Vec<Shape> {
    // Face normals of a regular tetrahedron
    let normals = [
        DVec3::ONE,
        DVec3::new(-1.0, -1.0, 1.0),
        DVec3::new(-1.0, 1.0, -1.0),
        DVec3::new(1.0, -1.0, -1.0),
    ];
    let tetrahedron = Polyhedron::from_half_spaces(&normals.map(|n| HalfSpace { n, h: 1.0 }));
    let mut solids = vec![
        Shape::Sphere(Sphere::UNIT),
        Shape::Cube,
        Shape::Cylinder(Cylinder { capped: true }),
        Shape::Cone(Cone { capped: true }),
    ];
    solids.extend(tetrahedron.ok().map(|solid| Shape::Polyhedron(Arc::new(solid))));
    solids
}

/// Returns a scene of one material with one untransformed instance of each geometry.
pub(in crate::verify) fn scene(geometries: Vec<Geometry>) -> Scene {
    let instances = (0..geometries.len() as u32)
        .filter_map(|i| Instance::new("", i, 0, DAffine3::IDENTITY).ok())
        .collect();
    Scene {
        geometries,
        instances,
        materials: vec![Material::default()],
        ..Scene::default()
    }
}

/// Returns a scene of one material with one instance of a shape; `None` if the transform has no inverse.
pub(in crate::verify) fn placed(shape: Shape, world_from_object: DAffine3) -> Option<Scene> {
    let mut scene = scene(vec![Geometry::Shape(shape)]);
    scene.instances = vec![Instance::new("", 0, 0, world_from_object).ok()?];
    Some(scene)
}

/// Returns a mesh of triangles that share no vertices.
pub(in crate::verify) fn soup(triangles: &[[DVec3; 3]]) -> Mesh {
    let faces = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
    mesh(triangles.as_flattened(), faces.collect())
}

/// Number of shapes around the tested one, so that the acceleration structure has several nodes.
const OTHERS: u64 = 24;

/// Returns a scene of a shape within `radius` of `center`, untransformed, and small spheres around it.
pub(in crate::verify) fn among_others(shape: Shape, center: DVec3, radius: f64) -> Scene {
    let others = (0..OTHERS).map(|number| {
        let mut random = SplitMix64::new(0, number);
        Shape::Sphere(Sphere {
            center: center + radius * random.within(2.0, 4.0) * random.direction(),
            radius: 0.01 * radius,
        })
    });
    scene(
        std::iter::once(shape)
            .chain(others)
            .map(Geometry::Shape)
            .collect(),
    )
}

/// Returns a latitude-longitude sphere with `rings` rings and `2 rings` columns, about `4 rings²` triangles; `radius`
/// is a function of the polar angle and the azimuth, in radians.
pub(in crate::verify) fn rings(rings: u32, center: DVec3, radius: impl Fn(f64, f64) -> f64) -> Mesh {
    let columns = 2 * rings;
    let at = |ring: u32, column: u32| {
        let theta = PI * f64::from(ring) / f64::from(rings);
        let phi = TAU * f64::from(column) / f64::from(columns);
        let (sin, cos) = theta.sin_cos();
        center + radius(theta, phi) * DVec3::new(sin * phi.cos(), cos, sin * phi.sin())
    };
    // Place one vertex at each pole and the rings between
    let mut positions = vec![at(0, 0)];
    for ring in 1..rings {
        positions.extend((0..columns).map(|column| at(ring, column)));
    }
    positions.push(at(rings, 0));
    let last = positions.len() as u32 - 1;
    let index = |ring: u32, column: u32| 1 + (ring - 1) * columns + column % columns;
    // Triangulate pole caps and bands
    let mut triangles = Vec::new();
    for column in 0..columns {
        triangles.push([0, index(1, column + 1), index(1, column)]);
        triangles.push([last, index(rings - 1, column), index(rings - 1, column + 1)]);
        for ring in 1..rings - 1 {
            let [a, b] = [index(ring, column), index(ring, column + 1)];
            let [c, d] = [index(ring + 1, column), index(ring + 1, column + 1)];
            triangles.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh(&positions, triangles)
}

/// Returns the vertices and faces of an icosahedron inscribed in the unit sphere.
pub(in crate::verify) fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    // Place the vertices of three golden rectangles
    let mut corners = Vec::new();
    for (a, b) in [(1.0, golden), (-1.0, golden), (1.0, -golden), (-1.0, -golden)] {
        corners.extend([
            DVec3::new(a, b, 0.0),
            DVec3::new(0.0, a, b),
            DVec3::new(b, 0.0, a),
        ]);
    }
    // Find faces as triples of mutual edges: edges have length 2, all other distances are longer. Orient faces
    // counterclockwise as seen from outside.
    let is_edge = |i: usize, j: usize| corners[i].distance_squared(corners[j]) < 5.0;
    let mut faces = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if is_edge(i, j) && is_edge(j, k) && is_edge(k, i) {
                    let [a, b, c] = [i, j, k].map(|n| corners[n]);
                    let face = if a.dot((b - a).cross(c - a)) > 0.0 {
                        [i, j, k]
                    } else {
                        [i, k, j]
                    };
                    faces.push(face.map(|n| n as u32));
                }
            }
        }
    }
    (corners.iter().map(|p| p.normalize()).collect(), faces)
}

/// Returns an icosahedron whose faces are subdivided into four `levels` times and projected onto the unit sphere.
pub(in crate::verify) fn icosphere(levels: u32) -> Mesh {
    let (mut corners, mut faces) = icosahedron();
    for _ in 0..levels {
        // Share the midpoint of an edge between its two faces
        let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                corners.push((corners[a as usize] + corners[b as usize]).normalize());
                corners.len() as u32 - 1
            })
        };
        // Split each face into four
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let [p, q, r] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
            })
            .collect();
    }
    mesh(&corners, faces)
}

/// Returns the surface of the cube from 0 to `n` along each axis, in unit squares cut along alternating diagonals, with
/// integer vertices.
pub(in crate::verify) fn lattice_cube(n: u32) -> Mesh {
    let mut numbers: HashMap<[u32; 3], u32> = HashMap::new();
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for end in [0, n] {
            for square in 0..n * n {
                let (i, j) = (square % n, square / n);
                // Share vertices between squares and sides
                let mut corner = |i: u32, j: u32| {
                    let mut p = [0; 3];
                    (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (end, i, j);
                    *numbers.entry(p).or_insert_with(|| {
                        positions.push(DVec3::from_array(p.map(f64::from)));
                        positions.len() as u32 - 1
                    })
                };
                let [a, b, c, d] = [
                    corner(i, j),
                    corner(i + 1, j),
                    corner(i + 1, j + 1),
                    corner(i, j + 1),
                ];
                // Alternate the diagonal, as on a chessboard
                let halves = if (i + j) % 2 == 0 {
                    [[a, b, c], [a, c, d]]
                } else {
                    [[a, b, d], [b, c, d]]
                };
                // Flip the faces of the lower side, to point outward
                let outward = |[a, b, c]: [u32; 3]| if end == 0 { [a, c, b] } else { [a, b, c] };
                triangles.extend(halves.map(outward));
            }
        }
    }
    mesh(&positions, triangles)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn meshes_are_closed_and_consistently_wound_outward() {
        let center = DVec3::new(3.0, -2.0, 5.0);
        let cases = [
            (rings(9, center, |_, _| 2.0), center, 2 * 18 * 8),
            (icosphere(0), DVec3::ZERO, 20),
            (icosphere(2), DVec3::ZERO, 20 * 16),
            (lattice_cube(5), DVec3::splat(2.5), 6 * 25 * 2),
        ];
        for (mesh, center, count) in cases {
            // Check the number of triangles
            assert_eq!(mesh.triangles.len(), count);
            // Check that each edge occurs once in either direction
            let edges: HashSet<[u32; 2]> = mesh
                .triangles
                .iter()
                .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
                .collect();
            assert_eq!(edges.len(), 3 * count, "an edge is there twice");
            assert!(
                edges.iter().all(|&[a, b]| edges.contains(&[b, a])),
                "an edge is open"
            );
            // Check the orientation of the faces
            for face in 0..count as u32 {
                let [a, b, c] = mesh.corners_f64(face);
                assert!((a - center).dot((b - a).cross(c - a)) > 0.0, "{face}");
            }
        }
    }
}
