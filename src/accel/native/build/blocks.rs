//! Blocks of eight triangles each, and the trees of the chunks.

use std::sync::Mutex;

use crate::buffer::BufferMut;
use crate::mesh::triangle::{PACK, TrianglePack};
use crate::parallel;
use glam::Vec3A;

use super::margin::Margin;
use super::nodes::{ItemRange, NodeSlots, max_node_count};
use super::sweep::OrderSweep;
use super::triangles::NumberedTriangles;
use crate::accel::morton::{Box4, MortonChunk, SortedKeys};
use crate::accel::native::layout::{ChildLink, LeafBlock, NO_NUMBER, NativeNode};

/// Least number of triangles of a task.
const TASK: usize = 1 << 13;

/// Trees of all chunks.
pub(super) struct Forest {
    /// Nodes of the chunks, with room for those above them behind.
    pub(super) nodes: BufferMut<NativeNode>,
    pub(super) blocks: BufferMut<LeafBlock>,
    pub(super) trees: Vec<ChunkTree>,
}

/// Tree of one chunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkTree {
    pub(super) root: ChildLink,
    pub(super) bounds: Box4,
    pub(super) block_count: u32,
}

/// Some chunks in a row, with the room for their blocks and nodes.
struct ForestTask<'a> {
    chunks: &'a [MortonChunk],
    blocks: &'a mut [LeafBlock],
    nodes: &'a mut [NativeNode],
    trees: &'a mut [ChunkTree],
    first_block: usize,
    first_node: usize,
}

/// Fills the blocks and builds the trees of all chunks.
pub(super) fn build(
    triangles: &NumberedTriangles,
    keys: &SortedKeys,
    chunks: &[MortonChunk],
    margin: Margin,
) -> Forest {
    // Allocate the blocks and nodes of all chunks; their pages are zeroed as each task comes to them
    let block_count = chunks.iter().map(block_count_of).sum();
    let node_count: usize = chunks
        .iter()
        .map(|chunk| max_node_count(block_count_of(chunk)))
        .sum();
    let mut blocks = BufferMut::<LeafBlock>::zeroed(block_count);
    let mut nodes = BufferMut::<NativeNode>::zeroed(node_count + max_node_count(chunks.len()));
    let empty = ChunkTree {
        root: ChildLink::EMPTY,
        bounds: Box4::EMPTY,
        block_count: 0,
    };
    let mut trees = vec![empty; chunks.len()];
    // Build the trees in parallel
    let tasks = divide(chunks, &mut blocks, &mut nodes, &mut trees);
    parallel::for_each(tasks.len(), &|task| {
        if let Ok(mut task) = tasks[task].lock() {
            task.run(triangles, keys, margin);
        }
    });
    drop(tasks);
    Forest { nodes, blocks, trees }
}

/// Returns the number of blocks of a chunk's triangles.
fn block_count_of(chunk: &MortonChunk) -> usize {
    chunk.len().div_ceil(PACK)
}

/// Divides the chunks into tasks, each with its room in the arrays.
fn divide<'a>(
    mut chunks: &'a [MortonChunk],
    mut blocks: &'a mut [LeafBlock],
    mut nodes: &'a mut [NativeNode],
    mut trees: &'a mut [ChunkTree],
) -> Vec<Mutex<ForestTask<'a>>> {
    let mut tasks = Vec::new();
    let (mut first_block, mut first_node) = (0, 0);
    while !chunks.is_empty() {
        // Take chunks until there is enough to do
        let (mut taken, mut triangle_count, mut block_count, mut node_count) = (0, 0, 0, 0);
        while taken < chunks.len() && triangle_count < TASK {
            let chunk = chunks[taken];
            taken += 1;
            triangle_count += chunk.len();
            block_count += block_count_of(&chunk);
            node_count += max_node_count(block_count_of(&chunk));
        }
        // Cut off their part of every array
        let (chunks_here, chunks_left) = chunks.split_at(taken);
        let (blocks_here, blocks_left) = blocks.split_at_mut(block_count);
        let (nodes_here, nodes_left) = nodes.split_at_mut(node_count);
        let (trees_here, trees_left) = trees.split_at_mut(taken);
        (chunks, blocks, nodes, trees) = (chunks_left, blocks_left, nodes_left, trees_left);
        tasks.push(Mutex::new(ForestTask {
            chunks: chunks_here,
            blocks: blocks_here,
            nodes: nodes_here,
            trees: trees_here,
            first_block,
            first_node,
        }));
        first_block += block_count;
        first_node += node_count;
    }
    tasks
}

impl ForestTask<'_> {
    fn run(&mut self, triangles: &NumberedTriangles, keys: &SortedKeys, margin: Margin) {
        let mut boxes = Vec::new();
        let mut behind = Vec::new();
        let (mut next_block, mut next_node) = (0, 0);
        for (chunk, tree) in self.chunks.iter().zip(&mut *self.trees) {
            // Fill the blocks in order
            boxes.clear();
            let mut bounds = Box4::EMPTY;
            for first in (chunk.first..chunk.end).step_by(PACK) {
                let block = &mut self.blocks[next_block + boxes.len()];
                let block_bounds = fill(block, triangles, keys, first..chunk.end.min(first + PACK));
                bounds.add(&block_bounds);
                boxes.push(block_bounds);
            }
            // Build the tree over them
            let mut sweep = OrderSweep {
                boxes: &boxes,
                first_block: self.first_block + next_block,
                behind: &mut behind,
            };
            let slots = &mut self.nodes[next_node..];
            let mut slots = NodeSlots::new(slots, self.first_node + next_node, margin);
            let root = slots.add(&mut sweep, &ItemRange::new(0, boxes.len(), bounds), 0);
            // Continue behind its blocks and nodes
            next_block += boxes.len();
            next_node += slots.used();
            *tree = ChunkTree {
                root,
                bounds,
                block_count: boxes.len() as u32,
            };
        }
    }
}

/// Fills a block with the triangles at some positions of the order; returns its bounds.
#[inline(always)]
fn fill(
    block: &mut LeafBlock,
    triangles: &NumberedTriangles,
    keys: &SortedKeys,
    positions: std::ops::Range<usize>,
) -> Box4 {
    // Clear the slots that stay unused
    let mut bounds = Box4::EMPTY;
    if positions.len() < PACK {
        block.triangles = TrianglePack::EMPTY;
        block.numbers = [NO_NUMBER; PACK];
    }
    // Copy the vertices, transposed, and the numbers
    for (lane, position) in positions.enumerate() {
        let number = keys.number(position);
        let corners: [Vec3A; 3] = triangles.corners(number);
        for (rows, corner) in block.triangles.corners.iter_mut().zip(corners) {
            bounds.add_point(corner);
            let [x, y, z] = corner.to_array();
            rows[0][lane] = x;
            rows[1][lane] = y;
            rows[2][lane] = z;
        }
        block.numbers[lane] = number as u32;
    }
    bounds
}
