//! Packet traversal kernel for sixteen coherent rays.
//!
//! Rays are grouped by octant and by dominant axis, so that within a group the near and far side of every box, the
//! order of cells and the axes of the triangle test are the same for all. A node is first tested against the interval
//! that bounds the whole group, eight children at once; the children that are left are tested against each ray, sixteen
//! at once. Small groups are traced ray by ray.

use super::counters;
use super::error_bounds::Line;
use super::node8::{Child, Leaf, LeafPack, NO_NUMBER, Node8, Tree8, WIDTH};
use super::single::{HitRecord, NodeStack, STACK, hit_of, intersect_instance, trace_lane, trace_singles};
use super::two_level::TwoLevelTree;
use crate::accel::{Coherence, LANES, Query, RayPacket};
use crate::mesh::simd::{SimdLevel, lanes};
use crate::mesh::triangle::{LaneHits, PACK, ShearLanes, dominant_axis};

/// One value per ray of the packet.
type PacketLanes = [f32; LANES];

/// Mask of all sixteen lanes.
const FULL: u32 = (1 << LANES) - 1;
/// Least size of a group that is traced as a packet.
const SMALL_GROUP: u32 = 4;
/// Maximum number of rays at which a leaf is tested eight triangles at a time; above it, sixteen rays at a time.
const FEW_RAYS: u32 = 8;

/// Traces packets: coherent ones in groups, incoherent ones as single rays.
#[inline(always)]
pub(super) fn trace_packets(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    packets: &mut [RayPacket],
    query: Query,
    order: Coherence,
) {
    if order == Coherence::Incoherent {
        return trace_singles(isa, levels, packets, query);
    }
    let root = levels.world.tree.root();
    let mut stacks = NodeStack::pair(root);
    let mut cells = Box::new([(root, 0, 0.0); STACK]);
    for packet in packets {
        packet.drop_untraceable();
        // Classify the rays by octant and dominant axis
        let mut left = packet.active_mask();
        let mut kinds = [0u32; LANES];
        for lane in 0..LANES {
            kinds[lane] = kind(packet, lane);
        }
        while left != 0 {
            // Take the next group of rays of equal kind
            let leader = left.trailing_zeros() as usize % LANES;
            let mut group = 0u32;
            for i in 0..LANES {
                group |= u32::from(kinds[i] == kinds[leader]) << i;
            }
            group &= left;
            left &= !group;
            // Trace a small group ray by ray, a larger one as a packet
            if group.count_ones() < SMALL_GROUP {
                for lane in lanes(group) {
                    trace_lane(isa, levels, (packet, lane % LANES), query, &mut stacks);
                }
            } else {
                let members = [group, kinds[leader]];
                trace_group(
                    isa,
                    levels,
                    (packet, members),
                    query,
                    (&mut cells, &mut stacks[1]),
                );
            }
        }
    }
}

/// Returns the kind of a ray, which is equal within a group: octant in the low three bits, then the dominant axis.
#[inline(always)]
fn kind(packet: &RayPacket, lane: usize) -> u32 {
    let direction = [
        packet.direction[0][lane],
        packet.direction[1][lane],
        packet.direction[2][lane],
    ];
    let falls = |axis: usize| u32::from(direction[axis].is_sign_negative()) << axis;
    falls(0) | falls(1) | falls(2) | (dominant_axis(direction) as u32) << 3
}

/// Stack entry: link to a cell, mask of the rays that intersect it, and least entry parameter.
type StackEntry = (Child, u32, f32);

/// A group of rays with precomputed data. Lanes outside the group have `t_far` below `t_near`.
struct LaneGroup {
    octant: usize,
    origin: [PacketLanes; 3],
    enter: [PacketLanes; 3],
    leave: [PacketLanes; 3],
    t_near: PacketLanes,
    shears: ShearLanes<LANES>,
    line_bounds: PacketBounds,
    best: PacketHits,
}

/// Nearest hits so far, as in [`HitRecord`] for one ray.
struct PacketHits {
    t: PacketLanes,
    u: PacketLanes,
    v: PacketLanes,
    number: [u32; LANES],
    primitive: [u32; LANES],
    /// Largest `t` of all lanes.
    t_last: f32,
    /// Lanes that are still traced; with [`Query::Any`] occluded ones are removed.
    active: u32,
    hit: u32,
}

