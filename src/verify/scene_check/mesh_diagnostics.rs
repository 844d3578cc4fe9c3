//! Mesh diagnostics before any ray is traced: open and non-manifold edges, duplicate or inverted faces, slivers.
//!
//! Vertices at equal positions count as one, because files split them where normals or texture coordinates differ.

use std::collections::HashMap;

use serde::Serialize;

use crate::mesh::Mesh;

/// Share of the longest edge below which the height of a triangle makes it a sliver: its height has three digits left
/// in f32.
const SLIVER: f64 = 1e-4;

/// Counts of defects in a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MeshDiagnostics {
    /// Number of all triangles, including defective ones.
    pub triangles: u64,
    /// Edges of one triangle only: a hole, or the boundary of an open surface.
    pub open_edges: u64,
    /// Open edges with the vertex of another triangle exactly on them (T-junctions): cracks that rays may slip through.
    pub t_junctions: u64,
    /// Non-manifold edges, which belong to more than two triangles.
    pub crowded_edges: u64,
    /// Edges whose two triangles have opposite orientations, so that one of them shows its back.
    pub turned_edges: u64,
    /// Triangles with the vertices of an earlier one.
    pub duplicates: u64,
    /// Triangles lower than 10^-4 of their longest edge.
    pub slivers: u64,
    /// Degenerate triangles, which have no area.
    pub degenerate: u64,
}

/// Numbers of times that triangles traverse an edge from its lower to its higher vertex, and back.
#[derive(Clone, Copy, Default)]
struct EdgeUses([u32; 2]);

impl MeshDiagnostics {
    /// Counts the defects of a mesh, whose indices must all be in range.
    pub fn of(mesh: &Mesh) -> MeshDiagnostics {
        let place = first_at_position(mesh);
        let mut found = MeshDiagnostics {
            triangles: mesh.triangles.len() as u64,
            ..MeshDiagnostics::default()
        };
        let mut edges: HashMap<[u32; 2], EdgeUses> = HashMap::new();
        let mut faces: HashMap<[u32; 3], ()> = HashMap::new();
        // Classify each triangle, and skip degenerate and duplicate ones
        for (number, triangle) in mesh.triangles.iter().enumerate() {
            match shape(mesh, number as u32) {
                TriangleShape::Degenerate => {
                    found.degenerate += 1;
                    continue;
                }
                TriangleShape::Sliver => found.slivers += 1,
                TriangleShape::Sound => {}
            }
            let corners = triangle.map(|v| place[v as usize]);
            let mut sorted = corners;
            sorted.sort_unstable();
            if faces.insert(sorted, ()).is_some() {
                found.duplicates += 1;
                continue;
            }
            // Count the directions in which it traverses its edges
            let [a, b, c] = corners;
            for [from, to] in [[a, b], [b, c], [c, a]] {
                let edge_uses = edges.entry([from.min(to), from.max(to)]).or_default();
                edge_uses.0[usize::from(from > to)] += 1;
            }
        }
        // Classify each edge by its number of triangles
        let mut open = Vec::new();
        for (&edge, &EdgeUses([there, back])) in &edges {
            match (there + back, there) {
                (1, _) => open.push(edge),
                (2, 1) => {}
                (2, _) => found.turned_edges += 1,
                _ => found.crowded_edges += 1,
            }
        }
        found.open_edges = open.len() as u64;
        found.t_junctions = t_junctions(mesh, &open);
        found
    }

    /// Returns the sum of two diagnostics.
    pub fn with(self, other: MeshDiagnostics) -> MeshDiagnostics {
        MeshDiagnostics {
            triangles: self.triangles + other.triangles,
            open_edges: self.open_edges + other.open_edges,
            t_junctions: self.t_junctions + other.t_junctions,
            crowded_edges: self.crowded_edges + other.crowded_edges,
            turned_edges: self.turned_edges + other.turned_edges,
            duplicates: self.duplicates + other.duplicates,
            slivers: self.slivers + other.slivers,
            degenerate: self.degenerate + other.degenerate,
        }
    }

    /// Returns each defect that occurs, as its count, name and remedy; empty for a clean closed mesh.
    pub fn advice(&self) -> Vec<(u64, &'static str, &'static str)> {
        let all = [
            (
                self.open_edges,
                "open edges",
                "a thin surface has a boundary; a closed body has holes there, which refraction and shadows show: \
                 close them",
            ),
            (
                self.t_junctions,
                "corners on open edges of other triangles",
                "rays may pass through such cracks on every backend: split the long edge at the corner",
            ),
            (
                self.crowded_edges,
                "edges of three triangles or more",
                "inside and outside are ambiguous there: remove inner walls",
            ),
            (
                self.turned_edges,
                "edges between triangles of opposite winding",
                "one of the two shows its back: give all triangles the same winding",
            ),
            (
                self.duplicates,
                "duplicate triangles",
                "only the first is visible: remove the others",
            ),
            (
                self.slivers,
                "slivers",
                "their normals have few accurate digits: merge them into their neighbours",
            ),
            (
                self.degenerate,
                "triangles without area",
                "no ray can hit them: remove them",
            ),
        ];
        all.into_iter().filter(|&(count, ..)| count > 0).collect()
    }
}

