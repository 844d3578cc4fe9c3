//! Node layout of the fast kernels: eight cells per node, each with the bounding box of its contents.
//!
//! The cells of a node are disjoint, like those of the binary tree that it is made from; so for each octant of
//! directions there is one order, stored with the node, in which a ray visits them. The boxes cut off empty space on
//! all six sides at once, which planes alone cannot. They are widened by the [`SlabError`], so they may overlap a
//! little; a kernel therefore never takes the first hit for the nearest, but continues until everything left lies
//! beyond it.

use super::builder::{Branch, CellContent};
use super::error_bounds::SlabError;
use super::piece::CellBounds;
use super::primitives::Primitives;
use super::two_level::TreeLayout;
use crate::mesh::triangle::{PACK, TrianglePack};
use crate::parallel;

/// Number of children of a node.
pub(super) const WIDTH: usize = 8;
/// Index in an unused slot of a pack.
pub(super) const NO_NUMBER: u32 = u32::MAX;

/// A node of eight cells.
#[repr(C, align(64))]
#[derive(Clone, Copy)]
pub(super) struct Node8 {
    /// Bounds by side (low, high), axis and child. Unused children have empty boxes.
    pub(super) bounds: [[[f32; WIDTH]; 3]; 2],
    /// Contents of the cells: nodes or leaves.
    pub(super) children: [Child; WIDTH],
    /// Child order from far to near, four bits each, by octant (bit `a` set where the direction is negative along axis
    /// `a`).
    pub(super) far_to_near: [u32; 8],
}

/// Link to a node, or to a leaf with its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u32);

const LEAF: u32 = 1 << 31;
const PACK_COUNT_SHIFT: u32 = 27;
const PACK_COUNT_MASK: u32 = 15;
const FIRST_PACK_MASK: u32 = (1 << PACK_COUNT_SHIFT) - 1;

impl Child {
    /// Returns the index of the node, or `None` for a leaf.
    #[inline(always)]
    pub(super) fn node(self) -> Option<usize> {
        (self.0 & LEAF == 0).then_some(self.0 as usize)
    }
}

/// Eight triangles with their indices.
#[repr(C, align(64))]
#[derive(Clone, Copy, bytemuck::Zeroable)]
pub(super) struct LeafPack {
    /// Vertices of the triangles; NaN in unused slots.
    pub(super) triangles: TrianglePack,
    /// Indices in ascending order; [`NO_NUMBER`] in unused slots, which come last.
    pub(super) numbers: [u32; PACK],
}

/// A leaf that is too long for a [`Child`], or contains shapes or instanced meshes.
#[derive(Clone, Copy)]
struct LongLeaf {
    first_pack: u32,
    pack_count: u32,
    first_whole: u32,
    whole_count: u32,
}

/// A tree of eight-wide nodes.
pub(super) struct Tree8 {
    nodes: Vec<Node8>,
    packs: Vec<LeafPack>,
    long_leaves: Vec<LongLeaf>,
    /// Indices of the shapes and instanced meshes in leaves, which are intersected as a whole.
    wholes: Vec<u32>,
}

/// Contents of a leaf.
#[derive(Clone, Copy)]
pub(super) struct Leaf<'a> {
    /// Triangles of the leaf, in packs of eight.
    pub(super) packs: &'a [LeafPack],
    /// Indices of its shapes and instanced meshes.
    pub(super) wholes: &'a [u32],
}

impl TreeLayout for Tree8 {
    fn lay_out(root: &Branch, primitives: &Primitives) -> Option<Tree8> {
        let mut layout = LayoutBuilder {
            primitives,
            slab_error: SlabError::of(&root.cell),
            nodes: Vec::new(),
            slots: Vec::new(),
            long_leaves: Vec::new(),
            wholes: Vec::new(),
        };
        layout.add_node(root)?;
        let slots = &layout.slots;
        let packs = parallel::generate(slots.len(), |index| pack(&slots[index], primitives));
        Some(Tree8 {
            nodes: layout.nodes,
            packs,
            long_leaves: layout.long_leaves,
            wholes: layout.wholes,
        })
    }

