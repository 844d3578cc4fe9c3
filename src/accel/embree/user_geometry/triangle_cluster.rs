//! Clusters of up to sixteen nearby watertight triangles, each one primitive of the user geometry.
//!
//! The triangles of a cluster share most of their vertices. Each vertex is stored once, which takes half the memory of
//! separate triangles, and is projected once for all triangles that have it. Coincident vertices are merged even if the
//! mesh has different indices for them.

use std::sync::{Arc, Mutex};

use bytemuck::Zeroable;
use glam::Vec3A;

use crate::accel::clusters::{ClusterPart, Clusters, Cost};
use crate::accel::embree::built_meshes::BuiltMeshes;
use crate::accel::embree::origin_bound::OriginBound;
use crate::accel::morton::Box4;
use crate::buffer::BufferMut;
use crate::mesh::Mesh;
use crate::mesh::triangle::PACK;
use crate::numeric::Bounds;
use crate::parallel;

/// Maximum number of triangles in a cluster.
pub(super) const MEMBERS: usize = 16;
/// Maximum number of vertices in a cluster: sixteen triangles of a surface have from 13 in a compact cluster to 18 in a
/// strip.
pub(super) const CORNERS: usize = 24;
/// Cost model: traversal to a cluster and its callback, one further triangle in the test, and one further node. A ray
/// is tested against a whole cluster in a few vectors.
const COST: Cost = Cost {
    limit: MEMBERS as u32,
    visit: 1.0,
    member: 0.05,
    split: 0.7,
    whole_limit: 1,
};
/// Number of vertex blocks in the cluster's own record: few clusters have more than sixteen vertices, and a block
/// elsewhere costs memory latency.
const INLINE_BLOCKS: usize = 2;
/// Number of slots of the hash table of a cluster's vertices, a power of two of which less than half are in use.
const TABLE: usize = 64;
/// Number of records that a task copies.
const COPY_COUNT: usize = 1 << 10;

/// Eight vertices by axis; unused slots repeat the first vertex of the cluster.
pub(super) type TriangleBlock = [[f32; PACK]; 3];

/// Up to sixteen triangles of one instance, with their first sixteen vertices: five cache lines, of which the last is
/// read only for clusters that are hit.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
struct BlockRecord {
    corners: [TriangleBlock; INLINE_BLOCKS],
    /// Vertex indices within the cluster, below `corner_count`, by vertex of the triangle and triangle.
    triangles: [[u8; MEMBERS]; 3],
    corner_count: u32,
    member_count: u32,
    /// Index of the last block of vertices in the array shared by all clusters, if the cluster has such a block.
    last: u32,
    instance: u32,
    /// Indices of the triangles in the mesh.
    primitives: [u32; MEMBERS],
}

/// View of up to sixteen triangles of one instance.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleCluster<'p> {
    record: &'p BlockRecord,
    last: Option<&'p TriangleBlock>,
}

impl<'p> TriangleCluster<'p> {
    /// Returns the instance that the triangles belong to.
    #[inline(always)]
    pub(super) fn instance(self) -> u32 {
        self.record.instance
    }

    /// Returns the index of one triangle in the mesh.
    #[inline(always)]
    pub(super) fn primitive(self, member: usize) -> u32 {
        self.record.primitives[member % MEMBERS]
    }

    /// Returns the number of triangles, at most [`MEMBERS`].
    #[inline(always)]
    pub(super) fn member_count(self) -> usize {
        self.record.member_count as usize
    }

    /// Returns the number of vertices, at most [`CORNERS`].
    #[inline(always)]
    pub(super) fn corner_count(self) -> usize {
        self.record.corner_count as usize
    }

    /// Returns the first sixteen vertices, of which the second eight are meaningless if the cluster has at most eight.
    #[inline(always)]
    pub(super) fn first_blocks(self) -> &'p [TriangleBlock; INLINE_BLOCKS] {
        &self.record.corners
    }

    /// Returns the vertices from the seventeenth on, if there are any.
    #[inline(always)]
    pub(super) fn last(self) -> Option<&'p TriangleBlock> {
        self.last
    }

    /// Returns one vertex of the cluster.
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

    /// Returns the vertex indices by vertex of the triangle and triangle. Unused slots have index 0 three times.
    #[inline(always)]
    pub(super) fn triangles(self) -> &'p [[u8; MEMBERS]; 3] {
        &self.record.triangles
    }

    /// Returns the three vertex indices of a triangle, within the cluster.
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
        let [first, second] = &self.record.corners;
        let mut bounds = Bounds::EMPTY;
        for axis in 0..3 {
            // Unused slots repeat the first vertex
            let (mut low, mut high) = (first[axis], first[axis]);
            for block in [Some(second), self.last].into_iter().flatten() {
                for slot in 0..PACK {
                    low[slot] = low[slot].min(block[axis][slot]);
                    high[slot] = high[slot].max(block[axis][slot]);
                }
            }
            bounds.min[axis] = low.into_iter().fold(f32::INFINITY, f32::min).into();
            bounds.max[axis] = high.into_iter().fold(f32::NEG_INFINITY, f32::max).into();
        }
        bounds
    }
}

