//! Traversal of small trees with packets of sixteen rays in any directions.
//!
//! In a tree of a few hundred triangles most nodes are entered by some ray of any packet. Testing one box, or one
//! triangle, with all rays at once then takes less time than tracing the rays one after the other. The triangle test is
//! the watertight one of `mesh::triangle`, so results are those of the other backends.

use crate::accel::bsp::error_bounds::Line;
use crate::accel::{Hit, LANES, Query, RayPacket};
use crate::mesh::simd::{SimdKernel, SimdLevel, dispatch_sixteen, lanes};
use crate::mesh::triangle::{
    AxisOrders, HitLanes, OwnAxes, PACK, ShearLanes, ShearedVertex, may_contain_origin,
};
use crate::numeric::{Lanes, Lanes3};

use super::layout::{ChildLink, NO_NUMBER, NativeNode, STACK, TreeView, WIDTH};
use super::single;
use super::small_tree::{IndexedBlock, MAX_VERTICES, SmallTree};

/// Least number of active lanes of a packet whose rays are traced together: of sixteen rays through 40 triangles packets take
/// 0.6 of the time of single rays, of eight 0.9 (`cargo bench --bench timing -- small_trees`).
const MIN_LANES: u32 = 8;

/// Finds the hits of every active lane for a query: packet by packet, those of few rays one by one.
pub(super) fn trace(tree: TreeView, small: &SmallTree, packets: &mut [RayPacket], query: Query) {
    // Trace packets of many rays together
    let sparse = dispatch_sixteen(SmallTreePackets {
        tree,
        small,
        packets,
        query,
    });
    // Trace what they leave over ray by ray, by a kernel that is compiled for registers of eight
    if sparse > 0 {
        single::trace_sparse(tree, packets, query, sparse);
    }
}

/// Packets that traverse a small tree.
struct SmallTreePackets<'a> {
    tree: TreeView<'a>,
    small: &'a SmallTree,
    packets: &'a mut [RayPacket],
    query: Query,
}

impl SimdKernel for SmallTreePackets<'_> {
    /// Number of active lanes below which packets are left to be traced; 0 if there are none.
    type Output = u32;

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> u32 {
        // With registers of eight lanes packets take as long as single rays
        if !I::HAS_SIXTEEN {
            return u32::MAX;
        }
        let mut memory = TraversalMemory::new();
        let mut sparse = 0;
        for packet in self.packets {
            packet.drop_untraceable();
            let active = packet.active_mask();
            if active.count_ones() >= MIN_LANES {
                trace_together(
                    isa,
                    (self.tree, self.small),
                    packet,
                    active,
                    self.query,
                    &mut memory,
                );
            } else {
                sparse = MIN_LANES;
            }
        }
        sparse
    }
}

/// Traces the rays of the mask `active` of a packet together, and writes the results into it.
#[inline(always)]
fn trace_together(
    isa: impl SimdLevel,
    tree: (TreeView, &SmallTree),
    packet: &mut RayPacket,
    active: u32,
    query: Query,
    memory: &mut TraversalMemory,
) {
    let mut rays = PacketRays::new(packet, active);
    rays.traverse(isa, tree, query, memory);
    rays.write(packet, query);
}

/// Node or block that waits for its visit.
#[derive(Clone, Copy)]
struct WaitingChild {
    child: ChildLink,
    /// Mask of the rays that enter its box.
    rays: u32,
}

impl WaitingChild {
    const NONE: WaitingChild = WaitingChild {
        child: ChildLink::EMPTY,
        rays: 0,
    };
}

/// Working memory of a traversal.
struct TraversalMemory {
    stack: [WaitingChild; STACK],
    /// Vertices of a leaf in the frames of the rays.
    vertices: [ShearedVertex<LANES>; MAX_VERTICES],
}

impl TraversalMemory {
    #[inline(always)]
    fn new() -> TraversalMemory {
        TraversalMemory {
            stack: [WaitingChild::NONE; STACK],
            vertices: [ShearedVertex::ZERO; MAX_VERTICES],
        }
    }
}

/// Rays of a packet with precomputed data, and their nearest hits.
#[repr(C, align(64))]
struct PacketRays {
    origin: Lanes3<f32>,
    /// Reciprocal directions of entry and exit, as in [`Line`].
    enter: Lanes3<f32>,
    leave: Lanes3<f32>,
    shears: ShearLanes<LANES, OwnAxes<LANES>>,
    axes: AxisOrders<LANES>,
    t_near: Lanes<f32>,
    /// Parameters of the nearest hits, or of the rays' ends.
    t: Lanes<f32>,
    /// Barycentric weights of the hits times their determinants.
    weights: [Lanes<f32>; 2],
    det: Lanes<f32>,
    /// Numbers of the triangles hit; [`NO_NUMBER`] for none.
    numbers: Lanes<u32>,
    /// Mask of the rays that are still traced.
    active: u32,
}