    fn byte_count(&self) -> u64 {
        (size_of_val(&*self.nodes)
            + size_of_val(&*self.packs)
            + size_of_val(&*self.long_leaves)
            + size_of_val(&*self.wholes)) as u64
    }
}

impl Tree8 {
    /// Returns the link to the root.
    #[inline(always)]
    pub(super) fn root(&self) -> Child {
        Child(0)
    }

    /// Returns a node by its index.
    #[inline(always)]
    pub(super) fn node(&self, index: usize) -> &Node8 {
        &self.nodes[index]
    }

    /// Returns the contents of a leaf by its link.
    #[inline(always)]
    pub(super) fn leaf(&self, child: Child) -> Leaf<'_> {
        let count = (child.0 >> PACK_COUNT_SHIFT & PACK_COUNT_MASK) as usize;
        let first = (child.0 & FIRST_PACK_MASK) as usize;
        if count > 0 {
            return Leaf {
                packs: &self.packs[first..first + count],
                wholes: &[],
            };
        }
        let long = &self.long_leaves[first];
        Leaf {
            packs: &self.packs[long.first_pack as usize..][..long.pack_count as usize],
            wholes: &self.wholes[long.first_whole as usize..][..long.whole_count as usize],
        }
    }
}

fn pack(slots: &[u32; PACK], primitives: &Primitives) -> LeafPack {
    let mut triangles = TrianglePack::EMPTY;
    for (lane, &number) in slots.iter().enumerate() {
        if number != NO_NUMBER
            && let Some(corners) = primitives.corners(number)
        {
            triangles.set(lane, corners);
        }
    }
    LeafPack {
        triangles,
        numbers: *slots,
    }
}

/// A layout under construction.
struct LayoutBuilder<'a> {
    primitives: &'a Primitives<'a>,
    slab_error: SlabError,
    nodes: Vec<Node8>,
    /// Triangle indices of each future pack.
    slots: Vec<[u32; PACK]>,
    long_leaves: Vec<LongLeaf>,
    wholes: Vec<u32>,
}

impl LayoutBuilder<'_> {
    /// Adds the node for the upper levels of `branch` and everything below; returns its index.
    fn add_node(&mut self, branch: &Branch) -> Option<u32> {
        let family = gather(branch);
        let mut node = Node8 {
            bounds: [[[f32::INFINITY; WIDTH]; 3], [[f32::NEG_INFINITY; WIDTH]; 3]],
            children: [Child(LEAF); WIDTH],
            far_to_near: std::array::from_fn(|octant| far_to_near(branch, &family, octant)),
        };
        let index = self.nodes.len();
        // Reserve the slot, so that a parent comes before its children
        self.nodes.push(node);
        // Widen the boxes and add the children
        for (slot, member) in family.iter().enumerate() {
            for axis in 0..3 {
                node.bounds[0][axis][slot] = self.slab_error.below(member.cell.low[axis]);
                node.bounds[1][axis][slot] = self.slab_error.above(member.cell.high[axis]);
            }
            node.children[slot] = match &member.content {
                CellContent::Leaf(numbers) => self.add_leaf(numbers)?,
                CellContent::Split { .. } => Child(self.add_node(member)?),
            };
        }
        self.nodes[index] = node;
        u32::try_from(index).ok().filter(|index| index & LEAF == 0)
    }

    fn add_leaf(&mut self, numbers: &[u32]) -> Option<Child> {
        let first_pack = self.slots.len();
        let first_whole = self.wholes.len();
        // Distribute the triangles over packs of eight
        let mut used = PACK;
        for &number in numbers {
            if self.primitives.corners(number).is_none() {
                self.wholes.push(number);
                continue;
            }
            if used == PACK {
                self.slots.push([NO_NUMBER; PACK]);
                used = 0;
            }
            if let Some(slots) = self.slots.last_mut() {
                slots[used] = number;
            }
            used += 1;
        }
        let pack_count = self.slots.len() - first_pack;
        let whole_count = self.wholes.len() - first_whole;
        // Link the leaf directly, or through a record if it is long or contains other primitives
        let first = u32::try_from(first_pack)
            .ok()
            .filter(|&first| first <= FIRST_PACK_MASK)?;
        if whole_count == 0 && (1..=PACK_COUNT_MASK as usize).contains(&pack_count) {
            return Some(Child(LEAF | (pack_count as u32) << PACK_COUNT_SHIFT | first));
        }
        // A pack count of 0 in the link marks a long leaf
        let index = u32::try_from(self.long_leaves.len())
            .ok()
            .filter(|&index| index <= FIRST_PACK_MASK)?;
        self.long_leaves.push(LongLeaf {
            first_pack: first,
            pack_count: u32::try_from(pack_count).ok()?,
            first_whole: u32::try_from(first_whole).ok()?,
            whole_count: u32::try_from(whole_count).ok()?,
        });
        Some(Child(LEAF | index))
    }
}