/// Vertices of a cluster under construction.
struct ClusterVertices {
    positions: [[f32; 3]; CORNERS],
    count: usize,
    /// Hash table of positions with open addressing: vertex indices plus 1, and 0 in free slots.
    table: [u8; TABLE],
}

impl ClusterVertices {
    /// Adds the vertices of a triangle that are new, and returns the indices of all three; `None`, and changes nothing
    /// but the table, if there are too many.
    fn add_triangle(&mut self, corners: [[f32; 3]; 3]) -> Option<[u8; 3]> {
        let before = self.count;
        let mut indices = [0; 3];
        for (index, corner) in indices.iter_mut().zip(corners) {
            let Some(found) = self.add(corner) else {
                self.count = before;
                return None;
            };
            *index = found;
        }
        Some(indices)
    }

    /// Returns the index of a vertex, adding it if its position is new; `None` if the cluster is full.
    #[inline(always)]
    fn add(&mut self, position: [f32; 3]) -> Option<u8> {
        // Search from the slot that the bits are hashed to
        let [x, y, z] = position.map(f32::to_bits);
        let hash = (x ^ y.rotate_left(11) ^ z.rotate_left(22)).wrapping_mul(0x9e37_79b1);
        let mut slot = (hash >> (u32::BITS - TABLE.ilog2())) as usize;
        while self.table[slot] != 0 {
            let index = self.table[slot] - 1;
            if self.positions[usize::from(index)].map(f32::to_bits) == [x, y, z] {
                return Some(index);
            }
            slot = (slot + 1) % TABLE;
        }
        // Append a new vertex
        *self.positions.get_mut(self.count)? = position;
        self.count += 1;
        self.table[slot] = self.count as u8;
        Some(self.count as u8 - 1)
    }

    /// Returns the vertices of a block.
    fn block(&self, number: usize) -> TriangleBlock {
        let positions = &self.positions[PACK * number..PACK * (number + 1)];
        std::array::from_fn(|axis| std::array::from_fn(|slot| positions[slot][axis]))
    }
}

impl BlockRecord {
    /// Stores the first of `members` that fit, and returns their number, at least one; a block beyond those in the
    /// record is appended to `blocks`. Every byte of the record must be zero.
    fn fill(&mut self, mesh: &Mesh, members: &[u32], blocks: &mut Vec<TriangleBlock>) -> usize {
        // Store the triangles
        let mut vertices = ClusterVertices {
            positions: [[0.0; 3]; CORNERS],
            count: 0,
            table: [0; TABLE],
        };
        let mut taken = 0;
        for &primitive in members.iter().take(MEMBERS) {
            let [a, b, c] = mesh.triangles[primitive as usize];
            let at = |vertex: u32| mesh.positions[vertex as usize];
            let Some(indices) = vertices.add_triangle([at(a), at(b), at(c)]) else {
                break;
            };
            for (row, index) in self.triangles.iter_mut().zip(indices) {
                row[taken] = index;
            }
            self.primitives[taken] = primitive;
            taken += 1;
        }
        // Store the vertices, with the first one in unused slots
        let first = vertices.positions[0];
        vertices.positions[vertices.count..].fill(first);
        self.corners = [vertices.block(0), vertices.block(1)];
        self.corner_count = vertices.count as u32;
        self.member_count = taken as u32;
        if self.has_last() {
            // Below 2^32, as are triangle indices: seventeen vertices need at least six triangles.
            self.last = blocks.len() as u32;
            blocks.push(vertices.block(INLINE_BLOCKS));
        }
        taken
    }

    /// Returns whether a block of vertices lies elsewhere.
    #[inline(always)]
    fn has_last(&self) -> bool {
        self.corner_count as usize > INLINE_BLOCKS * PACK
    }

    /// Moves the block that lies elsewhere, if there is one, behind `count` others.
    fn move_last(&mut self, count: usize) {
        if self.has_last() {
            self.last += count as u32;
        }
    }
}

/// All triangle clusters of an Embree scene, with the bound on its ray origins.
#[derive(Debug, Default)]
pub(in crate::accel) struct TriangleClusters {
    records: BufferMut<BlockRecord>,
    /// Further clusters, of triangles whose vertices do not fit into the cluster that they were grouped into.
    rest: Vec<BlockRecord>,
    /// Blocks of vertices beyond the sixteenth.
    blocks: Vec<TriangleBlock>,
    origin_bound: OriginBound,
}

