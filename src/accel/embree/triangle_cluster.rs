//! Watertight triangles: up to sixteen that lie together are one primitive of the user geometry, a patch.
//!
//! The triangles of a patch share most of their corners. Each corner is kept once, which takes half the memory of the
//! triangles one by one, and is projected once for all triangles that have it. Corners that coincide are one, whether or
//! not the mesh says so.

use super::origin_bound::OriginBound;
use crate::accel::MeshCache;
use crate::accel::clusters::{Clusters, Cost};
use crate::mesh::Mesh;
use crate::mesh::triangle::PACK;
use crate::numeric::Bounds;
use crate::parallel;

/// Most triangles of a patch.
pub(super) const MEMBERS: usize = 16;
/// Most corners of a patch: sixteen triangles of a surface have from 13 in a compact patch to 18 in a strip.
pub(super) const CORNERS: usize = 24;
/// What it costs Embree's walk to come to a patch and to call, to ask about one more triangle, and to find its box under
/// one more node: a ray is asked about all of a patch in a few vectors.
const COST: Cost = Cost {
    limit: MEMBERS as u32,
    visit: 1.0,
    member: 0.05,
    cut: 0.5,
};
/// Blocks of corners in a patch's own record: few patches have more than sixteen corners, and what is elsewhere is waited
/// for.
const OWN: usize = 2;
/// Patches of a mesh are made so many clusters at a time, in so many parts: what is made is moved once.
const CHUNK: usize = 1 << 14;
const PARTS: usize = 1 << 6;

/// Corners of a patch by axis, eight by eight; the first of the patch is repeated where there are no more.
pub(super) type Block = [[f32; PACK]; 3];

/// Up to sixteen triangles of one instance, without their corners beyond the sixteenth: five lines of the cache, of which
/// the last is read of patches that are hit.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Record {
    corners: [Block; OWN],
    /// For each of a triangle's corners, by triangle: which of the patch's, below `corner_count`.
    triangles: [[u8; MEMBERS]; 3],
    corner_count: u8,
    member_count: u8,
    /// Where the last block of corners is among those of all patches, if there is one.
    last: u32,
    instance: u32,
    /// The numbers of the triangles.
    primitives: [u32; MEMBERS],
}

/// Up to sixteen triangles of one instance.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleCluster<'p> {
    record: &'p Record,
    last: Option<&'p Block>,
}

impl<'p> TriangleCluster<'p> {
    /// The instance that its triangles are of.
    #[inline(always)]
    pub(super) fn instance(self) -> u32 {
        self.record.instance
    }

    /// The number of one of its triangles.
    #[inline(always)]
    pub(super) fn primitive(self, member: usize) -> u32 {
        self.record.primitives[member % MEMBERS]
    }

    /// How many triangles it has; at most [`MEMBERS`].
    #[inline(always)]
    pub(super) fn member_count(self) -> usize {
        usize::from(self.record.member_count)
    }

    /// How many corners they have; at most [`CORNERS`].
    #[inline(always)]
    pub(super) fn corner_count(self) -> usize {
        usize::from(self.record.corner_count)
    }

    /// Its first sixteen corners, the second eight of which mean nothing if there are no more than eight.
    #[inline(always)]
    pub(super) fn own(self) -> &'p [Block; OWN] {
        &self.record.corners
    }

    /// Its corners from the seventeenth on.
    #[inline(always)]
    pub(super) fn last(self) -> Option<&'p Block> {
        self.last
    }

    /// One corner.
    #[inline(always)]
    pub(super) fn corner(self, index: usize) -> [f32; 3] {
        let [first, second] = &self.record.corners;
        let [x, y, z] = match index / PACK {
            0 => first,
            1 => second,
            _ => self.last.unwrap_or(first),
        };
        [x[index % PACK], y[index % PACK], z[index % PACK]]
    }

    /// For each of a triangle's corners, by triangle: which it is. Triangles that there are not have the first thrice.
    #[inline(always)]
    pub(super) fn triangles(self) -> &'p [[u8; MEMBERS]; 3] {
        &self.record.triangles
    }

    /// Which corners a triangle has.
    #[inline(always)]
    pub(super) fn triangle(self, member: usize) -> [usize; 3] {
        let member = member % MEMBERS;
        let [a, b, c] = &self.record.triangles;
        [
            usize::from(a[member]),
            usize::from(b[member]),
            usize::from(c[member]),
        ]
    }

    fn bounds(self) -> Bounds {
        let corners = (0..self.corner_count()).map(|i| self.corner(i));
        Bounds::of_points(corners.map(|corner| glam::Vec3::from(corner).as_dvec3()))
    }
}

