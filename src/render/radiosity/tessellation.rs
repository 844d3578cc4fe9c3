//! Triangles of analytic shapes, with texture coordinates, in object space.
//!
//! Curved shapes become grids over their two angles, or over an angle and a length, whose vertices lie on the shape. Their
//! flat facets enclose a little less than the shape does.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use crate::mesh::Mesh;
use crate::shape::{Implicit, Polyhedron, Shape};

/// Smallest number of vertices around a circle, with which an inscribed polygon has 97 % of its area.
const MIN_SEGMENTS: f64 = 16.0;
/// Largest number of vertices around a circle, which a shape beside much smaller elements would exceed.
const MAX_SEGMENTS: f64 = 1024.0;

/// Vertices and triangles of a shape, counter-clockwise seen from its positive side.
struct ShapeMesh<'s> {
    shape: &'s Shape,
    positions: Vec<[f32; 3]>,
    tex_coords: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
}

/// Returns a mesh of a shape whose edges are about `spacing` long on curved parts; flat parts have few triangles, which
/// are subdivided later. `None` for planes, which are unbounded, and for general quadrics.
pub(super) fn tessellate(shape: &Shape, spacing: f64) -> Option<Mesh> {
    let segments = |radius: f64| (TAU * radius / spacing).ceil().clamp(MIN_SEGMENTS, MAX_SEGMENTS);
    let mut grid = ShapeMesh::new(shape);
    // Wrap grids around curved shapes, and close them by disks
    match shape {
        Shape::Plane | Shape::Quadric(_) => return None,
        Shape::Quad => grid.push_polygon(&square(0.0), 0),
        Shape::Cube => cube(&mut grid),
        Shape::Polyhedron(polyhedron) => faces(&mut grid, polyhedron),
        Shape::Disk => grid.push_polygon(&circle(0.0, segments(1.0)), 0),
        Shape::Sphere(sphere) => {
            let around = segments(sphere.radius);
            let point = |u: f64, v: f64| {
                let latitude = PI * (v - 0.5);
                // All vertices at a pole are one point
                let is_pole = v <= 0.0 || v >= 1.0;
                let radius = if is_pole { 0.0 } else { latitude.cos() };
                let level = radius * DVec2::from_angle(TAU * u);
                sphere.center + sphere.radius * level.extend(latitude.sin())
            };
            grid.push_patch([around, (0.5 * around).ceil()], point);
        }
        Shape::Cylinder(cylinder) => {
            let around = segments(1.0);
            grid.push_patch([around, wall_rows(spacing)], |u, v| wall_point(u, v, 1.0));
            if cylinder.capped {
                grid.push_polygon(&circle(1.0, around), 1);
                grid.push_polygon(&circle(-1.0, around), 2);
            }
        }
        Shape::Cone(cone) => {
            let around = segments(1.0);
            grid.push_patch([around, wall_rows(spacing)], |u, v| wall_point(u, v, 1.0 - v));
            if cone.capped {
                grid.push_polygon(&circle(-1.0, around), 1);
            }
        }
        Shape::Torus(torus) => {
            let counts = [segments(1.0 + torus.minor_radius), segments(torus.minor_radius)];
            let point = |u: f64, v: f64| {
                let tube = torus.minor_radius * DVec2::from_angle(TAU * v);
                ((1.0 + tube.x) * DVec2::from_angle(TAU * u)).extend(tube.y)
            };
            grid.push_patch(counts, point);
        }
    }
    Some(grid.into_mesh())
}

/// Returns the number of rows of a wall between z = -1 and z = 1.
fn wall_rows(spacing: f64) -> f64 {
    (2.0 / spacing).ceil().clamp(1.0, MAX_SEGMENTS)
}

/// Returns the point of a wall around the z axis at the angle `u`, the height `v` and this distance from the axis.
fn wall_point(u: f64, v: f64, radius: f64) -> DVec3 {
    (radius * DVec2::from_angle(TAU * u)).extend(2.0 * v - 1.0)
}

/// Returns the corners of the square [-1, 1]² at height `z`.
fn square(z: f64) -> [DVec3; 4] {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, z))
}

/// Returns `count` points of the unit circle at height `z`.
fn circle(z: f64, count: f64) -> Vec<DVec3> {
    let angle = |k: u32| TAU * f64::from(k) / count;
    (0..count as u32)
        .map(|k| DVec2::from_angle(angle(k)).extend(z))
        .collect()
}