/// Clusters of a mesh that one task builds.
struct ClusterTask<'a> {
    instance: u32,
    mesh: &'a Mesh,
    part: &'a ClusterPart,
    /// Room for one record each.
    records: &'a mut [BlockRecord],
    rest: Vec<BlockRecord>,
    /// Blocks of both, to which their records refer.
    blocks: Vec<TriangleBlock>,
}

impl ClusterTask<'_> {
    fn run(&mut self) {
        for (record, members) in self.records.iter_mut().zip(self.part.iter()) {
            record.instance = self.instance;
            let mut taken = record.fill(self.mesh, members, &mut self.blocks);
            // Open a further cluster if the vertices do not fit into one
            while taken < members.len() {
                let mut record = BlockRecord {
                    instance: self.instance,
                    ..BlockRecord::zeroed()
                };
                taken += record.fill(self.mesh, &members[taken..], &mut self.blocks);
                self.rest.push(record);
            }
        }
    }

    /// Moves the blocks behind `count` others.
    fn move_blocks(&mut self, count: usize) {
        let records = self.records.iter_mut().chain(&mut self.rest);
        records.for_each(|record| record.move_last(count));
    }
}

impl TriangleClusters {
    /// Builds the clusters of meshes, each as an instance, for ray origins within `origin_bound`. Runs on the current thread
    /// pool; the result depends neither on it nor on the contents of `mesh_cache`.
    pub(in crate::accel::embree) fn of<'m>(
        meshes: impl Iterator<Item = (u32, &'m Mesh)>,
        origin_bound: OriginBound,
        mesh_cache: Option<&BuiltMeshes<TriangleClusters>>,
    ) -> TriangleClusters {
        let clusters = match mesh_cache {
            None => TriangleClusters::build(&meshes.collect::<Vec<_>>()),
            Some(mesh_cache) => {
                // Reuse the clusters of equal meshes; only the instance indices differ
                let built = meshes.map(|(instance, mesh)| {
                    let alone = || TriangleClusters::build(&[(instance, mesh)]);
                    (instance, mesh_cache.of(mesh, alone))
                });
                TriangleClusters::joined(&built.collect::<Vec<_>>())
            }
        };
        TriangleClusters {
            origin_bound,
            ..clusters
        }
    }

    /// Builds the clusters of meshes.
    fn build(meshes: &[(u32, &Mesh)]) -> TriangleClusters {
        // Group the triangles
        let grouped: Vec<Clusters> = meshes.iter().map(|(_, mesh)| grouped(mesh)).collect();
        let mut records = BufferMut::zeroed(grouped.iter().map(Clusters::len).sum());
        // Build the clusters of each part in parallel, in place
        let (mut tasks, mut room) = (Vec::new(), &mut records[..]);
        for (&(instance, mesh), clusters) in meshes.iter().zip(&grouped) {
            for part in clusters.parts() {
                let (records, behind) = room.split_at_mut(part.len());
                room = behind;
                let (rest, blocks) = (Vec::new(), Vec::new());
                tasks.push(Mutex::new(ClusterTask {
                    instance,
                    mesh,
                    part,
                    records,
                    rest,
                    blocks,
                }));
            }
        }
        let run = |work: &(dyn Fn(usize, &mut ClusterTask) + Sync)| {
            parallel::for_each(tasks.len(), &|index| {
                if let Ok(mut task) = tasks[index].lock() {
                    work(index, &mut task);
                }
            });
        };
        run(&|_, task| task.run());
        // Join the blocks, then the clusters that do not lie in place
        let mut starts = Vec::with_capacity(tasks.len());
        let mut blocks = Vec::new();
        for mut task in tasks.iter().filter_map(|task| task.lock().ok()) {
            starts.push(blocks.len());
            blocks.append(&mut task.blocks);
        }
        run(&|index, task| task.move_blocks(starts[index]));
        let tasks = tasks.into_iter().filter_map(|task| task.into_inner().ok());
        let rest = tasks.flat_map(|task| task.rest).collect();
        TriangleClusters {
            records,
            rest,
            blocks,
            origin_bound: OriginBound::default(),
        }
    }