/// Interval bounds of the lines of a group: minimum and maximum, by axis.
struct PacketBounds {
    origin: [[f32; 2]; 3],
    enter: [[f32; 2]; 3],
    leave: [[f32; 2]; 3],
    t_near: f32,
}

/// Returns the minimum and maximum, reduced by halves: a chain of sixteen comparisons would be bound by latency.
#[inline(always)]
fn range(values: &PacketLanes) -> [f32; 2] {
    let (mut low, mut high) = (*values, *values);
    let mut half = LANES / 2;
    while half > 0 {
        for i in 0..half {
            low[i] = if low[i + half] < low[i] {
                low[i + half]
            } else {
                low[i]
            };
            high[i] = if high[i + half] > high[i] {
                high[i + half]
            } else {
                high[i]
            };
        }
        half /= 2;
    }
    [low[0], high[0]]
}

#[inline(always)]
fn ranges([x, y, z]: &[PacketLanes; 3]) -> [[f32; 2]; 3] {
    [range(x), range(y), range(z)]
}

/// Returns the values of the lanes in `mask`, and that of its first lane elsewhere.
#[inline(always)]
fn fill(row: &PacketLanes, mask: u32) -> PacketLanes {
    if mask == FULL {
        return *row;
    }
    let first = row[mask.trailing_zeros() as usize % LANES];
    let mut out = [first; LANES];
    for i in 0..LANES {
        out[i] = if mask >> i & 1 != 0 { row[i] } else { first };
    }
    out
}

impl LaneGroup {
    #[inline(always)]
    fn new(packet: &RayPacket, [mask, kind]: [u32; 2]) -> LaneGroup {
        // Replace lanes outside the group by copies of its first ray, so that they widen no bound
        let [ox, oy, oz] = &packet.origin;
        let origin = [fill(ox, mask), fill(oy, mask), fill(oz, mask)];
        let [dx, dy, dz] = &packet.direction;
        let direction = [fill(dx, mask), fill(dy, mask), fill(dz, mask)];
        let [enter, leave] = Line::reciprocals(&direction);
        let t_near = fill(&packet.t_near, mask);
        // Clamp the ends, and give lanes outside the group an empty interval
        let mut t = [f32::NEG_INFINITY; LANES];
        for i in 0..LANES {
            let t_far = packet.t_far[i];
            let t_far = if t_far < f32::MAX { t_far } else { f32::MAX };
            t[i] = if mask >> i & 1 != 0 { t_far } else { t[i] };
        }
        // Bound the group's lines by intervals
        LaneGroup {
            octant: kind as usize & 7,
            line_bounds: PacketBounds {
                origin: ranges(&origin),
                enter: ranges(&enter),
                leave: ranges(&leave),
                t_near: range(&t_near)[0],
            },
            shears: ShearLanes::new((kind >> 3) as usize, &origin, &direction),
            origin,
            enter,
            leave,
            t_near,
            best: PacketHits {
                t_last: range(&t)[1],
                t,
                u: [0.0; LANES],
                v: [0.0; LANES],
                number: [u32::MAX; LANES],
                primitive: [u32::MAX; LANES],
                active: mask,
                hit: 0,
            },
        }
    }
}

/// Traces the rays of one group.
#[inline(always)]
fn trace_group(
    isa: impl SimdLevel,
    levels: &TwoLevelTree<Tree8>,
    (packet, members): (&mut RayPacket, [u32; 2]),
    query: Query,
    (cells, object_stack): (&mut [StackEntry; STACK], &mut NodeStack),
) {
    let mut group = LaneGroup::new(packet, members);
    // Traverse the world tree, with shapes and instanced meshes lane by lane
    traverse(
        isa,
        &levels.world.tree,
        &mut group,
        (query, cells),
        |number, lane, best| {
            let mut found = best.found(lane);
            let ray = packet.ray(lane);
            if intersect_instance(isa, levels, (&ray, number), &mut found, (query, object_stack)) {
                best.set(lane, &found, query);
            }
        },
    );
    // Write the results into the packet
    for lane in lanes(group.best.hit) {
        let lane = lane % LANES;
        match query {
            Query::Any => packet.set_blocked(lane),
            Query::Nearest => packet.set_hit(lane, &hit_of(levels, &group.best.found(lane))),
        }
    }
}