/// A patch in the making.
#[derive(Clone, Debug, Default)]
struct Gathering {
    corners: [[f32; CORNERS]; 3],
    /// The mesh's numbers of the corners; of those that coincide, that of the first.
    vertices: [u32; CORNERS],
    triangles: [[u8; MEMBERS]; 3],
    primitives: [u32; MEMBERS],
    corner_count: u8,
    member_count: u8,
}

impl Gathering {
    /// Of the first of `members` that have room; says how many these are, at least one of those there are.
    fn of_first(mesh: &Mesh, members: &[u32]) -> (Gathering, usize) {
        let mut gathering = Gathering::default();
        let taken = members.iter().take(MEMBERS);
        let taken = taken
            .take_while(|&&primitive| gathering.push(mesh, primitive))
            .count();
        for row in &mut gathering.corners {
            let first = row[0];
            row[usize::from(gathering.corner_count)..].fill(first);
        }
        (gathering, taken)
    }

    /// Adds a triangle; false, and nothing changes, if it has too many new corners.
    fn push(&mut self, mesh: &Mesh, primitive: u32) -> bool {
        let member = usize::from(self.member_count);
        let before = self.corner_count;
        for (row, vertex) in mesh.triangles[primitive as usize].into_iter().enumerate() {
            match self.add_corner(mesh, vertex) {
                Some(corner) => self.triangles[row][member] = corner,
                None => {
                    self.corner_count = before;
                    for row in &mut self.triangles {
                        row[member] = 0;
                    }
                    return false;
                }
            }
        }
        self.primitives[member] = primitive;
        self.member_count += 1;
        true
    }

    /// Where a corner is, new or not; none if there is no room.
    fn add_corner(&mut self, mesh: &Mesh, vertex: u32) -> Option<u8> {
        let known = &self.vertices[..usize::from(self.corner_count)];
        if let Some(found) = known.iter().position(|&other| other == vertex) {
            return Some(found as u8);
        }
        let position = mesh.positions[vertex as usize];
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
        *self.vertices.get_mut(usize::from(new))? = vertex;
        for axis in 0..3 {
            self.corners[axis][usize::from(new)] = position[axis];
        }
        self.corner_count += 1;
        Some(new)
    }

    /// The corners of a block.
    fn block(&self, number: usize) -> Block {
        let mut block = [[0.0; PACK]; 3];
        for (row, all) in block.iter_mut().zip(&self.corners) {
            row.copy_from_slice(&all[PACK * number..PACK * (number + 1)]);
        }
        block
    }
}

/// The patches of a space, and how far from its origin rays start.
#[derive(Debug, Default)]
pub(in crate::accel) struct TriangleClusters {
    records: Vec<Record>,
    /// Corners beyond the sixteenth.
    blocks: Vec<Block>,
    reach: OriginBound,
}

impl TriangleClusters {
    /// Those of meshes, each as an instance, for rays from that far. Runs on the current pool; the answer does not depend
    /// on it, nor on what `mesh_cache` has.
    pub(super) fn of<'m>(
        meshes: impl Iterator<Item = (u32, &'m Mesh)>,
        reach: OriginBound,
        mesh_cache: Option<&MeshCache>,
    ) -> TriangleClusters {
        let mut patches = TriangleClusters {
            reach,
            ..TriangleClusters::default()
        };
        for (instance, mesh) in meshes {
            match mesh_cache {
                None => patches.add(mesh, instance),
                Some(mesh_cache) => {
                    let alone = || {
                        let mut alone = TriangleClusters::default();
                        alone.add(mesh, instance);
                        alone
                    };
                    patches.append(&mesh_cache.patches.of(mesh, alone), instance);
                }
            }
        }
        patches.records.shrink_to_fit();
        patches.blocks.shrink_to_fit();
        patches
    }

    fn add(&mut self, mesh: &Mesh, instance: u32) {
        let bounds = |primitive: u32| {
            let [a, b, c] = mesh.corners(primitive);
            [a.min(b).min(c), a.max(b).max(c)]
        };
        let found = Clusters::of(mesh.triangles.len(), bounds, &COST);
        let clusters: Vec<&[u32]> = found.iter().collect();
        self.records.reserve(clusters.len());
        for chunk in clusters.chunks(CHUNK) {
            let parts = parallel::map_chunks(chunk, CHUNK / PARTS, &|_, clusters| {
                TriangleClusters::of_clusters(mesh, instance, clusters)
            });
            parts.iter().for_each(|part| self.append(part, instance));
        }
    }