    /// Joins the clusters of meshes, as triangles of the given instances.
    fn joined(built: &[(u32, Arc<TriangleClusters>)]) -> TriangleClusters {
        let mut records = BufferMut::zeroed(built.iter().map(|(_, clusters)| clusters.records.len()).sum());
        let (mut rest, mut blocks) = (Vec::new(), Vec::new());
        let mut first = 0;
        for (instance, clusters) in built {
            let block_count = blocks.len();
            let moved = |record: &BlockRecord| {
                let mut record = *record;
                record.instance = *instance;
                record.move_last(block_count);
                record
            };
            // Copy the records in parallel
            let from = &clusters.records[..];
            let to = &mut records[first..first + from.len()];
            parallel::for_each_chunk_mut(to, COPY_COUNT, &|chunk, to| {
                for (to, record) in to.iter_mut().zip(&from[chunk * COPY_COUNT..]) {
                    *to = moved(record);
                }
            });
            first += from.len();
            rest.extend(clusters.rest.iter().map(moved));
            blocks.extend_from_slice(&clusters.blocks);
        }
        TriangleClusters {
            records,
            rest,
            blocks,
            origin_bound: OriginBound::default(),
        }
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.records.len() + self.rest.len()
    }

    /// Returns one cluster, if the index is in range.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<TriangleCluster<'_>> {
        let record = match self.records.get(index) {
            Some(record) => record,
            None => self.rest.get(index - self.records.len())?,
        };
        let last = match record.has_last() {
            true => Some(self.blocks.get(record.last as usize)?),
            false => None,
        };
        Some(TriangleCluster { record, last })
    }

    /// Returns the padded box of one cluster for Embree.
    pub(super) fn embree_box(&self, index: usize) -> Option<([f32; 3], [f32; 3])> {
        Some(self.origin_bound.embree_box(&self.get(index)?.bounds()))
    }

    /// Returns the number of bytes on the heap.
    pub(in crate::accel) fn byte_count(&self) -> u64 {
        (self.len() * size_of::<BlockRecord>() + self.blocks.len() * size_of::<TriangleBlock>()) as u64
    }
}

/// Groups the triangles of a mesh.
fn grouped(mesh: &Mesh) -> Clusters {
    let bounds = |primitive: usize| {
        let [a, b, c] = mesh.triangles[primitive];
        let at = |vertex: u32| Vec3A::from(mesh.positions[vertex as usize]);
        let (a, b, c) = (at(a), at(b), at(c));
        Box4 {
            low: a.min(b).min(c),
            high: a.max(b).max(c),
        }
    };
    let around = Box4::around(&mesh.positions);
    Clusters::of(mesh.triangles.len(), &around, bounds, &COST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::MeshCache;
    use crate::buffer::Buffer;

    fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh {
            positions: Buffer::from(positions),
            triangles: Buffer::from(triangles),
            ..Mesh::default()
        }
    }

    /// Builds a wavy square of `n` by `n` cells, two triangles each.
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

    /// Builds the same triangles with separate vertices.
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
        for cluster in (0..patches.len()).filter_map(|index| patches.get(index)) {
            assert!(cluster.corner_count() <= CORNERS && cluster.instance() == 5);
            for member in 0..cluster.member_count() {
                let primitive = cluster.primitive(member);
                assert!(!std::mem::replace(&mut seen[primitive as usize], true));
                let corners = cluster.triangle(member).map(|corner| cluster.corner(corner));
                assert_eq!(corners, mesh.corners(primitive).map(|p| p.to_array()));
            }
        }
        assert!(seen.into_iter().all(|seen| seen) && patches.get(patches.len()).is_none());
    }

    #[test]
    fn every_triangle_is_in_one_cluster_with_its_corners() {
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
    fn cached_clusters_equal_newly_built_ones() {
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
            assert_eq!(of(numbers, Some(&mesh_cache.patches)), of(numbers, None));
        }
        assert_eq!(mesh_cache.counts().found, 2);
        assert!(mesh_cache.byte_count() > 0);
    }

    #[test]
    fn surface_clusters_take_less_than_thirty_two_bytes_per_triangle() {
        let mesh = field(100);
        let patches = patches_of(&mesh);
        let bytes = patches.byte_count() as f64 / mesh.triangles.len() as f64;
        assert!(bytes < 32.0, "{bytes}");
    }

    #[test]
    fn coincident_corners_are_merged() {
        let mesh = field(20);
        let same = apart(&mesh, |_, corner| corner);
        assert_eq!(patches_of(&same).len(), patches_of(&mesh).len());
    }

    #[test]
    fn triangles_without_shared_corners_fill_a_cluster() {
        // Sixteen triangles above each other, with three vertices each; only eight fit.
        let alone = apart(&field(1), |i, p| [p[0], p[1], p[2] + i as f32]);
        let first = alone.corners(0).map(|p| p.to_array());
        let positions = (0..16).flat_map(|i| first.map(|[x, y, z]| [x, y, z + i as f32]));
        let triangles = (0..16).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
        let stack = mesh(positions.collect(), triangles.collect());
        let clusters = patches_of(&stack);
        let first = clusters.get(0).unwrap();
        assert_eq!(
            (clusters.len(), first.member_count(), first.corner_count()),
            (2, 8, CORNERS)
        );
        assert_whole(&clusters, &stack);
    }
}
