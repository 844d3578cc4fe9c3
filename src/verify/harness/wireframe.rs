//! Wireframe of a scene for figures, drawn from one side: all edges of small meshes, silhouettes of large ones, circles
//! and edges of shapes.

use std::cmp::Reverse;
use std::f64::consts::TAU;

use glam::{DAffine3, DVec3};

use crate::mesh::Mesh;
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::{HalfSpace, Shape};

/// Number of edges above which a mesh is drawn as its silhouette.
const MAX_EDGES: usize = 600;
/// Largest number of lines of a scene.
const MAX_LINES: usize = 4000;
/// Largest number of points of a cloud that are drawn; each takes three circles.
const MAX_DRAWN_POINTS: usize = 32;
/// Number of chords of a circle.
const CHORDS: usize = 48;

/// Line segments that show the geometry of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wireframe {
    /// End points of all lines in world space; all finite.
    pub lines: Vec<[DVec3; 2]>,
    /// Lines of the instance that was hit most often; all lines if nothing was hit.
    pub target: Vec<[DVec3; 2]>,
    /// Edges of the triangles that were hit.
    pub hit_triangles: Vec<[DVec3; 2]>,
}

/// Returns the view directions of a wireframe: right, up, and towards the viewer. A silhouette is correct for this view
/// only.
pub fn view() -> [DVec3; 3] {
    let to_viewer = DVec3::new(0.55, 0.42, 0.72).normalize();
    let right = DVec3::Y.cross(to_viewer).normalize();
    [right, to_viewer.cross(right), to_viewer]
}

/// Returns the wireframe of `scene` with the edges of the triangles `hit_triangles`, given as instance and primitive.
pub(super) fn of(scene: &Scene, hit_triangles: &[[u32; 2]]) -> Wireframe {
    let mut wireframe = Wireframe::default();
    // Add the lines of each instance, the most-hit one in any case
    let target = most_hit_instance(hit_triangles);
    for (number, instance) in (0..).zip(&scene.instances) {
        if wireframe.lines.len() < MAX_LINES || Some(number) == target {
            let lines = instance_lines(scene, instance);
            if target.is_none_or(|target| target == number) {
                wireframe.target.extend(&lines);
            }
            wireframe.lines.extend(lines);
        }
    }
    // Add the edges of the triangles that were hit
    for &[instance, primitive] in hit_triangles {
        let Some(instance) = scene.instances.get(instance as usize) else {
            continue;
        };
        let Geometry::Mesh(mesh) = &scene.geometries[instance.geometry as usize] else {
            continue;
        };
        if (primitive as usize) < mesh.triangles.len() {
            let map = instance.world_from_object();
            let [a, b, c] = mesh.corners_f64(primitive).map(|p| map.transform_point3(p));
            wireframe.hit_triangles.extend([[a, b], [b, c], [c, a]]);
        }
    }
    // Drop infinite lines and limit their number
    for lines in [
        &mut wireframe.lines,
        &mut wireframe.target,
        &mut wireframe.hit_triangles,
    ] {
        lines.retain(|line| line.iter().all(|p| p.is_finite()));
        lines.truncate(MAX_LINES);
    }
    wireframe
}

/// Returns the instance that was hit most often, the first of several.
fn most_hit_instance(hit_triangles: &[[u32; 2]]) -> Option<u32> {
    let count = |instance: u32| {
        hit_triangles
            .iter()
            .filter(|[other, _]| *other == instance)
            .count()
    };
    let instances = hit_triangles.iter().map(|&[instance, _]| instance);
    instances.max_by_key(|&instance| (count(instance), Reverse(instance)))
}

