//! Closed cylinder as a triangle mesh.

use std::f64::consts::TAU;

use glam::DVec3;

use super::test_meshes::mesh;
use crate::mesh::Mesh;

/// Number of sides of a cylinder.
pub(in crate::verify) const COLUMNS: u32 = 36;
/// Number of squares along a side.
pub(in crate::verify) const ROWS: u32 = 12;

/// Returns a closed cylinder of that radius and half height about the y axis.
pub(in crate::verify) fn cylinder([radius, half]: [f64; 2]) -> Mesh {
    let at = |row: u32, column: u32| {
        let (sin, cos) = (TAU * f64::from(column) / f64::from(COLUMNS)).sin_cos();
        let y = half * (2.0 * f64::from(row) / f64::from(ROWS) - 1.0);
        DVec3::new(radius * cos, y, radius * sin)
    };
    // Place the vertices of the side, then the centres of both caps
    let mut corners: Vec<DVec3> = (0..=ROWS)
        .flat_map(|row| (0..COLUMNS).map(move |column| at(row, column)))
        .collect();
    corners.extend([-half, half].map(|y| DVec3::new(0.0, y, 0.0)));
    let [bottom, top] = [corners.len() as u32 - 2, corners.len() as u32 - 1];
    let index = |row: u32, column: u32| row * COLUMNS + column % COLUMNS;
    let mut faces = Vec::new();
    // Triangulate caps and side
    for column in 0..COLUMNS {
        faces.push([bottom, index(0, column), index(0, column + 1)]);
        faces.push([top, index(ROWS, column + 1), index(ROWS, column)]);
        for row in 0..ROWS {
            let [a, b] = [index(row, column), index(row, column + 1)];
            let [c, d] = [index(row + 1, column), index(row + 1, column + 1)];
            faces.extend([[a, c, b], [b, c, d]]);
        }
    }
    mesh(&corners, faces)
}
