//! Leaves of small trees, whose triangles name the vertices that they share.

use crate::mesh::triangle::PACK;

use super::layout::{ChildLink, GroupTree, LeafBlock, NO_NUMBER};

/// Greatest number of leaves of a tree that packets traverse. Through trees of 20 to 80 triangles they take 0.5 to 0.6 of the
/// time of single rays with AVX-512, 0.6 to 0.75 with AVX2; of 160 triangles 0.8 and 0.9, of 320 triangles 0.8 and 1.0
/// (`cargo bench --bench timing -- small_trees`).
pub(super) const MAX_BLOCKS: usize = 64;
/// Number of places for the vertices of a leaf, which has at most 24: a power of two, so that a mask bounds their indices.
pub(super) const MAX_VERTICES: usize = (3 * PACK).next_power_of_two();

/// Leaf whose triangles share their vertices.
#[derive(Clone, Copy, Debug)]
pub(super) struct IndexedBlock {
    /// Positions of the vertices, each with a fourth value that has no meaning.
    vertices: [[f32; 4]; MAX_VERTICES],
    vertex_count: usize,
    /// Vertices of the triangles.
    triangles: [[u8; 3]; PACK],
    /// Numbers of the triangles.
    pub(super) numbers: [u32; PACK],
    triangle_count: usize,
}

impl IndexedBlock {
    /// Names the vertices of the triangles of a leaf. Vertices are the same if all their bits are, so that each has one
    /// projection.
    fn of(block: &LeafBlock) -> IndexedBlock {
        let mut indexed = IndexedBlock {
            vertices: [[0.0; 4]; MAX_VERTICES],
            vertex_count: 0,
            triangles: [[0; 3]; PACK],
            numbers: [NO_NUMBER; PACK],
            triangle_count: 0,
        };
        // Move the triangles of used slots to the front
        for slot in (0..PACK).filter(|&slot| block.numbers[slot] != NO_NUMBER) {
            let corners = block.triangles.triangle(slot);
            let index = indexed.triangle_count;
            indexed.triangles[index] = corners.map(|corner| indexed.add_vertex(corner));
            indexed.numbers[index] = block.numbers[slot];
            indexed.triangle_count += 1;
        }
        indexed
    }

    /// Returns the index of a vertex, which is added unless it is there.
    fn add_vertex(&mut self, [x, y, z]: [f32; 3]) -> u8 {
        // Look for a vertex of the same bits
        let bits = |vertex: &[f32; 4]| vertex.map(f32::to_bits);
        let vertex = [x, y, z, 0.0];
        let known = self
            .vertices()
            .iter()
            .position(|other| bits(other) == bits(&vertex));
        // Store it, in its place or after the others
        let index = known.unwrap_or(self.vertex_count);
        self.vertices[index] = vertex;
        self.vertex_count = self.vertex_count.max(index + 1);
        index as u8
    }

    /// Returns the positions of the vertices, each with a fourth value that has no meaning.
    #[inline(always)]
    pub(super) fn vertices(&self) -> &[[f32; 4]] {
        &self.vertices[..self.vertex_count]
    }

    /// Returns the vertices of the triangles.
    #[inline(always)]
    pub(super) fn triangles(&self) -> impl Iterator<Item = [usize; 3]> {
        (0..self.triangle_count.min(PACK)).map(|slot| self.triangle(slot))
    }

    /// Returns the vertices of a triangle, all less than [`MAX_VERTICES`].
    #[inline(always)]
    pub(super) fn triangle(&self, slot: usize) -> [usize; 3] {
        let [a, b, c] = self.triangles[slot];
        [index_of(a), index_of(b), index_of(c)]
    }

    /// Returns the position of a vertex.
    #[inline(always)]
    pub(super) fn vertex(&self, index: usize) -> [f32; 3] {
        let [x, y, z, _] = self.vertices[index % MAX_VERTICES];
        [x, y, z]
    }
}

#[inline(always)]
fn index_of(vertex: u8) -> usize {
    usize::from(vertex) % MAX_VERTICES
}

/// Leaves of a tree that packets of rays in any directions traverse; none for a larger tree.
#[derive(Debug)]
pub(super) struct SmallTree(Vec<IndexedBlock>);

impl SmallTree {
    /// Returns the leaves of `tree` if it is small.
    pub(super) fn of(tree: &GroupTree) -> Option<SmallTree> {
        let is_small = tree.root != ChildLink::EMPTY && tree.blocks.len() <= MAX_BLOCKS;
        is_small.then(|| SmallTree(tree.blocks.iter().map(IndexedBlock::of).collect()))
    }

    /// Returns the leaf of a link.
    #[inline(always)]
    pub(super) fn block(&self, link: ChildLink) -> &IndexedBlock {
        &self.0[link.index()]
    }

    /// Returns the size in bytes.
    pub(super) fn byte_count(&self) -> usize {
        size_of_val(&*self.0)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::build::build_tree;
    use super::*;
    use crate::mesh::bumpy_sphere;

    #[test]
    fn leaves_name_each_vertex_once_and_keep_all_triangles() {
        let tree = build_tree(&[&bumpy_sphere(80)]).unwrap();
        let small = SmallTree::of(&tree).unwrap();
        let (mut triangles, mut vertices) = (0, 0);
        for (block, indexed) in tree.blocks.iter().zip(&small.0) {
            let used = (0..PACK).filter(|&slot| block.numbers[slot] != NO_NUMBER);
            for (index, slot) in used.clone().enumerate() {
                let corners = indexed.triangle(index).map(|vertex| indexed.vertex(vertex));
                assert_eq!(corners, block.triangles.triangle(slot));
                assert_eq!(indexed.numbers[index], block.numbers[slot]);
            }
            assert_eq!(indexed.triangles().count(), used.count());
            // No vertex stands twice
            for (index, vertex) in indexed.vertices().iter().enumerate() {
                assert!(!indexed.vertices()[..index].contains(vertex));
            }
            triangles += indexed.triangle_count;
            vertices += indexed.vertex_count;
        }
        // Of a closed mesh, most vertices are shared within a leaf
        assert_eq!(triangles, bumpy_sphere(80).triangles.len());
        assert!(vertices < 2 * triangles, "{vertices} of {triangles}");
    }

    #[test]
    fn zeros_of_different_signs_are_different_vertices() {
        let mut block = LeafBlock {
            triangles: crate::mesh::triangle::TrianglePack::EMPTY,
            numbers: [NO_NUMBER; PACK],
        };
        block.triangles.set(3, [Vec3::ZERO, Vec3::X, -Vec3::ZERO]);
        block.numbers[3] = 7;
        let indexed = IndexedBlock::of(&block);
        assert_eq!((indexed.vertices().len(), indexed.numbers[0]), (3, 7));
    }

    #[test]
    fn large_and_empty_trees_are_not_small() {
        assert!(SmallTree::of(&build_tree(&[&bumpy_sphere(2000)]).unwrap()).is_none());
        assert!(SmallTree::of(&build_tree(&[]).unwrap()).is_none());
    }
}