impl PacketRays {
    #[inline(always)]
    fn new(packet: &RayPacket, active: u32) -> PacketRays {
        // Prepare the rays for the tests of boxes and triangles
        let [enter, leave] = Line::reciprocals(&packet.direction);
        let shears = ShearLanes::of_each(&packet.origin, &packet.direction);
        // Give the other lanes an empty interval
        let mut t = [f32::NEG_INFINITY; LANES];
        for lane in 0..LANES {
            let t_far = packet.t_far[lane];
            let t_far = if t_far < f32::MAX { t_far } else { f32::MAX };
            t[lane] = if packet.active[lane] != 0 { t_far } else { t[lane] };
        }
        PacketRays {
            origin: packet.origin,
            enter,
            leave,
            axes: AxisOrders::of(&shears.axes),
            shears,
            t_near: packet.t_near,
            active,
            t,
            weights: [[0.0; LANES]; 2],
            det: [1.0; LANES],
            numbers: [NO_NUMBER; LANES],
        }
    }

    /// Finds the nearest hits, or any with [`Query::Any`].
    #[inline(always)]
    fn traverse(
        &mut self,
        isa: impl SimdLevel,
        (tree, small): (TreeView, &SmallTree),
        query: Query,
        TraversalMemory { stack, vertices }: &mut TraversalMemory,
    ) {
        // Start at the root
        stack[0] = WaitingChild {
            child: tree.root,
            rays: self.active,
        };
        let mut count = 1;
        while count > 0 {
            // Skip what no ray enters that is still traced
            count -= 1;
            let WaitingChild { child, rays } = stack[count];
            let rays = rays & self.active;
            if rays == 0 {
                continue;
            }
            // Intersect the triangles of a leaf, or the boxes of a node
            if child.is_leaf() {
                self.intersect_block(isa, (small.block(child), vertices), rays, query);
            } else {
                let node = &tree.nodes[child.index()];
                for slot in 0..WIDTH {
                    let rays = self.entering(isa, node, slot) & rays;
                    if rays != 0 {
                        stack[count % STACK] = WaitingChild {
                            child: node.children[slot],
                            rays,
                        };
                        count += 1;
                    }
                }
            }
        }
    }

    /// Returns the mask of the rays that intersect the box of a child by the slab method.
    #[inline(always)]
    fn entering(&self, isa: impl SimdLevel, node: &NativeNode, slot: usize) -> u32 {
        let (mut near, mut far) = (self.t_near, self.t);
        for axis in 0..3 {
            // Enter by the bound that the ray reaches first
            let [low, high] = [node.bounds[0][axis][slot], node.bounds[1][axis][slot]];
            for lane in 0..LANES {
                let rises = self.enter[axis][lane].is_sign_positive();
                let (first, last) = if rises { (low, high) } else { (high, low) };
                let t0 = (first - self.origin[axis][lane]) * self.enter[axis][lane];
                let t1 = (last - self.origin[axis][lane]) * self.leave[axis][lane];
                // NaN, from a ray within a face, leaves the interval unchanged
                near[lane] = if t0 > near[lane] { t0 } else { near[lane] };
                far[lane] = if t1 < far[lane] { t1 } else { far[lane] };
            }
        }
        isa.le(&near, &far)
    }

    /// Intersects the triangles of a leaf with the rays of the mask `rays`.
    #[inline(always)]
    fn intersect_block(
        &mut self,
        isa: impl SimdLevel,
        (block, sheared): (&IndexedBlock, &mut [ShearedVertex<LANES>; MAX_VERTICES]),
        rays: u32,
        query: Query,
    ) {
        // Transform each vertex once for all triangles that share it
        for (vertex, sheared) in block.vertices().iter().zip(sheared.iter_mut()) {
            *sheared = self.shears.sheared_along(&self.axes.along(isa, vertex));
        }
        // Find the rays whose lines may intersect the triangles
        let (mut masks, mut members) = ([0; PACK], 0);
        for (slot, [a, b, c]) in block.triangles().enumerate() {
            let corners = [
                &sheared[a].projected,
                &sheared[b].projected,
                &sheared[c].projected,
            ];
            masks[slot] = may_contain_origin(isa, corners) & rays;
            members |= u32::from(masks[slot] != 0) << slot;
        }
        // Intersect the remaining triangles
        for slot in lanes(members) {
            let slot = slot % PACK;
            let ([a, b, c], number) = (block.triangle(slot), block.numbers[slot]);
            let vertices = [&sheared[a], &sheared[b], &sheared[c]];
            let active = masks[slot] & self.active;
            // Leave out triangles behind all rays, before the division
            let active = self.shears.starting_before(isa, vertices, active);
            if active == 0 {
                continue;
            }
            let corners = [block.vertex(a), block.vertex(b), block.vertex(c)];
            let interval = [&self.t_near, &self.t];
            let hits = self
                .shears
                .intersect_sheared(isa, vertices, corners, active, interval);
            // Keep the nearest hits, or retire the rays that are blocked
            match query {
                Query::Nearest => self.keep_nearest(&hits, number),
                Query::Any => self.active &= !hits.mask,
            }
        }
    }