/// Returns whether a branch is an empty leaf.
fn is_empty(branch: &Branch) -> bool {
    matches!(&branch.content, CellContent::Leaf(numbers) if numbers.is_empty())
}

/// Collects up to eight cells for a node: the largest inner cell is opened as long as there is room.
fn gather(branch: &Branch) -> Vec<&Branch> {
    let mut family = vec![branch];
    while family.len() < WIDTH {
        let area = |cell: &CellBounds| cell.half_area();
        let largest = family
            .iter()
            .enumerate()
            .filter(|(_, member)| matches!(member.content, CellContent::Split { .. }))
            .max_by(|(_, a), (_, b)| area(&a.cell).total_cmp(&area(&b.cell)))
            .map(|(position, _)| position);
        let Some(position) = largest else { break };
        if let CellContent::Split { halves, .. } = &family[position].content {
            family.splice(position..=position, halves.iter());
        }
    }
    family.retain(|member| !is_empty(member));
    family
}

/// Returns the slots of `family` in the order in which a ray of that octant visits them, the last first.
fn far_to_near(branch: &Branch, family: &[&Branch], octant: usize) -> u32 {
    // Traverse the binary cells near side first
    let mut near_to_far = Vec::with_capacity(WIDTH);
    let mut waiting = vec![branch];
    while let Some(member) = waiting.pop() {
        if let Some(slot) = family.iter().position(|other| std::ptr::eq(*other, member)) {
            near_to_far.push(slot as u32);
        } else if let CellContent::Split { axis, halves, .. } = &member.content {
            let near = octant >> axis & 1;
            waiting.push(&halves[1 - near]);
            waiting.push(&halves[near]);
        }
    }
    // Unused slots have empty boxes and may come anywhere.
    let unused = (family.len()..WIDTH).map(|slot| slot as u32);
    near_to_far
        .into_iter()
        .rev()
        .chain(unused)
        .enumerate()
        .fold(0, |order, (i, slot)| order | slot << (4 * i))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leaf(low: f32, high: f32) -> Branch {
        Branch {
            cell: CellBounds {
                low: [low, 0.0, 0.0],
                high: [high, 1.0, 1.0],
            },
            content: CellContent::Leaf([0].into()),
        }
    }

    fn split(position: f32, halves: [Branch; 2]) -> Branch {
        Branch {
            cell: CellBounds {
                low: halves[0].cell.low,
                high: halves[1].cell.high,
            },
            content: CellContent::Split {
                axis: 0,
                position,
                halves: Box::new(halves),
            },
        }
    }

    #[test]
    fn cells_are_visited_in_order_along_the_ray() {
        let row = split(
            2.0,
            [leaf(0.0, 2.0), split(3.0, [leaf(2.0, 3.0), leaf(3.0, 4.0)])],
        );
        let family = gather(&row);
        let lows: Vec<f32> = family.iter().map(|member| member.cell.low[0]).collect();
        assert_eq!(lows, [0.0, 2.0, 3.0]);
        // Far to near for a ray that rises along x: slots 2, 1, 0; for one that falls along x: 0, 1, 2; unused slots
        // after.
        assert_eq!(far_to_near(&row, &family, 0), 0x7654_3012);
        assert_eq!(far_to_near(&row, &family, 1), 0x7654_3210);
    }

    #[test]
    fn link_distinguishes_node_from_leaf() {
        assert_eq!(Child(5).node(), Some(5));
        assert_eq!(Child(LEAF | 5).node(), None);
    }
}