fn instance_lines(scene: &Scene, instance: &Instance) -> Vec<[DVec3; 2]> {
    let map = instance.world_from_object();
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) => mesh_lines(mesh, &map),
        Geometry::Points(cloud) => (0..cloud.len().min(MAX_DRAWN_POINTS) as u32)
            .flat_map(|point| shape_lines(&cloud.shape(point)))
            .map(|line| line.map(|p| map.transform_point3(p)))
            .collect(),
        Geometry::Shape(shape) => shape_lines(shape)
            .into_iter()
            .map(|line| line.map(|p| map.transform_point3(p)))
            .collect(),
    }
}

/// Edge from its lower to its higher vertex index, and whether its triangle is front-facing.
type WireframeSide = ([u32; 2], bool);

fn mesh_lines(mesh: &Mesh, map: &DAffine3) -> Vec<[DVec3; 2]> {
    let [_, _, to_viewer] = view();
    let at = |v: u32| map.transform_point3(glam::Vec3::from(mesh.positions[v as usize]).as_dvec3());
    // List the edges of all triangles with their facing
    let mut sides: Vec<WireframeSide> = Vec::with_capacity(3 * mesh.triangles.len());
    for &[a, b, c] in mesh.triangles.iter() {
        let (p, q, r) = (at(a), at(b), at(c));
        let is_front = (q - p).cross(r - p).dot(to_viewer) > 0.0;
        for [from, to] in [[a, b], [b, c], [c, a]] {
            sides.push(([from.min(to), from.max(to)], is_front));
        }
    }
    // Group the entries of each edge
    sides.sort_unstable();
    let edges: Vec<&[WireframeSide]> = sides.chunk_by(|a, b| a.0 == b.0).collect();
    let is_few = edges.len() <= MAX_EDGES;
    // Silhouette edge: an open edge, or one between a front-facing and a back-facing triangle.
    let is_rim = |edge: &&[WireframeSide]| edge.len() == 1 || edge[0].1 != edge[edge.len() - 1].1;
    // Keep all edges of a small mesh, else the silhouette
    edges
        .into_iter()
        .filter(|edge| is_few || is_rim(edge))
        .map(|edge| edge[0].0.map(at))
        .collect()
}

/// Returns a circle around `center` through `center + a` and `center + b`, as chords.
fn circle(center: DVec3, a: DVec3, b: DVec3) -> Vec<[DVec3; 2]> {
    let at = |i: usize| {
        let (sin, cos) = (TAU * i as f64 / CHORDS as f64).sin_cos();
        center + cos * a + sin * b
    };
    (0..CHORDS).map(|i| [at(i), at(i + 1)]).collect()
}

fn polygon(corners: &[DVec3]) -> Vec<[DVec3; 2]> {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).map(|(&a, &b)| [a, b]).collect()
}

/// Returns lines of a shape in object space; none for unbounded shapes.
fn shape_lines(shape: &Shape) -> Vec<[DVec3; 2]> {
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    let around = [x, y, -x, -y];
    match shape {
        Shape::Sphere(sphere) => {
            let (c, r) = (sphere.center, sphere.radius);
            let [right, up, _] = view();
            // Draw its silhouette, correct unless stretched, and three great circles
            [(right, up), (x, y), (y, z), (z, x)]
                .into_iter()
                .flat_map(|(a, b)| circle(c, r * a, r * b))
                .collect()
        }
        Shape::Cube => edges_of(&[x, -x, y, -y, z, -z].map(|n| HalfSpace { n, h: 1.0 })),
        Shape::Disk => circle(DVec3::ZERO, x, y),
        Shape::Quad => polygon(&[x + y, y - x, -x - y, x - y]),
        // Draw both rims and four lines along the side
        Shape::Cylinder(_) => {
            let sides = around.into_iter().map(|side| [side - z, side + z]);
            let rims = circle(z, x, y).into_iter().chain(circle(-z, x, y));
            rims.chain(sides).collect()
        }
        Shape::Cone(_) => {
            let sides = around.into_iter().map(|side| [side - z, z]);
            circle(-z, x, y).into_iter().chain(sides).collect()
        }
        // Draw four circles the long way and four around the tube
        Shape::Torus(torus) => {
            let r = torus.minor_radius;
            let long = [(1.0 + r, 0.0), (1.0 - r, 0.0), (1.0, r), (1.0, -r)];
            let long = long
                .into_iter()
                .flat_map(|(wide, high)| circle(high * z, wide * x, wide * y));
            let round = around.into_iter().flat_map(|out| circle(out, r * out, r * z));
            long.chain(round).collect()
        }
        Shape::Polyhedron(polyhedron) => edges_of(polyhedron.half_spaces()),
        Shape::Plane | Shape::Quadric(_) => Vec::new(),
    }
}

