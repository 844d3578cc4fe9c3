//! Traversal of small trees with packets of rays in any directions, sixteen together or eight.
//!
//! In a tree of a few hundred triangles most nodes are entered by some ray of any packet. Testing one box, or one
//! triangle, with all rays at once then takes less time than tracing the rays one after the other. The triangle test is
//! the watertight one of `mesh::triangle`, so results are those of the other backends.

use crate::accel::bsp::error_bounds::Line;
use crate::accel::{LANES, Query, RayPacket};
use crate::mesh::simd::{Floats, LaneMask, SimdKernel, SimdLevel, SimdLimit, WideLevel, lanes};
use crate::mesh::triangle::{
    AxisOrders, HitLanes, OwnAxes, PACK, ShearLanes, ShearedVertex, may_contain_origin,
};

use super::layout::{ChildLink, NO_NUMBER, NativeNode, TreeView, WIDTH};
use super::packet_part::{PartHits, axes_of, bits_of, part_of, write_lanes};
use super::single;
use super::small_tree::{IndexedBlock, MAX_BLOCKS, MAX_VERTICES, SmallTree};

/// Least number of active lanes of a packet whose rays are traced together: of eight or sixteen rays through 40 triangles
/// packets take 0.7 of the time of single rays with AVX2, of four 1.05 (`cargo bench --bench timing -- small_trees`).
const MIN_LANES: u32 = 8;

/// Finds the hits of every active lane for a query: packet by packet, those of few rays one by one.
pub(super) fn trace(
    simd: SimdLimit,
    tree: TreeView,
    small: &SmallTree,
    packets: &mut [RayPacket],
    query: Query,
) {
    // Trace packets of many rays together
    let sparse = simd.dispatch_sixteen(SmallTreePackets {
        tree,
        small,
        packets,
        query,
    });
    // Trace what they leave over ray by ray, by a kernel that is compiled for registers of eight
    if sparse > 0 {
        single::trace_sparse(simd, tree, packets, query, sparse);
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
        // Without registers of eight lanes packets take longer than single rays
        if !I::HAS_EIGHT {
            return u32::MAX;
        }
        // Trace as many rays together as a register holds
        if I::HAS_SIXTEEN {
            let wide = isa.sixteen();
            self.trace(SimdLevels { isa, wide })
        } else {
            let wide = isa.eight();
            self.trace(SimdLevels { isa, wide })
        }
    }
}

impl SmallTreePackets<'_> {
    /// Traces the packets of many rays, `N` rays at a time.
    #[inline(always)]
    fn trace<const N: usize>(self, isa: SimdLevels<impl SimdLevel, impl WideLevel<N>>) -> u32 {
        let mut memory = TraversalMemory::new();
        let mut sparse = 0;
        for packet in self.packets {
            packet.drop_untraceable();
            if packet.active_mask().count_ones() < MIN_LANES {
                sparse = MIN_LANES;
                continue;
            }
            let tree = (self.tree, self.small);
            trace_together(isa, tree, packet, self.query, &mut memory);
        }
        sparse
    }
}

/// Instruction set with its level of operations on `N` f32.
#[derive(Clone, Copy)]
struct SimdLevels<I, W> {
    isa: I,
    wide: W,
}