/// Adds the six faces of the cube.
fn cube(grid: &mut ShapeMesh) {
    for part in 0..6u32 {
        let axis = part as usize / 2;
        let side = 2.0 * f64::from(part % 2) - 1.0;
        // Turn the square so that its normal lies along the axis
        let corners = square(side).map(|p| {
            let mut corner = DVec3::ZERO;
            corner[axis] = p.z;
            corner[(axis + 1) % 3] = p.x;
            corner[(axis + 2) % 3] = p.y;
            corner
        });
        grid.push_polygon(&corners, part);
    }
}

/// Adds the faces of a polyhedron, whose vertices are sorted by their angles around the middles of the faces.
fn faces(grid: &mut ShapeMesh, polyhedron: &Polyhedron) {
    // Collect the different vertices on each face
    let vertices = polyhedron.vertices();
    let size = polyhedron.bounds().extent().max_element();
    let slack = FACE_SLACK * size;
    for (part, face) in (0u32..).zip(polyhedron.half_spaces()) {
        let mut corners: Vec<DVec3> = Vec::new();
        for &vertex in &vertices {
            let is_on_face = (face.n.dot(vertex) - face.h).abs() <= slack;
            if is_on_face && corners.iter().all(|corner| corner.distance(vertex) > slack) {
                corners.push(vertex);
            }
        }
        // Sort them around their middle
        let middle = corners.iter().sum::<DVec3>() / corners.len().max(1) as f64;
        let (s, t) = face.n.any_orthonormal_pair();
        let angle = |p: &DVec3| (*p - middle).dot(t).atan2((*p - middle).dot(s));
        corners.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
        grid.push_polygon(&corners, part);
    }
}

/// Largest distance of a vertex from its face and of equal vertices from each other, relative to the size of the
/// polyhedron: about that of coordinates rounded to f32.
const FACE_SLACK: f64 = 1.0 / (1 << 20) as f64;

