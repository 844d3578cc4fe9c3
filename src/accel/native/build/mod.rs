//! Builder of the tree along Morton's curve.
//!
//! 1. [`crate::accel::morton`]: sort the triangles by the Morton codes of their centres, and cut the order into chunks of
//!    a few hundred.
//! 2. [`blocks`]: fill blocks with eight triangles each, in order, and build the tree of each chunk by the surface area
//!    heuristic along the order ([`sweep`]).
//! 3. [`top`]: build the tree over the chunks by the binned surface area heuristic (I. Wald, "On fast Construction of
//!    SAH-based Bounding Volume Hierarchies", 2007).
//!
//! The tree is the same for any number of threads.

mod blocks;
mod margin;
mod nodes;
mod sweep;
mod top;
mod triangles;

use crate::accel::morton;
use crate::accel::native::layout::{Box3, ChildLink, GroupTree};
use crate::buffer::BufferMut;
use crate::mesh::Mesh;
use blocks::Forest;
use margin::Margin;
use triangles::NumberedTriangles;

/// Maximum number of triangles of the meshes together: indices are compared as i32.
const MAX_TRIANGLES: usize = i32::MAX as usize;
/// Maximum number of triangles of a chunk.
const CHUNK: usize = 512;

/// Builds the tree over the triangles of `meshes` in the current rayon pool; `None` if there are more than
/// [`MAX_TRIANGLES`].
///
/// A triangle's number is its index in the meshes one after the other. Coordinates must be finite.
pub(super) fn build_tree(meshes: &[&Mesh]) -> Option<GroupTree> {
    let triangles = NumberedTriangles::new(meshes).filter(|triangles| triangles.count <= MAX_TRIANGLES)?;
    if triangles.count == 0 {
        return Some(GroupTree {
            root: ChildLink::EMPTY,
            bounds: Box3 {
                low: [0.0; 3],
                high: [0.0; 3],
            },
            nodes: BufferMut::default(),
            blocks: BufferMut::default(),
        });
    }
    let bounds = triangles.vertex_bounds();
    // Sort the triangles and cut their order into chunks
    let twice_centre = |number| triangles.twice_centre(number);
    let mut keys = morton::sorted(triangles.count, &bounds, twice_centre);
    let chunks = morton::cut(&mut keys, CHUNK, twice_centre);
    // Build the trees of the chunks, then that over them
    let margin = Margin::of(&bounds);
    let Forest {
        mut nodes,
        blocks,
        trees,
    } = blocks::build(&triangles, &keys, &chunks, margin);
    drop(keys);
    let root = top::build(trees, &mut nodes, margin);
    Some(GroupTree {
        root,
        bounds: Box3 {
            low: bounds.low.to_array(),
            high: bounds.high.to_array(),
        },
        nodes,
        blocks,
    })
}

#[cfg(test)]
mod tests;