/// Returns for each vertex the first vertex at its position.
fn first_at_position(mesh: &Mesh) -> Vec<u32> {
    let mut first: HashMap<[u32; 3], u32> = HashMap::with_capacity(mesh.positions.len());
    // Adding 0 maps -0 to 0.
    let bits = |p: &[f32; 3]| p.map(|x| (x + 0.0).to_bits());
    (0..)
        .zip(mesh.positions.iter())
        .map(|(number, p)| *first.entry(bits(p)).or_insert(number))
        .collect()
}

enum TriangleShape {
    Sound,
    Sliver,
    Degenerate,
}

fn shape(mesh: &Mesh, number: u32) -> TriangleShape {
    let [a, b, c] = mesh.corners_f64(number);
    let longest = [b - a, c - b, a - c]
        .iter()
        .map(|edge| edge.length_squared())
        .fold(0.0, f64::max);
    let doubled_area = (b - a).cross(c - a).length();
    if doubled_area == 0.0 {
        TriangleShape::Degenerate
    } else if doubled_area < SLIVER * longest {
        TriangleShape::Sliver
    } else {
        TriangleShape::Sound
    }
}

/// Returns the number of open edges that contain a vertex of another open edge between their ends.
fn t_junctions(mesh: &Mesh, open: &[[u32; 2]]) -> u64 {
    let p = |v: u32| glam::Vec3::from(mesh.positions[v as usize]).as_dvec3();
    // Sort the vertices of open edges by x, so that each edge tests few
    let mut rim: Vec<u32> = open.iter().flatten().copied().collect();
    rim.sort_unstable();
    rim.dedup();
    rim.sort_by(|&a, &b| p(a).x.total_cmp(&p(b).x));
    let is_between = |v: u32, [a, b]: [u32; 2]| {
        let (along, to) = (p(b) - p(a), p(v) - p(a));
        let t = along.dot(to);
        // The vertex lies on the line up to a rounding of f32, which is how cracks arise.
        let off = along.cross(to).length_squared();
        let near = f64::from(f32::EPSILON) * along.length_squared();
        v != a && v != b && t > 0.0 && t < along.length_squared() && off <= near * near
    };
    let holds_one = |edge: &&[u32; 2]| {
        // Test the vertices within the edge's interval along x
        let [a, b] = edge.map(|v| p(v).x);
        let from = rim.partition_point(|&v| p(v).x < a.min(b));
        let to = rim.partition_point(|&v| p(v).x <= a.max(b));
        rim[from..to]
            .iter()
            .take(MAX_CANDIDATES)
            .any(|&v| is_between(v, **edge))
    };
    open.iter().filter(holds_one).count() as u64
}

/// Largest number of vertices tested for one edge, which limits the time for a large open mesh.
const MAX_CANDIDATES: usize = 4096;

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::verify::harness::test_meshes::{icosphere, lattice_cube, mesh};

    #[test]
    fn closed_mesh_is_clean_with_split_vertices() {
        for closed in [icosphere(2), lattice_cube(3)] {
            let count = closed.triangles.len() as u64;
            let clean = MeshDiagnostics {
                triangles: count,
                ..MeshDiagnostics::default()
            };
            assert_eq!(MeshDiagnostics::of(&closed), clean);
            // Split all vertices, as files do for flat shading
            let corners: Vec<DVec3> = (0..count as u32).flat_map(|t| closed.corners_f64(t)).collect();
            let split = mesh(
                &corners,
                (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            );
            assert_eq!(MeshDiagnostics::of(&split), clean);
            assert_eq!(clean.advice(), []);
        }
    }

    #[test]
    fn each_mesh_defect_is_counted_once() {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        // A square whose lower side is split at its midpoint by the neighbour below has a crack.
        let corners = [
            at(0.0, 0.0),
            at(2.0, 0.0),
            at(2.0, 2.0),
            at(1.0, 0.0),
            at(0.0, -1.0),
            at(2.0, -1.0),
        ];
        let cracked = mesh(&corners, vec![[0, 1, 2], [4, 3, 0], [4, 5, 3], [5, 1, 3]]);
        let found = MeshDiagnostics::of(&cracked);
        assert_eq!((found.t_junctions, found.open_edges), (1, 8));

        // Count inverted, duplicate and degenerate triangles
        let square = [
            at(0.0, 0.0),
            at(1.0, 0.0),
            at(1.0, 1.0),
            at(0.0, 1.0),
            at(0.5, 0.0),
        ];
        let found = MeshDiagnostics::of(&mesh(&square, vec![[0, 1, 2], [0, 3, 2], [2, 0, 1], [0, 4, 1]]));
        assert_eq!(
            (found.turned_edges, found.duplicates, found.degenerate),
            (1, 1, 1)
        );

        // Count an edge of three triangles and a sliver
        let fan = [
            at(0.0, 0.0),
            at(1.0, 0.0),
            at(0.0, 1.0),
            at(0.0, -1.0),
            at(-1.0, 1e-6),
        ];
        let found = MeshDiagnostics::of(&mesh(&fan, vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]]));
        assert_eq!((found.crowded_edges, found.slivers), (1, 1));
    }
}