    fn of_clusters(mesh: &Mesh, instance: u32, clusters: &[&[u32]]) -> TriangleClusters {
        let mut patches = TriangleClusters::default();
        patches.records.reserve(clusters.len());
        for mut rest in clusters.iter().copied() {
            while !rest.is_empty() {
                let (gathering, taken) = Gathering::of_first(mesh, rest);
                patches.push(&gathering, instance);
                rest = &rest[taken..];
            }
        }
        patches
    }

    /// Adds those of `part` behind the others, as an instance.
    fn append(&mut self, part: &TriangleClusters, instance: u32) {
        let block_count = self.blocks.len() as u32;
        let moved = |record: &Record| Record {
            last: block_count + record.last,
            instance,
            ..record.clone()
        };
        self.records.extend(part.records.iter().map(moved));
        self.blocks.extend_from_slice(&part.blocks);
    }

    fn push(&mut self, gathering: &Gathering, instance: u32) {
        self.records.push(Record {
            corners: [gathering.block(0), gathering.block(1)],
            triangles: gathering.triangles,
            corner_count: gathering.corner_count,
            member_count: gathering.member_count,
            // Below 2^32, as triangles are: seventeen corners are of six of them at least.
            last: self.blocks.len() as u32,
            instance,
            primitives: gathering.primitives,
        });
        if usize::from(gathering.corner_count) > OWN * PACK {
            self.blocks.push(gathering.block(OWN));
        }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.records.len()
    }

    /// One of them.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<TriangleCluster<'_>> {
        let record = self.records.get(index)?;
        let has_more = usize::from(record.corner_count) > OWN * PACK;
        let last = match has_more {
            true => Some(self.blocks.get(record.last as usize)?),
            false => None,
        };
        Some(TriangleCluster { record, last })
    }

    /// The box that Embree is told of one of them.
    pub(super) fn boxed(&self, index: usize) -> Option<([f32; 3], [f32; 3])> {
        Some(self.reach.boxed(&self.get(index)?.bounds()))
    }

    /// Bytes on the heap.
    pub(in crate::accel) fn byte_count(&self) -> u64 {
        (self.records.capacity() * size_of::<Record>() + self.blocks.capacity() * size_of::<Block>()) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Buffer;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
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

    fn patches_of(mesh: &Mesh) -> TriangleClusters {
        TriangleClusters::of(std::iter::once((5, mesh)), OriginBound::default(), None)
    }

    fn assert_whole(patches: &TriangleClusters, mesh: &Mesh) {
        let mut seen = vec![false; mesh.triangles.len()];
        for patch in (0..patches.len()).filter_map(|index| patches.get(index)) {
            assert!(patch.corner_count() <= CORNERS && patch.instance() == 5);
            for member in 0..patch.member_count() {
                let primitive = patch.primitive(member);
                assert!(!std::mem::replace(&mut seen[primitive as usize], true));
                let corners = patch.triangle(member).map(|corner| patch.corner(corner));
                assert_eq!(corners, mesh.corners(primitive).map(|p| p.to_array()));
            }
        }
        assert!(seen.into_iter().all(|seen| seen) && patches.get(patches.len()).is_none());
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
    fn kept_patches_are_those_that_would_be_made_whoever_had_them_before() {
        let meshes = [field(12), field(30)];
        let of = |numbers: [u32; 2], mesh_cache| {
            let patches = TriangleClusters::of(
                numbers.into_iter().zip(&meshes),
                OriginBound::default(),
                mesh_cache,
            );
            format!("{patches:?}")
        };
        let mesh_cache = MeshCache::default();
        for numbers in [[5, 6], [8, 0]] {
            assert_eq!(of(numbers, Some(&mesh_cache)), of(numbers, None));
        }
        assert_eq!(mesh_cache.counts().found, 2);
        assert!(mesh_cache.byte_count() > 0);
    }

    #[test]
    fn a_surface_takes_less_than_thirty_two_bytes_a_triangle() {
        let mesh = field(100);
        let patches = patches_of(&mesh);
        let bytes = patches.byte_count() as f64 / mesh.triangles.len() as f64;
        assert!(bytes < 32.0, "{bytes}");
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
        let (gathering, taken) = Gathering::of_first(&stack, &members);
        assert_eq!(
            (taken, gathering.member_count, usize::from(gathering.corner_count)),
            (8, 8, CORNERS)
        );
        assert_whole(&patches_of(&stack), &stack);
    }
}
