//! Clusters of up to sixteen nearby watertight triangles, each one primitive of the user geometry.
//!
//! The triangles of a cluster share most of their vertices. Each vertex is stored once, which takes half the memory of
//! separate triangles, and is projected once for all triangles that have it. Coincident vertices are merged even if the
//! mesh has different indices for them.

use crate::accel::clusters::{Clusters, Cost};
use crate::accel::embree::built_meshes::BuiltMeshes;
use crate::accel::embree::origin_bound::OriginBound;
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
    split: 0.5,
};
/// Number of vertex blocks in the cluster's own record: few clusters have more than sixteen vertices, and a block
/// elsewhere costs memory latency.
const INLINE_BLOCKS: usize = 2;
/// Number of clusters of a mesh built at a time, and number of parallel parts: the result of a part is copied once.
const CHUNK: usize = 1 << 14;
const PARTS: usize = 1 << 6;

/// Eight vertices by axis; unused slots repeat the first vertex of the cluster.
pub(super) type TriangleBlock = [[f32; PACK]; 3];

/// Up to sixteen triangles of one instance, with their first sixteen vertices: five cache lines, of which the last is
/// read only for clusters that are hit.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct BlockRecord {
    corners: [TriangleBlock; INLINE_BLOCKS],
    /// Vertex indices within the cluster, below `corner_count`, by vertex of the triangle and triangle.
    triangles: [[u8; MEMBERS]; 3],
    corner_count: u8,
    member_count: u8,
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
        usize::from(self.record.member_count)
    }

    /// Returns the number of vertices, at most [`CORNERS`].
    #[inline(always)]
    pub(super) fn corner_count(self) -> usize {
        usize::from(self.record.corner_count)
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
        let corners = (0..self.corner_count()).map(|i| self.corner(i));
        Bounds::of_points(corners.map(|corner| glam::Vec3::from(corner).as_dvec3()))
    }
}

/// A cluster under construction.
#[derive(Clone, Debug, Default)]
struct ClusterBuilder {
    corners: [[f32; CORNERS]; 3],
    /// Vertex indices in the mesh; of coincident vertices, that of the first.
    vertices: [u32; CORNERS],
    triangles: [[u8; MEMBERS]; 3],
    primitives: [u32; MEMBERS],
    corner_count: u8,
    member_count: u8,
}

impl ClusterBuilder {
    /// Builds a cluster from the first of `members` that fit, and returns their number, at least one.
    fn of_first(mesh: &Mesh, members: &[u32]) -> (ClusterBuilder, usize) {
        let mut builder = ClusterBuilder::default();
        let taken = members.iter().take(MEMBERS);
        let taken = taken
            .take_while(|&&primitive| builder.push(mesh, primitive))
            .count();
        // Fill unused slots with the first vertex
        for row in &mut builder.corners {
            let first = row[0];
            row[usize::from(builder.corner_count)..].fill(first);
        }
        (builder, taken)
    }

    /// Adds a triangle; returns false, and changes nothing, if it has too many new vertices.
    fn push(&mut self, mesh: &Mesh, primitive: u32) -> bool {
        let member = usize::from(self.member_count);
        let before = self.corner_count;
        for (row, vertex) in mesh.triangles[primitive as usize].into_iter().enumerate() {
            match self.add_corner(mesh, vertex) {
                Some(corner) => self.triangles[row][member] = corner,
                None => {
                    // Undo the vertices of this triangle
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

    /// Returns the index of a vertex, adding it if it is new; `None` if the cluster is full.
    // Look for the same index, then for the same position
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
        // Append a new vertex
        let new = self.corner_count;
        *self.vertices.get_mut(usize::from(new))? = vertex;
        for axis in 0..3 {
            self.corners[axis][usize::from(new)] = position[axis];
        }
        self.corner_count += 1;
        Some(new)
    }

    /// Returns the vertices of a block.
    fn block(&self, number: usize) -> TriangleBlock {
        let mut block = [[0.0; PACK]; 3];
        for (row, all) in block.iter_mut().zip(&self.corners) {
            row.copy_from_slice(&all[PACK * number..PACK * (number + 1)]);
        }
        block
    }
}

/// All triangle clusters of an Embree scene, with the bound on its ray origins.
#[derive(Debug, Default)]
pub(in crate::accel) struct TriangleClusters {
    records: Vec<BlockRecord>,
    /// Blocks of vertices beyond the sixteenth.
    blocks: Vec<TriangleBlock>,
    origin_bound: OriginBound,
}

impl TriangleClusters {
    /// Builds the clusters of meshes, each as an instance, for ray origins within `origin_bound`. Runs on the current thread
    /// pool; the result depends neither on it nor on the contents of `mesh_cache`.
    pub(in crate::accel::embree) fn of<'m>(
        meshes: impl Iterator<Item = (u32, &'m Mesh)>,
        origin_bound: OriginBound,
        mesh_cache: Option<&BuiltMeshes<TriangleClusters>>,
    ) -> TriangleClusters {
        let mut patches = TriangleClusters {
            origin_bound,
            ..TriangleClusters::default()
        };
        for (instance, mesh) in meshes {
            // Reuse the clusters of an equal mesh; only the instance index differs
            match mesh_cache {
                None => patches.add(mesh, instance),
                Some(mesh_cache) => {
                    let alone = || {
                        let mut alone = TriangleClusters::default();
                        alone.add(mesh, instance);
                        alone
                    };
                    patches.append(&mesh_cache.of(mesh, alone), instance);
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
        // Build the clusters of a chunk in parallel and append them in order
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
            // Open a further cluster if the vertices do not fit into one
            while !rest.is_empty() {
                let (builder, taken) = ClusterBuilder::of_first(mesh, rest);
                patches.push(&builder, instance);
                rest = &rest[taken..];
            }
        }
        patches
    }

    /// Appends the clusters of `part`, as triangles of `instance`.
    fn append(&mut self, part: &TriangleClusters, instance: u32) {
        let block_count = self.blocks.len() as u32;
        let moved = |record: &BlockRecord| BlockRecord {
            last: block_count + record.last,
            instance,
            ..record.clone()
        };
        self.records.extend(part.records.iter().map(moved));
        self.blocks.extend_from_slice(&part.blocks);
    }

    fn push(&mut self, builder: &ClusterBuilder, instance: u32) {
        self.records.push(BlockRecord {
            corners: [builder.block(0), builder.block(1)],
            triangles: builder.triangles,
            corner_count: builder.corner_count,
            member_count: builder.member_count,
            // Below 2^32, as are triangle indices: seventeen vertices need at least six triangles.
            last: self.blocks.len() as u32,
            instance,
            primitives: builder.primitives,
        });
        if usize::from(builder.corner_count) > INLINE_BLOCKS * PACK {
            self.blocks.push(builder.block(INLINE_BLOCKS));
        }
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.records.len()
    }

    /// Returns one cluster, if the index is in range.
    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> Option<TriangleCluster<'_>> {
        let record = self.records.get(index)?;
        let has_more = usize::from(record.corner_count) > INLINE_BLOCKS * PACK;
        let last = match has_more {
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
        (self.records.capacity() * size_of::<BlockRecord>()
            + self.blocks.capacity() * size_of::<TriangleBlock>()) as u64
    }
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
        let members: Vec<u32> = (0..16).collect();
        let (builder, taken) = ClusterBuilder::of_first(&stack, &members);
        assert_eq!(
            (taken, builder.member_count, usize::from(builder.corner_count)),
            (8, 8, CORNERS)
        );
        assert_whole(&patches_of(&stack), &stack);
    }
}