/// Returns the edges of an intersection of half-spaces: each line where two planes intersect, clipped by the other
/// half-spaces.
fn edges_of(half_spaces: &[HalfSpace]) -> Vec<[DVec3; 2]> {
    let mut edges = Vec::new();
    for (i, a) in half_spaces.iter().enumerate() {
        for b in &half_spaces[i + 1..] {
            // Intersect the two planes
            let along = a.n.cross(b.n);
            if along == DVec3::ZERO {
                continue;
            }
            // Clip the line by the other half-spaces
            let start = (a.h * b.n.cross(along) + b.h * along.cross(a.n)) / along.length_squared();
            let others = half_spaces.iter().filter(|s| **s != *a && **s != *b);
            let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
            for s in others {
                let (rest, slope) = (s.h - s.n.dot(start), s.n.dot(along));
                if slope > 0.0 {
                    high = high.min(rest / slope);
                } else if slope < 0.0 {
                    low = low.max(rest / slope);
                } else if rest < 0.0 {
                    high = f64::NEG_INFINITY;
                }
            }
            if low < high {
                edges.push([start + low * along, start + high * along]);
            }
        }
    }
    edges
}

#[cfg(test)]
mod tests {
    use super::super::test_meshes::{icosphere, lattice_cube, scene};
    use super::*;

    fn lines(geometry: Geometry) -> Vec<[DVec3; 2]> {
        of(&scene(vec![geometry]), &[]).lines
    }

    #[test]
    fn small_mesh_draws_each_edge_once() {
        // Euler's formula: 80 triangles have 120 edges.
        assert_eq!(lines(Geometry::Mesh(icosphere(1))).len(), 120);
    }

    #[test]
    fn large_mesh_draws_closed_silhouette_at_its_radius() {
        let [right, up, _] = view();
        let rim = lines(Geometry::Mesh(icosphere(5)));
        assert!(rim.len() > 60 && rim.len() < 600, "{}", rim.len());
        for [a, _] in &rim {
            let r = (a.dot(right).powi(2) + a.dot(up).powi(2)).sqrt();
            // Edges of 20 · 4^5 triangles have a length of about 1/28.
            assert!(r > 1.0 - 1.0 / 100.0 && r <= 1.0 + f64::from(f32::EPSILON), "{r}");
        }
        // In this view a cube is a hexagon of six edges, each of eleven parts.
        assert_eq!(lines(Geometry::Mesh(lattice_cube(11))).len(), 6 * 11);
    }

    #[test]
    fn a_cube_has_twelve_edges_of_length_two() {
        let edges = lines(Geometry::Shape(Shape::Cube));
        assert_eq!(edges.len(), 12);
        assert!(edges.iter().all(|[a, b]| (*b - *a).length() == 2.0));
    }

    #[test]
    fn view_shows_hit_objects_and_omits_missing_ones() {
        let scene = scene(vec![Geometry::Mesh(icosphere(0)), Geometry::Shape(Shape::Plane)]);
        let wireframe = of(&scene, &[[0, 3], [0, 999], [1, 0], [7, 0]]);
        assert_eq!(wireframe.hit_triangles.len(), 3);
        assert_eq!(wireframe.target.len(), 30, "an icosahedron has 30 edges");
    }
}
