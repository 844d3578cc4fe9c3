//! Kernel that divides packets into groups of similar directions, and traces each.

use crate::accel::native::child_stack::ChildStack;
use crate::accel::native::layout::{Box3, TreeView};
use crate::accel::native::single::trace_lane;
use crate::accel::{LANES, Query, RayPacket};
use crate::mesh::simd::{Floats, SimdKernel, SimdLevel, lanes};
use glam::Vec3;

use super::projection::{GroupProjection, MAX_COORDINATE};
use super::query::GroupQuery;
use super::rays::{GroupRays, PACKETS};
use super::traverse::traverse;

/// Number of rays up to which they are traced one at a time.
const FEW: u32 = 4;
/// Range of the largest coordinate, relative to which products of three stay finite and normal.
const COORDINATE_RANGE: [f32; 2] = [1.0 / MAX_COORDINATE, MAX_COORDINATE];

/// Memory of a traversal, for reuse.
pub(super) struct Scratch {
    rays: Box<GroupRays>,
    stack: ChildStack,
    /// Packets that wait for their turn.
    parts: Vec<PacketRange>,
}

impl Scratch {
    /// Allocates the memory for one thread.
    pub(super) fn new() -> Box<Scratch> {
        Box::new(Scratch {
            rays: GroupRays::new(),
            stack: ChildStack::new(),
            parts: Vec::new(),
        })
    }
}

/// Range of packets in a row.
#[derive(Clone, Copy)]
struct PacketRange {
    first: usize,
    end: usize,
}

/// Queries for packets of rays with a common end or a common direction.
pub(super) struct GroupKernel<'a, P> {
    tree: TreeView<'a>,
    packets: &'a mut [RayPacket],
    scratch: &'a mut Scratch,
    query: P,
}

impl<'a, P> GroupKernel<'a, P> {
    /// Prepares queries for rays that have in common what `query` states.
    pub(super) fn new(
        tree: TreeView<'a>,
        packets: &'a mut [RayPacket],
        query: P,
        scratch: &'a mut Scratch,
    ) -> GroupKernel<'a, P> {
        GroupKernel {
            tree,
            packets,
            scratch,
            query,
        }
    }
}

impl<P: GroupQuery> SimdKernel for GroupKernel<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) {
        let is_in_range = is_in_range(self.tree.bounds, self.query.projection().fixed_point());
        let scratch = self.scratch;
        for packets in self.packets.chunks_mut(PACKETS) {
            // Collect the rays
            let mut pending = [0; PACKETS];
            for (packet, pending) in packets.iter_mut().zip(&mut pending) {
                packet.drop_untraceable();
                // Active lanes hold -1.
                let active = bytemuck::cast_ref(&packet.active);
                *pending = Floats::load(isa.sixteen(), active).signs();
            }
            if !is_in_range {
                trace_singly::<P>(isa, self.tree, packets, &pending, scratch);
                continue;
            }
            // Trace them in groups
            scratch.parts.clear();
            scratch.parts.push(PacketRange {
                first: 0,
                end: packets.len(),
            });
            while let Some(PacketRange { first, end }) = scratch.parts.pop() {
                let part = &mut packets[first..end];
                let pending = &mut pending[first..end];
                let tracer = PartTracer {
                    tree: self.tree,
                    query: self.query,
                };
                if tracer.trace(isa, part, pending, scratch) == PartOutcome::TooSparse {
                    split(PacketRange { first, end }, &mut scratch.parts);
                }
            }
        }
    }
}

/// Returns whether coordinates within `bounds`, and about a point, are within the range of the group kernel.
fn is_in_range(bounds: &Box3, p: Vec3) -> bool {
    let corners = [bounds.low, bounds.high].map(Vec3::from);
    let largest = corners.iter().fold(p.abs().max_element(), |size, corner| {
        size.max(corner.abs().max_element())
    });
    (COORDINATE_RANGE[0]..=COORDINATE_RANGE[1]).contains(&largest)
}

/// Adds the quarters of a range to `parts`.
fn split(part: PacketRange, parts: &mut Vec<PacketRange>) {
    let length = (part.end - part.first).div_ceil(4);
    for first in (part.first..part.end).step_by(length).rev() {
        parts.push(PacketRange {
            first,
            end: part.end.min(first + length),
        });
    }
}

/// Traces all pending rays one at a time.
#[inline(always)]
fn trace_singly<P: GroupQuery>(
    isa: impl SimdLevel,
    tree: TreeView,
    packets: &mut [RayPacket],
    pending: &[u32],
    scratch: &mut Scratch,
) {
    let query = if P::IS_ANY { Query::Any } else { Query::Nearest };
    for (packet, &pending) in packets.iter_mut().zip(pending) {
        for lane in lanes(pending) {
            trace_lane(isa, tree, packet, lane % LANES, query, &mut scratch.stack);
        }
    }
}

/// Result of tracing a part.
#[derive(PartialEq, Eq)]
enum PartOutcome {
    /// All rays are traced.
    Done,
    /// Some rays are not traced: they leave their window so empty that the part should be split.
    TooSparse,
}

/// Tree against which the rays of a part are traced.
struct PartTracer<'a, P> {
    tree: TreeView<'a>,
    query: P,
}

impl<P: GroupQuery> PartTracer<'_, P> {
    /// Traces the pending rays of some packets in groups of similar directions.
    #[inline(always)]
    fn trace(
        &self,
        isa: impl SimdLevel,
        packets: &mut [RayPacket],
        pending: &mut [u32],
        scratch: &mut Scratch,
    ) -> PartOutcome {
        let projection = self.query.projection();
        let mut direction = projection.sum_of_directions(isa, packets, pending);
        while let Some(first) = pending.iter().position(|&mask| mask != 0) {
            // Take the rays that point along an axis of the world
            let rays = &mut *scratch.rays;
            let frame = projection.frame(isa, packets, pending, direction);
            let count = rays.load(isa, packets, pending, projection, frame);
            let next = pending[first].trailing_zeros() as usize % LANES;
            if count == 0 {
                // Try the direction of the first ray, then trace it alone
                let own = projection.direction(&packets[first].ray(next));
                if own == direction {
                    let mask = 1 << next;
                    trace_singly::<P>(isa, self.tree, &mut packets[first..=first], &[mask], scratch);
                    pending[first] &= !mask;
                }
                direction = own;
                continue;
            }
            // Leave a sparse group to be split
            if packets.len() > 1 && count > FEW && rays.is_sparse() {
                return PartOutcome::TooSparse;
            }
            // Trace the rays that were taken, one at a time if they are few
            if count <= FEW {
                let taken = rays.taken;
                trace_singly::<P>(isa, self.tree, packets, &taken, scratch);
            } else {
                traverse::<_, P>(isa, self.tree, rays, packets, &mut scratch.stack);
                self.query
                    .write_hits(isa, self.tree, rays, packets, &mut scratch.stack);
            }
            // Strike them off the pending ones
            for (pending, taken) in pending.iter_mut().zip(&scratch.rays.taken) {
                *pending &= !taken;
            }
        }
        PartOutcome::Done
    }
}