/// Traverses one tree. `visit` is called lane by lane with the indices of primitives other than triangles.
#[inline(always)]
fn traverse(
    isa: impl SimdLevel,
    tree: &Tree8,
    group: &mut LaneGroup,
    (query, cells): (Query, &mut [StackEntry; STACK]),
    mut visit: impl FnMut(u32, usize, &mut PacketHits),
) {
    cells[0] = (tree.root(), group.best.active, group.line_bounds.t_near);
    let mut waiting = 1;
    while waiting > 0 {
        // Pop a cell and skip it if no active ray reaches it
        waiting -= 1;
        let (child, mask, enters) = cells[waiting];
        let mask = mask & group.best.active;
        if mask == 0 || enters > group.best.t_last {
            continue;
        }
        // Push the children of an inner node
        if let Some(index) = child.node() {
            waiting = enter(isa, tree.node(index), group, cells, waiting);
            continue;
        }
        // Intersect the triangles of the leaf, for few rays one by one
        let Leaf { packs, wholes } = tree.leaf(child);
        for pack in packs {
            if mask.count_ones() <= FEW_RAYS {
                group.ray_by_ray(isa, pack, mask, query);
            } else {
                group.triangle_by_triangle(isa, pack, query);
            }
        }
        // Intersect shapes and instanced meshes
        for &number in wholes {
            for lane in lanes(mask & group.best.active) {
                visit(number, lane % LANES, &mut group.best);
            }
        }
        if group.best.active == 0 {
            return;
        }
    }
}

/// Pushes the children that any ray intersects, the nearest on top; returns the new stack size.
#[inline(always)]
fn enter(
    isa: impl SimdLevel,
    node: &Node8,
    group: &LaneGroup,
    cells: &mut [StackEntry; STACK],
    waiting: usize,
) -> usize {
    counters::node();
    // Cull the children by the bounds of the whole group
    let (candidates, near) = group
        .line_bounds
        .children(isa, node, group.octant, group.best.t_last);
    let order = node.far_to_near[group.octant & 7];
    let Some(slots) = cells[waiting..].first_chunk_mut::<WIDTH>() else {
        return waiting;
    };
    // Test the rest against each ray and push from far to near
    let mut count = 0;
    for i in 0..WIDTH {
        let slot = (order >> (4 * i)) as usize & (WIDTH - 1);
        if candidates >> slot & 1 == 0 {
            continue;
        }
        let mask = group.hit_mask(isa, node, slot);
        slots[count & (WIDTH - 1)] = (node.children[slot], mask, near[slot]);
        count += usize::from(mask != 0);
    }
    waiting + count
}

impl PacketBounds {
    /// Returns the children that a line of the group may intersect up to `t_last`, and lower bounds on the entry
    /// parameters.
    #[inline(always)]
    fn children(&self, isa: impl SimdLevel, node: &Node8, octant: usize, t_last: f32) -> (u32, [f32; WIDTH]) {
        let mut near = [self.t_near; WIDTH];
        let mut far = [t_last; WIDTH];
        for axis in 0..3 {
            let falls = octant >> axis & 1;
            let near_bounds = &node.bounds[falls][axis];
            let far_bounds = &node.bounds[1 - falls][axis];
            // Origins that are entered first and left last, by the direction along the axis.
            let [least, greatest] = self.origin[axis];
            let (first, last) = if falls == 0 {
                (greatest, least)
            } else {
                (least, greatest)
            };
            let ([enter_a, enter_b], [leave_a, leave_b]) = (self.enter[axis], self.leave[axis]);
            // Take the least product over both bounds of the reciprocal direction for entry, the greatest for exit
            for i in 0..WIDTH {
                let from = near_bounds[i] - first;
                let to = far_bounds[i] - last;
                let (a, b) = (from * enter_a, from * enter_b);
                let t0 = if a < b { a } else { b };
                let (c, d) = (to * leave_a, to * leave_b);
                let t1 = if c > d { c } else { d };
                near[i] = if t0 > near[i] { t0 } else { near[i] };
                far[i] = if t1 < far[i] { t1 } else { far[i] };
            }
        }
        (isa.le(&near, &far), near)
    }
}

