//! Parameters and weights of hits, by the reference test.
//!
//! The group kernel finds which triangle a ray hits first; its depths depend, in their last bits, on the frame of the
//! group. A ray that continues behind a surface starts at the parameter of its hit, and images must not depend on the
//! division into groups. So every hit is computed again as the single-ray kernel computes it, sixteen at a time. Where
//! the reference test misses the triangle, which at an edge it may, it hits a neighbour: the ray is traced alone.

use crate::accel::native::child_stack::ChildStack;
use crate::accel::native::layout::TreeView;
use crate::accel::native::packet_part::{PartHits, axes_of, bits_of, part_of};
use crate::accel::native::single::trace_lane;
use crate::accel::{LANES, Query, RayPacket};
use crate::mesh::simd::{Floats, LaneMask, SimdLevel, WideLevel, lanes};
use crate::mesh::triangle::ShearLanes;
use crate::numeric::Lanes;

use super::frame::splat;
use super::rays::{GroupRays, NO_SLOT, PACKETS};

/// Writes the hits of a group, found in `tree`, into its packets.
#[inline(always)]
pub(super) fn write_exact_hits(
    isa: impl SimdLevel,
    tree: TreeView,
    rays: &GroupRays,
    packets: &mut [RayPacket],
    stack: &mut ChildStack,
) {
    let none = splat(isa.sixteen(), f32::from_bits(NO_SLOT));
    for (index, packet) in packets.iter_mut().enumerate() {
        // Find the lanes with hits
        let index = index % PACKETS;
        let slots = &rays.slots[index];
        let is_missing = Floats::load(isa.sixteen(), bytemuck::cast_ref(slots)).eq_bits(none);
        let hits = rays.taken[index] & !is_missing.bits();
        if hits == 0 {
            continue;
        }
        // Compute them again, and trace the rays that miss their triangle
        let missed = recompute(isa, tree, packet, hits, slots);
        for lane in lanes(missed) {
            trace_lane(isa, tree, packet, lane % LANES, Query::Nearest, stack);
        }
    }
}

/// Writes the hits of the lanes in `hits` on the triangles in these slots. Returns the lanes whose ray misses its
/// triangle.
#[inline(always)]
fn recompute<I: SimdLevel>(
    isa: I,
    tree: TreeView,
    packet: &mut RayPacket,
    hits: u32,
    slots: &Lanes<u32>,
) -> u32 {
    // Take as many rays together as a register holds
    if I::HAS_SIXTEEN {
        let part = PacketPart::<LANES>::new(packet, slots, 0, hits);
        return part.recompute((isa, isa.sixteen()), tree, packet);
    }
    let mut missed = 0;
    for index in 0..2 {
        let hits = hits >> (8 * index) & 0xff;
        if hits != 0 {
            let part = PacketPart::<8>::new(packet, slots, index, hits);
            missed |= part.recompute((isa, isa.eight()), tree, packet) << (8 * index);
        }
    }
    missed
}

/// Rays of a part of a packet, with the triangles that they hit.
struct PacketPart<const N: usize> {
    /// Index of the part.
    index: usize,
    /// Mask of the rays with hits, which are some.
    hits: u32,
    /// Slots of the triangles, as bits.
    slots: [f32; N],
    origin: [[f32; N]; 3],
    direction: [[f32; N]; 3],
    /// Intervals of the rays: both ends.
    interval: [[f32; N]; 2],
}

impl<const N: usize> PacketPart<N> {
    /// Copies the rays of a part.
    #[inline(always)]
    fn new(packet: &RayPacket, slots: &Lanes<u32>, index: usize, hits: u32) -> PacketPart<N> {
        PacketPart {
            index,
            hits,
            slots: *part_of(bytemuck::cast_ref(slots), index),
            origin: axes_of(&packet.origin, index),
            direction: axes_of(&packet.direction, index),
            interval: [*part_of(&packet.t_near, index), *part_of(&packet.t_far, index)],
        }
    }