    /// Keeps hits that are nearer than the others of their rays, of equals that of the lowest number.
    #[inline(always)]
    fn keep_nearest(&mut self, hits: &HitLanes<LANES>, number: u32) {
        for lane in 0..LANES {
            // Compare it with the hit so far
            let is_hit = hits.mask >> lane & 1 != 0;
            let is_nearer = hits.t[lane] < self.t[lane];
            let is_lower = (hits.t[lane] == self.t[lane]) & (number < self.numbers[lane]);
            let is_taken = is_hit & (is_nearer | is_lower);
            // Replace it, with weights that are not yet divided
            self.t[lane] = if is_taken { hits.t[lane] } else { self.t[lane] };
            self.det[lane] = if is_taken { hits.det[lane] } else { self.det[lane] };
            for i in 0..2 {
                let (new, old) = (hits.weights[i][lane], self.weights[i][lane]);
                self.weights[i][lane] = if is_taken { new } else { old };
            }
            self.numbers[lane] = if is_taken { number } else { self.numbers[lane] };
        }
    }

    /// Writes the results into the packet.
    #[inline(always)]
    fn write(&self, packet: &mut RayPacket, query: Query) {
        for lane in 0..LANES {
            if packet.active[lane] == 0 {
                continue;
            }
            match query {
                Query::Any if self.active >> lane & 1 == 0 => packet.set_blocked(lane),
                Query::Nearest if self.numbers[lane] != NO_NUMBER => packet.set_hit(
                    lane,
                    &Hit {
                        instance: 0,
                        primitive: self.numbers[lane],
                        t: self.t[lane],
                        u: self.weights[0][lane] / self.det[lane],
                        v: self.weights[1][lane] / self.det[lane],
                    },
                ),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::testing::random_packets;
    use crate::mesh::bumpy_sphere;
    use crate::mesh::simd::{Scalar, dispatch};

    /// Kernel that traces all packets as such, whatever the instruction set and their numbers of rays.
    struct Together<'a>((TreeView<'a>, &'a SmallTree), Vec<RayPacket>, Query);

    impl SimdKernel for Together<'_> {
        type Output = Vec<RayPacket>;

        #[inline(always)]
        fn run<I: SimdLevel>(self, isa: I) -> Vec<RayPacket> {
            let Together(tree, mut packets, query) = self;
            let mut memory = TraversalMemory::new();
            for packet in &mut packets {
                let active = packet.active_mask();
                trace_together(isa, tree, packet, active, query, &mut memory);
            }
            packets
        }
    }

    #[test]
    fn packets_have_the_hits_of_single_rays() {
        let tree = build_tree(&[&bumpy_sphere(80)]).unwrap();
        let small = SmallTree::of(&tree).unwrap();
        // Some packets of few rays among those of many
        let mut rays = random_packets(2400, 7);
        for packet in rays.iter_mut().step_by(4) {
            packet.active[4..].fill(0);
        }
        // Trace rays one by one
        let (mut single, mut single_blocked) = (rays.clone(), rays.clone());
        single::trace(tree.view(), &mut single, Query::Nearest);
        single::trace(tree.view(), &mut single_blocked, Query::Any);
        // Trace them in packets, with all instruction sets and with that of this machine
        let mut chosen = [rays.clone(), rays.clone()];
        trace(tree.view(), &small, &mut chosen[0], Query::Nearest);
        trace(tree.view(), &small, &mut chosen[1], Query::Any);
        let together = |query| Together((tree.view(), &small), rays.clone(), query);
        for [found, blocked] in [
            [Query::Nearest, Query::Any].map(|query| together(query).run(Scalar)),
            [Query::Nearest, Query::Any].map(|query| dispatch(together(query))),
            [Query::Nearest, Query::Any].map(|query| dispatch_sixteen(together(query))),
            chosen,
        ] {
            // Compare the bits
            let (mut hit_count, mut blocked_count) = (0, 0);
            for index in 0..rays.len() {
                for lane in 0..LANES {
                    let hit = found[index].hit(lane);
                    let bits = |hit: Hit| (hit.primitive, [hit.t, hit.u, hit.v].map(f32::to_bits));
                    assert_eq!(hit.map(bits), single[index].hit(lane).map(bits));
                    let is_blocked = blocked[index].is_blocked(lane);
                    assert_eq!(is_blocked, single_blocked[index].is_blocked(lane));
                    hit_count += u32::from(hit.is_some());
                    blocked_count += u32::from(is_blocked);
                }
            }
            assert!(
                hit_count > 3000 && blocked_count == hit_count,
                "{hit_count}, {blocked_count}"
            );
        }
    }
}