impl LaneGroup {
    /// Returns the mask of rays that intersect a child.
    #[inline(always)]
    fn hit_mask(&self, isa: impl SimdLevel, node: &Node8, slot: usize) -> u32 {
        let mut near = self.t_near;
        let mut far = self.best.t;
        for axis in 0..3 {
            let falls = self.octant >> axis & 1;
            let near_bound = node.bounds[falls][axis][slot];
            let far_bound = node.bounds[1 - falls][axis][slot];
            for i in 0..LANES {
                let t0 = (near_bound - self.origin[axis][i]) * self.enter[axis][i];
                let t1 = (far_bound - self.origin[axis][i]) * self.leave[axis][i];
                near[i] = if t0 > near[i] { t0 } else { near[i] };
                far[i] = if t1 < far[i] { t1 } else { far[i] };
            }
        }
        isa.le(&near, &far)
    }

    #[inline(always)]
    fn ray_by_ray(&mut self, isa: impl SimdLevel, pack: &LeafPack, mask: u32, query: Query) {
        for lane in lanes(mask & self.best.active) {
            let lane = lane % LANES;
            counters::pack();
            let shear = self.shears.lane(lane);
            let mut found = self.best.found(lane);
            let hits = shear.intersect_pack(isa, &pack.triangles, self.t_near[lane], found.t);
            let before = found.number;
            for slot in lanes(hits.mask) {
                let slot = slot % PACK;
                if found.is_beaten_by(hits.t[slot], pack.numbers[slot]) {
                    found = HitRecord {
                        t: hits.t[slot],
                        u: hits.u[slot],
                        v: hits.v[slot],
                        number: pack.numbers[slot],
                        primitive: 0,
                    };
                }
            }
            if found.number != before {
                self.best.set(lane, &found, query);
            }
        }
    }

    #[inline(always)]
    fn triangle_by_triangle(&mut self, isa: impl SimdLevel, pack: &LeafPack, query: Query) {
        for slot in 0..PACK {
            let number = pack.numbers[slot];
            if number == NO_NUMBER {
                break;
            }
            counters::triangle();
            let hits = self
                .shears
                .intersect(isa, pack.triangles.triangle(slot), &self.t_near, &self.best.t);
            if hits.mask != 0 {
                self.best.merge(&hits, number, query);
            }
        }
    }
}

impl PacketHits {
    #[inline(always)]
    fn found(&self, lane: usize) -> HitRecord {
        HitRecord {
            t: self.t[lane],
            u: self.u[lane],
            v: self.v[lane],
            number: self.number[lane],
            primitive: self.primitive[lane],
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, found: &HitRecord, query: Query) {
        self.hit |= 1 << lane;
        self.t[lane] = found.t;
        self.u[lane] = found.u;
        self.v[lane] = found.v;
        self.number[lane] = found.number;
        self.primitive[lane] = found.primitive;
        self.retire_hits(1 << lane, query);
    }

    /// Records the hits on one triangle.
    #[inline(always)]
    fn merge(&mut self, hits: &LaneHits<LANES>, number: u32, query: Query) {
        self.hit |= hits.mask;
        for lane in lanes(hits.mask) {
            let lane = lane % LANES;
            if self.found(lane).is_beaten_by(hits.t[lane], number) {
                self.t[lane] = hits.t[lane];
                self.u[lane] = hits.u[lane];
                self.v[lane] = hits.v[lane];
                self.number[lane] = number;
                self.primitive[lane] = 0;
            }
        }
        self.retire_hits(hits.mask, query);
    }

    /// Removes lanes that were hit, with [`Query::Any`], and updates the largest `t`.
    #[inline(always)]
    fn retire_hits(&mut self, hit: u32, query: Query) {
        if query == Query::Any {
            self.active &= !hit;
            for lane in lanes(hit) {
                self.t[lane % LANES] = f32::NEG_INFINITY;
            }
        }
        self.t_last = range(&self.t)[1];
    }
}
