//! A closed, displaced sphere of any number of triangles, used to measure speed against mesh size.
//!
//! It is a cube with n by n squares a face, projected onto a sphere and displaced: its vertices are shared across all
//! edges, so it is closed, it has no poles, and no triangle is degenerate.

use std::f64::consts::FRAC_PI_4;

use glam::DVec3;

use super::Mesh;

/// Displacement waves: direction and frequency of a plane wave, and its amplitude. Few enough for speed, without a
/// common period.
const WAVES: [(DVec3, f64); 6] = [
    (DVec3::new(4.1, 1.7, -2.3), 0.022),
    (DVec3::new(-2.9, 5.3, 3.1), 0.016),
    (DVec3::new(7.9, -6.1, 4.7), 0.010),
    (DVec3::new(-11.3, 3.7, 13.9), 0.006),
    (DVec3::new(19.1, 23.3, -9.7), 0.0035),
    (DVec3::new(-31.7, -17.9, 37.1), 0.002),
];

/// Returns a displaced sphere of about unit radius about the origin with shading normals. The number of triangles is 12
/// n² for an integer n, close to `triangle_count` and at least 12.
pub fn bumpy_sphere(triangle_count: u64) -> Mesh {
    let edge = ((triangle_count as f64 / 12.0).sqrt().round() as u32).max(1);
    let cube = BumpyCube { edge };
    let mut positions = Vec::with_capacity(6 * (edge as usize).pow(2) + 2);
    let mut normals = Vec::with_capacity(positions.capacity());
    cube.for_each_point(|point| {
        let (position, normal) = bumpy(cube.direction(point));
        positions.push(position.as_vec3().to_array());
        normals.push(normal.as_vec3().to_array());
    });
    Mesh {
        positions: positions.into(),
        triangles: cube.triangles().into(),
        normals: Some(normals.into()),
        ..Mesh::default()
    }
}

/// Numbered lattice points on the surface of a cube of `edge` squares along each edge.
struct BumpyCube {
    edge: u32,
}

impl BumpyCube {
    /// Returns the triangles of all faces. A face is given by its fixed axis and side; the other two axes follow in
    /// cyclic order, so that u x v points along the axis and the winding is outward on the far side.
    fn triangles(&self) -> Vec<[u32; 3]> {
        let edge = self.edge;
        let mut triangles = Vec::with_capacity(12 * (edge as usize).pow(2));
        for (axis, far) in (0..3).flat_map(|axis| [(axis, false), (axis, true)]) {
            for v in 0..edge {
                for u in 0..edge {
                    let corner = |du: u32, dv: u32| {
                        let mut point = [0; 3];
                        point[axis] = if far { edge } else { 0 };
                        point[(axis + 1) % 3] = u + du;
                        point[(axis + 2) % 3] = v + dv;
                        self.number(point)
                    };
                    let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    let turned = |[a, b, c]: [u32; 3]| if far { [a, b, c] } else { [a, c, b] };
                    triangles.extend([[a, b, c], [a, c, d]].map(turned));
                }
            }
        }
        triangles
    }

    /// Visits every surface point once, in the order of [`BumpyCube::number`].
    fn for_each_point(&self, mut visit: impl FnMut([u32; 3])) {
        let n = self.edge;
        // Bottom and top faces
        for z in [0, n] {
            for y in 0..=n {
                for x in 0..=n {
                    visit([x, y, z]);
                }
            }
        }
        // Rings around the sides
        for z in 1..n {
            (0..n).for_each(|i| visit([i, 0, z]));
            (0..n).for_each(|i| visit([n, i, z]));
            (0..n).for_each(|i| visit([n - i, n, z]));
            (0..n).for_each(|i| visit([0, n - i, z]));
        }
    }

    /// Returns the number of a surface point: bottom, top, then rings around the sides.
    fn number(&self, [x, y, z]: [u32; 3]) -> u32 {
        let n = self.edge;
        let lid = (n + 1) * (n + 1);
        if z == 0 {
            return y * (n + 1) + x;
        }
        if z == n {
            return lid + y * (n + 1) + x;
        }
        // Go around the ring, in the order of [`BumpyCube::for_each_point`]
        let around = if y == 0 && x < n {
            x
        } else if x == n && y < n {
            n + y
        } else if y == n && x > 0 {
            2 * n + (n - x)
        } else {
            3 * n + (n - y)
        };
        2 * lid + (z - 1) * 4 * n + around
    }

    /// Returns the direction of a surface point; the tangent equalises the sizes of the triangles.
    fn direction(&self, point: [u32; 3]) -> DVec3 {
        let warped = point.map(|i| (FRAC_PI_4 * (2.0 * f64::from(i) / f64::from(self.edge) - 1.0)).tan());
        DVec3::from(warped).normalize()
    }
}

/// Returns point and normal of the surface p = r(d) d: the normal is r d minus the tangential gradient of r.
fn bumpy(d: DVec3) -> (DVec3, DVec3) {
    let mut radius = 1.0;
    let mut gradient = DVec3::ZERO;
    for (k, height) in WAVES {
        let (sine, cosine) = k.dot(d).sin_cos();
        radius += height * sine;
        gradient += height * cosine * k;
    }
    let normal = radius * d - (gradient - gradient.dot(d) * d);
    (radius * d, normal.normalize())
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use glam::Vec3;

    use super::*;

    #[test]
    fn bumpy_sphere_is_closed_and_faces_outward() {
        for (wished, edge) in [(1, 1), (12, 1), (1000, 9), (10_000, 29)] {
            let mesh = bumpy_sphere(wished);
            assert_eq!(mesh.triangles.len(), 12 * edge * edge, "{wished}");
            assert_eq!(mesh.positions.len(), 6 * edge * edge + 2, "{wished}");
            // Each side of a triangle is shared with one other, in opposite direction.
            let mut sides = HashMap::new();
            for [a, b, c] in mesh.triangles.iter().copied() {
                for side in [[a, b], [b, c], [c, a]] {
                    *sides.entry(side).or_insert(0) += 1;
                }
            }
            assert!(
                sides
                    .iter()
                    .all(|(&[a, b], &count)| count == 1 && sides.contains_key(&[b, a]))
            );
            for number in 0..mesh.triangles.len() as u32 {
                let [a, b, c] = mesh.corners(number);
                assert!((b - a).cross(c - a).dot(a) > 0.0, "{number} of {wished}");
            }
        }
    }

    #[test]
    fn bumpy_sphere_normals_match_small_triangles() {
        let mesh = bumpy_sphere(100_000);
        let normals = mesh.normals.as_ref().unwrap();
        for number in 0..mesh.triangles.len() as u32 {
            let [a, b, c] = mesh.corners(number);
            let flat = (b - a).cross(c - a).normalize();
            for corner in mesh.triangles[number as usize] {
                // Points of a triangle are at most 1/40 apart, and the curvatures add up to at most 15: 0.375 radians,
                // whose cosine is 0.93.
                assert!(flat.dot(Vec3::from(normals[corner as usize])) > 0.93, "{number}");
            }
        }
    }
}
