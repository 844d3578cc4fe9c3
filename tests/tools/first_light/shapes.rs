//! Tessellated shapes.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

/// Vertices and triangles of a shape.
#[derive(Default)]
pub(crate) struct Tessellation {
    pub(crate) positions: Vec<DVec3>,
    pub(crate) normals: Vec<DVec3>,
    /// One per vertex, or none where no texture is used.
    pub(crate) tex_coords: Vec<[f64; 2]>,
    pub(crate) triangles: Vec<[u16; 3]>,
}

/// Returns a grid of `columns` by `rows` quads; `wraps` says of each axis whether its end is joined to its beginning.
fn grid(
    columns: u16,
    rows: u16,
    wraps: [bool; 2],
    mut vertex: impl FnMut(f64, f64) -> (DVec3, DVec3, Option<[f64; 2]>),
) -> Tessellation {
    let mut t = Tessellation::default();
    let counts = [columns + u16::from(!wraps[0]), rows + u16::from(!wraps[1])];
    for j in 0..counts[1] {
        for i in 0..counts[0] {
            let (p, n, uv) = vertex(f64::from(i) / f64::from(columns), f64::from(j) / f64::from(rows));
            t.positions.push(p);
            t.normals.push(n);
            t.tex_coords.extend(uv);
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let number = |di: u16, dj: u16| (j + dj) % counts[1] * counts[0] + (i + di) % counts[0];
            let [a, b, c, d] = [number(0, 0), number(1, 0), number(1, 1), number(0, 1)];
            t.triangles.push([a, b, c]);
            t.triangles.push([a, c, d]);
        }
    }
    t
}

/// Returns the unit sphere, closed: one vertex at each pole and no seam.
pub(crate) fn sphere() -> Tessellation {
    const COLUMNS: u16 = 48;
    const ROWS: u16 = 24;
    let mut t = Tessellation::default();
    let mut push = |d: DVec3| {
        t.positions.push(d);
        t.normals.push(d);
    };
    push(DVec3::Y);
    for j in 1..ROWS {
        let polar = PI * f64::from(j) / f64::from(ROWS);
        for i in 0..COLUMNS {
            let around = TAU * f64::from(i) / f64::from(COLUMNS);
            push(DVec3::new(
                polar.sin() * around.sin(),
                polar.cos(),
                polar.sin() * around.cos(),
            ));
        }
    }
    push(DVec3::NEG_Y);
    let ring = |j: u16, i: u16| 1 + (j - 1) * COLUMNS + i % COLUMNS;
    let south = 1 + (ROWS - 1) * COLUMNS;
    for i in 0..COLUMNS {
        t.triangles.push([0, ring(1, i), ring(1, i + 1)]);
        for j in 1..ROWS - 1 {
            let [a, b, c, d] = [ring(j, i), ring(j + 1, i), ring(j + 1, i + 1), ring(j, i + 1)];
            t.triangles.push([a, b, c]);
            t.triangles.push([a, c, d]);
        }
        t.triangles
            .push([ring(ROWS - 1, i), south, ring(ROWS - 1, i + 1)]);
    }
    t
}

/// Returns the cube from -1 to 1, with sharp edges.
pub(crate) fn block() -> Tessellation {
    let mut t = Tessellation::default();
    for n in [
        DVec3::X,
        DVec3::NEG_X,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::Z,
        DVec3::NEG_Z,
    ] {
        let u = if n.x == 0.0 { DVec3::X } else { DVec3::Y };
        let v = n.cross(u);
        let first = t.positions.len() as u16;
        for [s, r] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            t.positions.push(n + s * u + r * v);
            t.normals.push(n);
        }
        t.triangles.push([first, first + 1, first + 2]);
        t.triangles.push([first, first + 2, first + 3]);
    }
    t
}

/// Returns a closed tube of radius `thickness` around a closed curve.
pub(crate) fn tube(columns: u16, rows: u16, thickness: f64, curve: fn(f64) -> DVec3) -> Tessellation {
    const STEP: f64 = 1e-4;
    grid(columns, rows, [true, true], |u, v| {
        let (t, around) = (TAU * u, TAU * v);
        let (before, here, after) = (curve(t - STEP), curve(t), curve(t + STEP));
        let tangent = (after - before).normalize();
        // No curve here runs towards the origin, so this direction is never parallel to the tangent.
        let inward = -here;
        let side = tangent.cross(inward).normalize();
        let out = side.cross(tangent);
        let n = around.cos() * out - around.sin() * side;
        (here + thickness * n, n, None)
    })
}

/// Returns the point of the (2, 3) torus knot at `t` from 0 to 2 pi.
pub(crate) fn trefoil(t: f64) -> DVec3 {
    let radius = 1.6 + 0.75 * (3.0 * t).cos();
    DVec3::new(
        radius * (2.0 * t).cos(),
        radius * (2.0 * t).sin(),
        0.9 * (3.0 * t).sin(),
    )
}

/// Returns a square of 40 by 40 on which a texture repeats every 2.
pub(crate) fn floor() -> Tessellation {
    grid(1, 1, [false, false], |u, v| {
        let (x, z) = (40.0 * u - 20.0, 20.0 - 40.0 * v);
        (DVec3::new(x, 0.0, z), DVec3::Y, Some([0.5 * x, 0.5 * z]))
    })
}

/// Returns a dome of radius 1 from the zenith to slightly below the horizon, seen from inside; v runs down.
pub(crate) fn sky() -> Tessellation {
    const COLUMNS: u16 = 32;
    const ROWS: u16 = 10;
    let mut t = grid(COLUMNS, ROWS - 1, [true, false], |u, row| {
        let v = (1.0 + row * f64::from(ROWS - 1)) / f64::from(ROWS);
        let (around, polar) = (-TAU * u, v * 0.51 * PI);
        let d = DVec3::new(
            polar.sin() * around.cos(),
            polar.cos(),
            polar.sin() * around.sin(),
        );
        (d, -d, Some([0.5, v]))
    });
    let zenith = t.positions.len() as u16;
    t.positions.push(DVec3::Y);
    t.normals.push(DVec3::NEG_Y);
    t.tex_coords.push([0.5, 0.0]);
    for i in 0..COLUMNS {
        t.triangles.push([zenith, (i + 1) % COLUMNS, i]);
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_is_wound_outward() {
        for (name, t) in [
            ("sphere", sphere()),
            ("block", block()),
            ("floor", floor()),
            ("sky", sky()),
        ]
        .into_iter()
        .chain([
            ("knot", tube(128, 10, 0.26, trefoil)),
            ("ring", tube(40, 16, 0.34, |t| DVec3::new(t.cos(), 0.0, t.sin()))),
        ]) {
            for triangle in &t.triangles {
                let [a, b, c] = triangle.map(|v| t.positions[v as usize]);
                let n = t.normals[triangle[0] as usize];
                assert!((b - a).cross(c - a).dot(n) > 0.0, "{name} {triangle:?}");
            }
        }
    }
}