/// Traces the active rays of a packet, `N` together, and writes the results into it.
#[inline(always)]
fn trace_together<const N: usize>(
    isa: SimdLevels<impl SimdLevel, impl WideLevel<N>>,
    tree: (TreeView, &SmallTree),
    packet: &mut RayPacket,
    query: Query,
    memory: &mut TraversalMemory<N>,
) {
    for part in 0..LANES / N {
        let rays = PacketRays::new(packet, part);
        if rays.active != 0 {
            let hits = rays.traverse(isa, tree, query, memory);
            hits.write(packet, part, query);
        }
    }
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
struct TraversalMemory<const N: usize> {
    /// No more wait than there are leaves, as each has some of its own.
    stack: [WaitingChild; MAX_BLOCKS],
    /// Vertices of a leaf in the frames of the rays.
    vertices: [ShearedVertex<N>; MAX_VERTICES],
}

impl<const N: usize> TraversalMemory<N> {
    #[inline(always)]
    fn new() -> TraversalMemory<N> {
        TraversalMemory {
            stack: [WaitingChild::NONE; MAX_BLOCKS],
            vertices: [ShearedVertex::ZERO; MAX_VERTICES],
        }
    }
}

/// Rays of a part of a packet, with precomputed data.
#[repr(C, align(64))]
struct PacketRays<const N: usize> {
    origin: [[f32; N]; 3],
    /// Reciprocal directions of entry and exit, as in [`Line`].
    enter: [[f32; N]; 3],
    leave: [[f32; N]; 3],
    shears: ShearLanes<N, OwnAxes<N>>,
    axes: AxisOrders<N>,
    t_near: [f32; N],
    /// Parameters of the rays' ends; -∞ for inactive lanes.
    t_far: [f32; N],
    /// Mask of the active rays.
    active: u32,
}

impl<const N: usize> PacketRays<N> {
    #[inline(always)]
    fn new(packet: &RayPacket, part: usize) -> PacketRays<N> {
        // Prepare the rays for the tests of boxes and triangles
        let origin = axes_of(&packet.origin, part);
        let direction = axes_of(&packet.direction, part);
        let [enter, leave] = Line::reciprocals(&direction);
        let shears = ShearLanes::of_each(&origin, &direction);
        // Give inactive lanes an empty interval
        let is_active: [i32; N] = *part_of(&packet.active, part);
        let mut t_far: [f32; N] = *part_of(&packet.t_far, part);
        let mut active = 0;
        for lane in 0..N {
            let end = if t_far[lane] < f32::MAX {
                t_far[lane]
            } else {
                f32::MAX
            };
            t_far[lane] = if is_active[lane] != 0 {
                end
            } else {
                f32::NEG_INFINITY
            };
            active |= u32::from(is_active[lane] != 0) << lane;
        }
        PacketRays {
            origin,
            enter,
            leave,
            axes: AxisOrders::of(&shears.axes),
            shears,
            t_near: *part_of(&packet.t_near, part),
            t_far,
            active,
        }
    }

    /// Returns the nearest hits, or any with [`Query::Any`].
    #[inline(always)]
    fn traverse<W: WideLevel<N>>(
        &self,
        isa: SimdLevels<impl SimdLevel, W>,
        (tree, small): (TreeView, &SmallTree),
        query: Query,
        TraversalMemory { stack, vertices }: &mut TraversalMemory<N>,
    ) -> SmallTreeHits<W, N> {
        let mut hits = SmallTreeHits::none(isa.wide, &self.t_far);
        // Start at the root
        stack[0] = WaitingChild {
            child: tree.root,
            rays: self.active,
        };
        let mut count = 1;
        while count > 0 {
            // Skip what no ray enters that is still traced
            count -= 1;
            let WaitingChild { child, rays } = stack[count % MAX_BLOCKS];
            let rays = hits.traced(rays, query);
            if rays == 0 {
                continue;
            }
            // Intersect the triangles of a leaf, or the boxes of a node
            if child.is_leaf() {
                hits = self.intersect_block(isa.isa, (small.block(child), vertices), rays, query, hits);
                continue;
            }
            let node = &tree.nodes[child.index()];
            for slot in 0..WIDTH {
                let child = node.children[slot];
                if child == ChildLink::EMPTY {
                    continue;
                }
                let rays = self.entering(node, slot, hits.t) & rays;
                if rays != 0 {
                    stack[count % MAX_BLOCKS] = WaitingChild { child, rays };
                    count += 1;
                }
            }
        }
        hits
    }

    /// Returns the mask of the rays up to `t_far` that intersect the box of a child by the slab method.
    #[inline(always)]
    fn entering<W: WideLevel<N>>(&self, node: &NativeNode, slot: usize, t_far: Floats<W, N>) -> u32 {
        let wide = t_far.level();
        let (mut near, mut far) = (Floats::load(wide, &self.t_near), t_far);
        for axis in 0..3 {
            // Enter by the bound that the ray reaches first
            let low = Floats::splat(wide, node.bounds[0][axis][slot]);
            let high = Floats::splat(wide, node.bounds[1][axis][slot]);
            let origin = Floats::load(wide, &self.origin[axis]);
            let enter = Floats::load(wide, &self.enter[axis]);
            let leave = Floats::load(wide, &self.leave[axis]);
            let falls = enter.lt_i32(Floats::splat(wide, 0.0));
            // NaN, from a ray within a face, leaves the interval unchanged
            near = ((falls.select(high, low) - origin) * enter).max(near);
            far = ((falls.select(low, high) - origin) * leave).min(far);
        }
        near.le(far).bits()
    }

    /// Intersects the triangles of a leaf with the rays of the mask `rays`. Returns the hits so far with those added.
    #[inline(always)]
    fn intersect_block<W: WideLevel<N>>(
        &self,
        isa: impl SimdLevel,
        (block, sheared): (&IndexedBlock, &mut [ShearedVertex<N>; MAX_VERTICES]),
        rays: u32,
        query: Query,
        mut hits: SmallTreeHits<W, N>,
    ) -> SmallTreeHits<W, N> {
        // Transform each vertex once for all triangles that share it
        for (vertex, sheared) in block.vertices().iter().zip(sheared.iter_mut()) {
            *sheared = self.shears.sheared_along(&self.axes.along(isa, vertex));
        }
        // Find the triangles that lines of rays may intersect, and that are not behind all of these
        let (mut masks, mut members) = ([0; PACK], 0);
        for (slot, [a, b, c]) in block.triangles().enumerate() {
            let vertices = [&sheared[a], &sheared[b], &sheared[c]];
            let may_hit = may_contain_origin(isa, vertices.map(|vertex| &vertex.projected)) & rays;
            masks[slot] = self.shears.starting_before(isa, vertices, may_hit);
            members |= u32::from(masks[slot] != 0) << slot;
        }
        // Intersect the remaining triangles
        for slot in lanes(members) {
            let slot = slot % PACK;
            let active = hits.traced(masks[slot], query);
            if active == 0 {
                continue;
            }
            let ([a, b, c], number) = (block.triangle(slot), block.numbers[slot]);
            let vertices = [&sheared[a], &sheared[b], &sheared[c]];
            let corners = || [block.vertex(a), block.vertex(b), block.vertex(c)];
            let interval = [&self.t_near, &hits.t.to_array()];
            let found = self
                .shears
                .intersect_sheared(isa, vertices, corners, active, interval);
            hits = match query {
                Query::Nearest => hits.with_nearest(&found, number),
                Query::Any => SmallTreeHits {
                    mask: hits.mask | found.mask,
                    ..hits
                },
            };
        }
        hits
    }
}

/// Nearest hits of the rays so far, in registers; if any hits are looked for, their mask alone.
#[derive(Clone, Copy)]
struct SmallTreeHits<W: WideLevel<N>, const N: usize> {
    /// Parameters of the hits, or of the rays' ends.
    t: Floats<W, N>,
    /// Barycentric weights of the hits times their determinants.
    weights: [Floats<W, N>; 2],
    det: Floats<W, N>,
    /// Numbers of the triangles, as the bits of an f32; [`NO_NUMBER`] for none.
    numbers: Floats<W, N>,
    /// Mask of the rays with a hit.
    mask: u32,
}

impl<W: WideLevel<N>, const N: usize> SmallTreeHits<W, N> {
    #[inline(always)]
    fn none(wide: W, t_far: &[f32; N]) -> SmallTreeHits<W, N> {
        SmallTreeHits {
            t: Floats::load(wide, t_far),
            weights: [Floats::splat(wide, 0.0); 2],
            det: Floats::splat(wide, 1.0),
            numbers: Floats::splat(wide, f32::from_bits(NO_NUMBER)),
            mask: 0,
        }
    }

    /// Returns the rays of a mask that are still traced.
    #[inline(always)]
    fn traced(&self, rays: u32, query: Query) -> u32 {
        match query {
            Query::Nearest => rays,
            Query::Any => rays & !self.mask,
        }
    }

    /// Replaces hits by those on a triangle that are nearer; of equally near ones the triangle of the lowest number stays.
    #[inline(always)]
    fn with_nearest(self, found: &HitLanes<N>, number: u32) -> SmallTreeHits<W, N> {
        // Compare the parameters, then the numbers where those are equal
        let wide = self.t.level();
        let t = Floats::load(wide, &found.t);
        let mut taken = t.lt(self.t).bits() & found.mask;
        let ties = found.mask & !taken;
        if ties != 0 {
            let numbers = self.numbers.to_array();
            for lane in lanes(ties) {
                taken |= u32::from(number < numbers[lane % N].to_bits()) << lane;
            }
        }
        // Take the weights without their division
        let is_taken = LaneMask::of_bits(wide, taken);
        let [v, w] = [
            Floats::load(wide, &found.weights[0]),
            Floats::load(wide, &found.weights[1]),
        ];
        SmallTreeHits {
            t: is_taken.select(t, self.t),
            weights: [
                is_taken.select(v, self.weights[0]),
                is_taken.select(w, self.weights[1]),
            ],
            det: is_taken.select(Floats::load(wide, &found.det), self.det),
            numbers: is_taken.select(Floats::splat(wide, f32::from_bits(number)), self.numbers),
            mask: self.mask | taken,
        }
    }

    /// Writes the hits into that part of a packet.
    #[inline(always)]
    fn write(&self, packet: &mut RayPacket, part: usize, query: Query) {
        if query == Query::Any {
            return write_lanes(self.mask, &mut packet.t_far, part, &[f32::NEG_INFINITY; N]);
        }
        let hits = PartHits {
            mask: self.mask,
            t: self.t.to_array(),
            u: (self.weights[0] / self.det).to_array(),
            v: (self.weights[1] / self.det).to_array(),
            numbers: bits_of(&self.numbers.to_array()),
        };
        hits.write(packet, part);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Hit;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::testing::{BEST, random_packets};
    use crate::mesh::bumpy_sphere;
    use crate::mesh::simd::{Scalar, dispatch};

    /// Kernel that traces sixteen rays of a packet together, or eight, whatever the instruction set and their number.
    struct Together<'a> {
        tree: (TreeView<'a>, &'a SmallTree),
        packets: Vec<RayPacket>,
        query: Query,
        sixteen: bool,
    }

    impl SimdKernel for Together<'_> {
        type Output = Vec<RayPacket>;

        #[inline(always)]
        fn run<I: SimdLevel>(mut self, isa: I) -> Vec<RayPacket> {
            let (mut sixteen, mut eight) = (TraversalMemory::new(), TraversalMemory::new());
            for packet in &mut self.packets {
                if self.sixteen {
                    let wide = isa.sixteen();
                    trace_together(
                        SimdLevels { isa, wide },
                        self.tree,
                        packet,
                        self.query,
                        &mut sixteen,
                    );
                } else {
                    let wide = isa.eight();
                    trace_together(
                        SimdLevels { isa, wide },
                        self.tree,
                        packet,
                        self.query,
                        &mut eight,
                    );
                }
            }
            self.packets
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
        single::trace(BEST, tree.view(), &mut single, Query::Nearest);
        single::trace(BEST, tree.view(), &mut single_blocked, Query::Any);
        // Trace them in packets, with all instruction sets and with that of this machine
        let mut chosen = [rays.clone(), rays.clone()];
        trace(BEST, tree.view(), &small, &mut chosen[0], Query::Nearest);
        trace(BEST, tree.view(), &small, &mut chosen[1], Query::Any);
        let together = |sixteen, query| Together {
            tree: (tree.view(), &small),
            packets: rays.clone(),
            query,
            sixteen,
        };
        let both = |trace: &dyn Fn(Query) -> Vec<RayPacket>| [trace(Query::Nearest), trace(Query::Any)];
        for [found, blocked] in [
            both(&|query| together(true, query).run(Scalar)),
            both(&|query| together(false, query).run(Scalar)),
            both(&|query| dispatch(together(true, query))),
            both(&|query| dispatch(together(false, query))),
            both(&|query| BEST.dispatch_sixteen(together(true, query))),
            both(&|query| BEST.dispatch_sixteen(together(false, query))),
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