    /// Writes the hits into the packet; returns the lanes whose ray misses its triangle.
    #[inline(always)]
    fn recompute<W: WideLevel<N>>(
        &self,
        (isa, wide): (impl SimdLevel, W),
        tree: TreeView,
        packet: &mut RayPacket,
    ) -> u32 {
        // Fetch each triangle once for all its lanes; lanes without a hit keep the first one, which avoids branches
        let lane_slots = Floats::load(wide, &self.slots);
        let mut numbers = splat(wide, 0.0);
        let mut corners = [[numbers; 3]; 3];
        let mut remaining = self.hits;
        while remaining != 0 {
            let slot = self.slots[remaining.trailing_zeros() as usize % N];
            let own = lane_slots.eq_bits(splat(wide, slot)).bits();
            let is_first = remaining == self.hits;
            let mask = LaneMask::of_bits(wide, if is_first { u32::MAX } else { own });
            let triangle = tree.triangle_at(slot.to_bits());
            numbers = mask.select(splat(wide, f32::from_bits(triangle.number)), numbers);
            for corner in 0..3 {
                for axis in 0..3 {
                    let value = splat(wide, triangle.corners[corner][axis]);
                    corners[corner][axis] = mask.select(value, corners[corner][axis]);
                }
            }
            remaining &= !own;
        }
        // Store them as the reference test reads them
        let mut corner_lanes = [[[0.0; N]; 3]; 3];
        for corner in 0..3 {
            for axis in 0..3 {
                corner_lanes[corner][axis] = corners[corner][axis].to_array();
            }
        }
        // Intersect each ray with its triangle
        let shears = ShearLanes::of_each(&self.origin, &self.direction);
        let [t_near, t_far] = &self.interval;
        let exact = shears.intersect_each(isa, &corner_lanes, t_near, t_far);
        // Store the hits; the instance follows from the number
        let found = PartHits {
            mask: exact.mask & self.hits,
            t: exact.t,
            u: exact.u,
            v: exact.v,
            numbers: bits_of(&numbers.to_array()),
        };
        found.write(packet, self.index);
        self.hits & !found.mask
    }
}

#[cfg(test)]
mod tests {
    use super::super::intersect;
    use crate::accel::native::build::build_tree;
    use crate::accel::native::single;
    use crate::accel::native::testing::{BEST, RandomNumbers};
    use crate::accel::{LANES, Query, RayPacket};
    use crate::mesh::bumpy_sphere;
    use crate::numeric::Ray;
    use glam::Vec3;

    #[test]
    fn hits_of_groups_have_the_bits_of_single_rays() {
        let mesh = bumpy_sphere(50_000);
        let tree = build_tree(&[&mesh]).unwrap();
        // Aim rays at the cube around the mesh
        let origin = Vec3::new(0.4, 3.0, -0.7);
        let mut random = RandomNumbers(5);
        let mut expected = vec![RayPacket::EMPTY; 2000];
        for packet in &mut expected {
            for lane in 0..LANES {
                packet.set(lane, &Ray::new(origin, random.vector() - origin));
            }
        }
        // Trace them in groups, and one at a time
        let mut actual = expected.clone();
        intersect(BEST, tree.view(), &mut actual, origin);
        single::trace(BEST, tree.view(), &mut expected, Query::Nearest);
        // Compare the bits, unless a ray through an edge hits the neighbour
        let (mut hit_count, mut tie_count) = (0, 0);
        for (a, b) in expected.iter().zip(&actual) {
            for lane in 0..LANES {
                let (Some(a), Some(b)) = (a.hit(lane), b.hit(lane)) else {
                    assert_eq!(a.hit(lane), b.hit(lane));
                    continue;
                };
                hit_count += 1;
                if a.primitive != b.primitive {
                    tie_count += 1;
                    continue;
                }
                assert_eq!(
                    [a.t, a.u, a.v].map(f32::to_bits),
                    [b.t, b.u, b.v].map(f32::to_bits)
                );
            }
        }
        assert!(hit_count > 10_000, "{hit_count}");
        assert!(1000 * tie_count < hit_count, "{tie_count} of {hit_count}");
    }
}
