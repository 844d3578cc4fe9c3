//! Meshes for tests, generated in code.

use std::f64::consts::FRAC_PI_3;

use glam::{DAffine3, DVec3, Vec3};
use whit::mesh::Mesh;

/// Returns a rectangle in the plane z = 0 around the origin, facing +z.
pub fn rectangle(width: f32, height: f32) -> Mesh {
    let (x, y) = (0.5 * width, 0.5 * height);
    Mesh {
        positions: vec![[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]].into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]].into(),
        ..Mesh::default()
    }
}

/// Returns a rectangle with two sets of coordinates that leave [0, 1] on all sides, and vertex colours.
pub fn textured_panel() -> Mesh {
    Mesh {
        tex_coords: vec![
            vec![[-0.71, 1.83], [2.13, 1.62], [1.94, -0.57], [-0.86, -0.43]].into(),
            vec![[-0.22, -0.35], [1.31, -0.27], [1.24, 1.19], [-0.31, 1.28]].into(),
        ],
        colors: Some(
            vec![
                [1.0, 0.9, 0.8, 1.0],
                [0.6, 1.0, 0.7, 1.0],
                [0.9, 0.7, 1.0, 0.2],
                [1.0; 4],
            ]
            .into(),
        ),
        ..rectangle(1.0, 0.96)
    }
}

/// Returns a flat-shaded wedge without any symmetry, so that a mirrored one is recognised.
pub fn wedge() -> Mesh {
    Mesh {
        positions: vec![
            [0.0, 0.0, 0.0],
            [1.0, 0.05, 0.0],
            [0.1, 0.0, 0.7],
            [0.2, 1.3, 0.15],
        ]
        .into(),
        triangles: vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]].into(),
        ..Mesh::default()
    }
}

/// Returns the cube [-1, 1]³, each face as two triangles that face outward.
pub fn cube() -> Mesh {
    let corner = |i: u32| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 1.0 } else { -1.0 });
    let faces = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let triangles: Vec<[u32; 3]> = faces
        .into_iter()
        .flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
        .collect();
    Mesh {
        positions: (0..8).map(corner).collect::<Vec<[f32; 3]>>().into(),
        triangles: triangles.into(),
        ..Mesh::default()
    }
}

/// Returns a prism along z with an equilateral base of circumradius 1.
pub fn prism() -> Mesh {
    let corner = |i: u32| {
        let (sin, cos) = (f64::from(i % 3) * 2.0 * FRAC_PI_3 + 0.5 * FRAC_PI_3 * 3.0).sin_cos();
        [cos as f32, sin as f32, if i < 3 { -1.0 } else { 1.0 }]
    };
    Mesh {
        positions: (0..6).map(corner).collect::<Vec<[f32; 3]>>().into(),
        triangles: vec![
            [0, 2, 1],
            [3, 4, 5],
            [0, 1, 4],
            [0, 4, 3],
            [1, 2, 5],
            [1, 5, 4],
            [2, 0, 3],
            [2, 3, 5],
        ]
        .into(),
        ..Mesh::default()
    }
}

/// Returns the mesh with reversed orientation, as a cavity.
pub fn inverted(mesh: Mesh) -> Mesh {
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
    Mesh {
        triangles: triangles.into(),
        ..mesh
    }
}

/// Kind of normals of a mesh.
#[derive(Clone, Copy, PartialEq)]
pub enum Shading {
    Flat,
    Smooth,
}

/// Returns the unit sphere as 20 · 4^`level` triangles: an icosahedron, each triangle subdivided into four repeatedly.
pub fn ball(level: u32, shading: Shading) -> Mesh {
    let mut triangles = icosahedron();
    for _ in 0..level {
        let cut = |[a, b, c]: [DVec3; 3]| {
            let [ab, bc, ca] = [a + b, b + c, c + a].map(DVec3::normalize);
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(cut).collect();
    }
    // Corners are shared, so that neighbours have identical edges.
    let mut positions: Vec<[f32; 3]> = Vec::new();
    let mut index_of = |p: DVec3| {
        let near = |q: &[f32; 3]| Vec3::from(*q).as_dvec3().distance(p) < 1e-3;
        let index = positions.iter().position(near).unwrap_or_else(|| {
            positions.push(p.as_vec3().to_array());
            positions.len() - 1
        });
        index as u32
    };
    let triangles: Vec<[u32; 3]> = triangles.into_iter().map(|t| t.map(&mut index_of)).collect();
    let normals = (shading == Shading::Smooth).then(|| positions.clone().into());
    Mesh {
        positions: positions.into(),
        triangles: triangles.into(),
        normals,
        ..Mesh::default()
    }
}

/// Returns the mesh with normals computed from its positions.
pub fn with_normals(mesh: Mesh, normal: impl Fn([f32; 3]) -> [f32; 3]) -> Mesh {
    let normals: Vec<[f32; 3]> = mesh.positions.iter().map(|&p| normal(p)).collect();
    Mesh {
        normals: Some(normals.into()),
        ..mesh
    }
}

fn icosahedron() -> Vec<[DVec3; 3]> {
    let golden = 2.0 * (0.6 * FRAC_PI_3).cos();
    let turn = DAffine3::from_rotation_x(0.37) * DAffine3::from_rotation_y(0.21);
    let mut corners = Vec::new();
    for (a, b) in [(1.0, golden), (1.0, -golden), (-1.0, golden), (-1.0, -golden)] {
        for p in [
            DVec3::new(0.0, a, b),
            DVec3::new(a, b, 0.0),
            DVec3::new(b, 0.0, a),
        ] {
            corners.push(turn.transform_vector3(p.normalize()));
        }
    }
    // The edge of an icosahedron in the unit sphere is 1.05 long; the next distance is 1.70.
    let adjacent = |a: DVec3, b: DVec3| a.distance(b) < 1.3;
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let [a, b, c] = [i, j, k].map(|corner: usize| corners[corner]);
                if adjacent(a, b) && adjacent(b, c) && adjacent(c, a) {
                    let outward = (b - a).cross(c - a).dot(a) > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    triangles
}
