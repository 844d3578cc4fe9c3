//! Watertight triangles: up to sixteen that lie together are one primitive of the user geometry, a patch.
//!
//! The triangles of a patch share most of their corners. Each corner is kept once, which takes half the memory of the
//! triangles one by one, and is projected once for all triangles that have it. Corners that coincide are one, whether or
//! not the mesh says so.

use rayon::prelude::*;

use super::reach::Reach;
use crate::accel::clusters::{Clusters, Cost};
use crate::mesh::Mesh;
use crate::numeric::Bounds;

/// Most triangles of a patch.
pub(super) const MEMBERS: usize = 16;
/// Most corners of a patch: sixteen triangles of a surface have from 13 in a compact patch to 18 in a strip.
pub(super) const CORNERS: usize = 24;
/// What it costs Embree's walk to come to a patch and to call, to ask about one more triangle, and to find its box under
/// one more node, as for spheres: a ray is asked about all of a patch in a few vectors.
const COST: Cost = Cost {
    limit: MEMBERS,
    visit: 1.0,
    member: 0.05,
    cut: 1.0,
};
/// Patches of a mesh are made so many clusters at a time.
const CHUNK: usize = 1 << 12;

/// Up to sixteen triangles of one instance, in seven lines of the cache.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Patch {
    /// By axis; the first is repeated where there are no more.
    corners: [[f32; CORNERS]; 3],
    /// For each of a triangle's corners, by triangle: which of the above, below `corner_count`.
    triangles: [[u8; MEMBERS]; 3],
    /// The numbers of the triangles.
    primitives: [u32; MEMBERS],
    instance: u32,
    corner_count: u8,
    member_count: u8,
}

impl Patch {
    /// Of the first of `members` that have room; says how many these are, at least one of those there are.
    fn of_first(mesh: &Mesh, instance: u32, members: &[u32]) -> (Patch, usize) {
        let mut patch = Patch {
            corners: [[0.0; CORNERS]; 3],
            triangles: [[0; MEMBERS]; 3],
            primitives: [0; MEMBERS],
            instance,
            corner_count: 0,
            member_count: 0,
        };
        let taken = members.iter().take(MEMBERS);
        let taken = taken
            .take_while(|&&primitive| patch.push(mesh, primitive))
            .count();
        for row in &mut patch.corners {
            let first = row[0];
            row[usize::from(patch.corner_count)..].fill(first);
        }
        (patch, taken)
    }

    /// Adds a triangle; false, and nothing changes, if it has too many new corners.
    fn push(&mut self, mesh: &Mesh, primitive: u32) -> bool {
        let member = usize::from(self.member_count);
        let before = self.corner_count;
        for (row, position) in mesh.corners(primitive).into_iter().enumerate() {
            match self.add_corner(position.to_array()) {
                Some(corner) => self.triangles[row][member] = corner,
                None => {
                    self.corner_count = before;
                    return false;
                }
            }
        }
        self.primitives[member] = primitive;
        self.member_count += 1;
        true
    }

    /// Where a corner is, new or not; none if there is no room.
    fn add_corner(&mut self, position: [f32; 3]) -> Option<u8> {
        let same = |i: &u8| {
            let i = usize::from(*i);
            [0, 1, 2]
                .iter()
                .all(|&axis| self.corners[axis][i].to_bits() == position[axis].to_bits())
        };
        if let Some(found) = (0..self.corner_count).find(same) {
            return Some(found);
        }
        let new = self.corner_count;
        for axis in 0..3 {
            *self.corners[axis].get_mut(usize::from(new))? = position[axis];
        }
        self.corner_count += 1;
        Some(new)
    }

    /// The instance that its triangles are of.
    #[inline(always)]
    pub(super) fn instance(&self) -> u32 {
        self.instance
    }

    /// The number of one of its triangles.
    #[inline(always)]
    pub(super) fn primitive(&self, member: usize) -> u32 {
        self.primitives[member % MEMBERS]
    }

    /// How many triangles it has; at most [`MEMBERS`].
    #[inline(always)]
    pub(super) fn member_count(&self) -> usize {
        usize::from(self.member_count)
    }

    /// How many corners they have; at most [`CORNERS`].
    #[inline(always)]
    pub(super) fn corner_count(&self) -> usize {
        usize::from(self.corner_count)
    }

    /// All corners, by axis; the first is repeated after the last.
    #[inline(always)]
    pub(super) fn corners(&self) -> &[[f32; CORNERS]; 3] {
        &self.corners
    }

    /// One corner.
    #[inline(always)]
    pub(super) fn corner(&self, index: usize) -> [f32; 3] {
        let [x, y, z] = &self.corners;
        [x[index], y[index], z[index]]
    }

    /// For each of a triangle's corners, by triangle: which it is. Triangles that there are not have the first thrice.
    #[inline(always)]
    pub(super) fn triangles(&self) -> &[[u8; MEMBERS]; 3] {
        &self.triangles
    }

    /// Which corners a triangle has.
    #[inline(always)]
    pub(super) fn triangle(&self, member: usize) -> [usize; 3] {
        let member = member % MEMBERS;
        let [a, b, c] = &self.triangles;
        [
            usize::from(a[member]),
            usize::from(b[member]),
            usize::from(c[member]),
        ]
    }

    fn bounds(&self) -> Bounds {
        let corners = (0..self.corner_count()).map(|i| self.corner(i));
        Bounds::of_points(corners.map(|corner| glam::Vec3::from(corner).as_dvec3()))
    }
}

/// The patches of a space, and how far from its origin rays start.
#[derive(Debug, Default)]
pub(super) struct Patches {
    patches: Vec<Patch>,
    reach: Reach,
}