impl<'s> ShapeMesh<'s> {
    /// Creates a grid without vertices.
    fn new(shape: &'s Shape) -> ShapeMesh<'s> {
        ShapeMesh {
            shape,
            positions: Vec::new(),
            tex_coords: Vec::new(),
            triangles: Vec::new(),
        }
    }

    /// Adds a vertex and returns its index.
    fn push_vertex(&mut self, p: DVec3, uv: [f64; 2]) -> u32 {
        self.positions.push(p.as_vec3().to_array());
        self.tex_coords.push(uv.map(|x| x as f32));
        self.positions.len() as u32 - 1
    }

    /// Adds the convex polygon that covers `part` of the shape, as a fan around its middle if it has many corners, so that
    /// triangles are not thin. Its front is on the positive side of the shape, whatever the order of the corners.
    fn push_polygon(&mut self, corners: &[DVec3], part: u32) {
        let count = corners.len() as u32;
        if count < 3 {
            return;
        }
        let shape = self.shape;
        let first = self.positions.len() as u32;
        for &corner in corners {
            self.push_vertex(corner, shape.point(corner, part).uv);
        }
        // Turn the front to the positive side
        let across = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let is_front = across.dot(shape.point(corners[0], part).n) >= 0.0;
        let turned = |[a, b, c]: [u32; 3]| if is_front { [a, b, c] } else { [a, c, b] };
        // Split a quadrilateral by its diagonal
        if count <= 4 {
            let fan = (1..count - 1).map(|k| turned([first, first + k, first + k + 1]));
            self.triangles.extend(fan);
            return;
        }
        // Split others into triangles around their middle
        let middle = corners.iter().sum::<DVec3>() / f64::from(count);
        let center = self.push_vertex(middle, shape.point(middle, part).uv);
        let fan = (0..count).map(|k| turned([center, first + k, first + (k + 1) % count]));
        self.triangles.extend(fan);
    }

    /// Adds a grid of `columns` by `rows` cells over `point(u, v)`, with u and v from 0 to 1.
    fn push_patch(&mut self, [columns, rows]: [f64; 2], point: impl Fn(f64, f64) -> DVec3) {
        let first = self.positions.len() as u32;
        let (across, up) = (columns as u32, rows as u32);
        // Vertices of the last column equal those of the first to the bit, so that the surface is closed
        for row in 0..=up {
            let v = f64::from(row) / rows;
            for column in 0..=across {
                let angle = f64::from(column % across) / columns;
                self.push_vertex(point(angle, v), [f64::from(column) / columns, v]);
            }
        }
        // Split each cell into two triangles
        let index = |column: u32, row: u32| first + row * (across + 1) + column;
        for row in 0..up {
            for column in 0..across {
                let [a, b] = [index(column, row), index(column + 1, row)];
                let [c, d] = [index(column + 1, row + 1), index(column, row + 1)];
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }

    /// Returns the mesh of all polygons and patches.
    fn into_mesh(self) -> Mesh {
        Mesh {
            positions: self.positions.into(),
            tex_coords: vec![self.tex_coords.into()],
            triangles: self.triangles.into(),
            ..Mesh::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Cone, Cylinder, HalfSpace, Sphere, Torus};

    /// Returns the area of a mesh, and the volume that it encloses if it is closed.
    fn area_and_volume(mesh: &Mesh) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for triangle in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners_f64(triangle as u32);
            sums[0] += 0.5 * (b - a).cross(c - a).length();
            sums[1] += a.dot(b.cross(c)) / 6.0;
        }
        sums
    }

    #[test]
    fn tessellated_solids_have_the_areas_and_volumes_of_their_shapes() {
        // An octahedron with vertices at 1 has faces x + y + z = 1, the area 4 √3 and the volume 4/3.
        let mut half_spaces = Vec::new();
        for octant in 0..8 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let n = DVec3::new(sign(0), sign(1), sign(2));
            half_spaces.push(HalfSpace { n, h: 1.0 });
        }
        let octahedron = Polyhedron::from_half_spaces(&half_spaces).unwrap();
        let sphere = Sphere {
            center: DVec3::new(0.5, 0.0, 2.0),
            radius: 2.0,
        };
        for (shape, area, volume) in [
            (Shape::Cube, 24.0, 8.0),
            (Shape::Polyhedron(octahedron.into()), 4.0 * 3f64.sqrt(), 4.0 / 3.0),
            (Shape::Sphere(sphere), 16.0 * PI, 32.0 / 3.0 * PI),
            (Shape::Cylinder(Cylinder { capped: true }), 6.0 * PI, 2.0 * PI),
            (
                Shape::Cone(Cone { capped: true }),
                PI * (1.0 + 5f64.sqrt()),
                2.0 / 3.0 * PI,
            ),
            (Shape::Torus(Torus { minor_radius: 0.25 }), PI * PI, PI * PI / 8.0),
        ] {
            let [found_area, found_volume] = area_and_volume(&tessellate(&shape, 0.02).unwrap());
            // Each direction of a grid of 78 segments or more loses at most 1 - sin(x)/x of it, x = 2 π / 78.
            let bound = 2.0 * (TAU / 78.0).powi(2) / 6.0;
            assert!(
                (found_area / area - 1.0).abs() <= bound,
                "{shape:?}: {found_area}"
            );
            assert!(
                (found_volume / volume - 1.0).abs() <= bound,
                "{shape:?}: {found_volume}"
            );
        }
    }

    #[test]
    fn texture_coordinates_and_fronts_are_those_of_the_shape() {
        for (shape, part) in [
            (Shape::Quad, 0),
            (Shape::Disk, 0),
            (Shape::Sphere(Sphere::UNIT), 0),
        ] {
            let mesh = tessellate(&shape, 0.1).unwrap();
            for (number, &triangle) in (0u32..).zip(&*mesh.triangles) {
                let [a, b, c] = mesh.corners_f64(number);
                let middle = (a + b + c) / 3.0;
                let point = shape.point(middle, part);
                assert!((b - a).cross(c - a).dot(point.n) >= 0.0, "{shape:?}");
                let uv = triangle.map(|v| mesh.tex_coords[0][v as usize]);
                for axis in 0..2 {
                    let mean = (uv[0][axis] + uv[1][axis] + uv[2][axis]) / 3.0;
                    // Near the poles the middle of three longitudes is not the longitude of the middle.
                    if middle.z.abs() < 0.9 {
                        assert!(
                            (f64::from(mean) - point.uv[axis]).abs() < 0.01,
                            "{shape:?} {middle}"
                        );
                    }
                }
            }
        }
        assert!(tessellate(&Shape::Plane, 0.1).is_none());
    }
}