impl Patches {
    /// Those of meshes, each as an instance, for rays from that far. Runs on the current pool; the answer does not depend
    /// on it.
    pub(super) fn of<'m>(meshes: impl Iterator<Item = (u32, &'m Mesh)>, reach: Reach) -> Patches {
        let mut patches = Patches {
            patches: Vec::new(),
            reach,
        };
        for (instance, mesh) in meshes {
            patches.add(mesh, instance);
        }
        patches
    }

    fn add(&mut self, mesh: &Mesh, instance: u32) {
        let bounds = |primitive: u32| Bounds::of_points(mesh.corners_f64(primitive));
        let found = Clusters::of(mesh.triangles.len(), bounds, &COST);
        let clusters: Vec<&[u32]> = found.iter().collect();
        self.patches.reserve_exact(clusters.len());
        for chunk in clusters.chunks(CHUNK) {
            let made: Vec<(Patch, &[u32])> = chunk
                .par_iter()
                .map(|&members| {
                    let (patch, taken) = Patch::of_first(mesh, instance, members);
                    (patch, &members[taken..])
                })
                .collect();
            for (patch, mut rest) in made {
                self.patches.push(patch);
                while !rest.is_empty() {
                    let (patch, taken) = Patch::of_first(mesh, instance, rest);
                    self.patches.push(patch);
                    rest = &rest[taken..];
                }
            }
        }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.patches.len()
    }

    /// One of them.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<&Patch> {
        self.patches.get(index)
    }

    /// The box that Embree is told of one of them.
    pub(super) fn boxed(&self, index: usize) -> Option<([f32; 3], [f32; 3])> {
        Some(self.reach.boxed(&self.patches.get(index)?.bounds()))
    }

    /// Bytes on the heap.
    pub(super) fn byte_count(&self) -> u64 {
        (self.patches.capacity() * size_of::<Patch>()) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Slab;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: Slab::from(positions),
            triangles: Slab::from(triangles),
            ..Mesh::default()
        }
    }

    /// A wavy square of `n` by `n` cells, two triangles each.
    fn field(n: u32) -> Mesh {
        let at = |i: u32, j: u32| {
            [
                i as f32,
                j as f32,
                (0.7 * i as f32).sin() * (0.3 * j as f32).cos(),
            ]
        };
        let positions = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j)));
        let cells = (0..n).flat_map(|j| (0..n).map(move |i| j * (n + 1) + i));
        let triangles = cells.flat_map(|v| [[v, v + 1, v + n + 2], [v, v + n + 2, v + n + 1]]);
        mesh(positions.collect(), triangles.collect())
    }

    /// The same triangles, none of which shares a vertex with another.
    fn apart(mesh_in: &Mesh, moved: impl Fn(u32, [f32; 3]) -> [f32; 3]) -> Mesh {
        let count = mesh_in.triangles.len() as u32;
        let corners = |i: u32| mesh_in.corners(i).map(|corner| moved(i, corner.to_array()));
        mesh(
            (0..count).flat_map(corners).collect(),
            (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        )
    }

    fn patches_of(mesh: &Mesh) -> Patches {
        Patches::of(std::iter::once((5, mesh)), Reach::default())
    }

    fn assert_whole(patches: &Patches, mesh: &Mesh) {
        let mut seen = vec![false; mesh.triangles.len()];
        for patch in &patches.patches {
            assert!(patch.corner_count() <= CORNERS && patch.instance() == 5);
            for member in 0..patch.member_count() {
                let primitive = patch.primitive(member);
                assert!(!std::mem::replace(&mut seen[primitive as usize], true));
                let corners = patch.triangle(member).map(|corner| patch.corner(corner));
                assert_eq!(corners, mesh.corners(primitive).map(|p| p.to_array()));
            }
        }
        assert!(seen.into_iter().all(|seen| seen));
    }

    #[test]
    fn every_triangle_is_in_one_patch_with_its_own_corners() {
        for mesh in [
            field(1),
            field(40),
            apart(&field(40), |i, p| [p[0], p[1], p[2] + i as f32]),
        ] {
            assert_whole(&patches_of(&mesh), &mesh);
        }
        assert_eq!(patches_of(&Mesh::default()).len(), 0);
    }

    #[test]
    fn a_surface_takes_less_than_forty_bytes_a_triangle() {
        let mesh = field(100);
        let patches = patches_of(&mesh);
        let bytes = patches.byte_count() as f64 / mesh.triangles.len() as f64;
        assert!(bytes < 40.0, "{bytes}");
    }

    #[test]
    fn corners_that_coincide_are_one_whether_or_not_the_mesh_says_so() {
        let mesh = field(20);
        let same = apart(&mesh, |_, corner| corner);
        assert_eq!(patches_of(&same).len(), patches_of(&mesh).len());
    }

    #[test]
    fn triangles_that_share_no_corner_are_as_many_to_a_patch_as_have_room() {
        // Sixteen triangles one above the other, of three corners each, for which there is room by eights.
        let alone = apart(&field(1), |i, p| [p[0], p[1], p[2] + i as f32]);
        let first = alone.corners(0).map(|p| p.to_array());
        let positions = (0..16).flat_map(|i| first.map(|[x, y, z]| [x, y, z + i as f32]));
        let triangles = (0..16).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
        let stack = mesh(positions.collect(), triangles.collect());
        let members: Vec<u32> = (0..16).collect();
        let (patch, taken) = Patch::of_first(&stack, 5, &members);
        assert_eq!(
            (taken, patch.member_count(), patch.corner_count()),
            (8, 8, CORNERS)
        );
        assert_whole(&patches_of(&stack), &stack);
    }
}
