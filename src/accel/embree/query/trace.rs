//! Packet queries: traces packets at their width, without the rays that Embree cannot trace.

use std::mem::{MaybeUninit, offset_of};

use embree_sys as sys;
use multiversion::multiversion;

use super::packet_width::{Width, Widths};
use super::ray_packet::{Lanes, is_vanishing};
use crate::accel::embree::native_instances;
use crate::accel::embree::scene::{EmbreeScene, SceneRef};
use crate::accel::{Coherence, LANES, Query, RayPacket};

/// Traces every packet with a traceable lane, with the query that suits its rays.
#[inline]
pub(in crate::accel::embree) fn trace(
    scene: &EmbreeScene,
    widths: Widths,
    packets: &mut [RayPacket],
    order: Coherence,
    query_kind: Query,
) {
    let scene = scene.as_ref();
    let (mut coherent, mut incoherent) = (new_query(scene.order(order)), new_query(Coherence::Incoherent));
    let (coherent, incoherent) = (&raw mut coherent, &raw mut incoherent);
    for packet in packets {
        if scene.has_instances() {
            packet.drop_beyond(native_instances::RAY_LIMIT);
        }
        // Embree must see neither untraceable rays nor a wrong coherence flag
        let remaining = keep_traceable(packet);
        if remaining == Remaining::Nothing {
            continue;
        }
        let (width, order) = widths.of(packet, order);
        let query = match (remaining, order) {
            (Remaining::MayBeCoherent, Coherence::Coherent) => coherent,
            _ => incoherent,
        };
        match width {
            Width::Sixteen => trace_packet(scene, query, packet, query_kind),
            Width::Eight => trace_split::<8>(scene, query, packet, query_kind),
            Width::Four => trace_split::<4>(scene, query, packet, query_kind),
            Width::One => trace_split::<1>(scene, query, packet, query_kind),
        }
    }
}

/// Creates a query without a filter, for any number of calls.
pub(in crate::accel::embree) fn new_query(order: Coherence) -> sys::EmbreeQuery {
    let mut query = MaybeUninit::uninit();
    // SAFETY: the pointer is to memory for one query, which the call fills.
    unsafe { sys::embree_query_init(query.as_mut_ptr(), i32::from(order == Coherence::Coherent)) };
    // SAFETY: the call above has written every field that Embree reads.
    unsafe { query.assume_init() }
}

/// Calls `rtcIntersect16` or `rtcOccluded16` on the packet in place. Embree may abort the process, but no more, if an
/// active lane is not traceable.
#[inline(always)]
pub(in crate::accel::embree) fn trace_packet(
    scene: SceneRef,
    query: *mut sys::EmbreeQuery,
    packet: &mut RayPacket,
    query_kind: Query,
) {
    let rays: *mut RayPacket = packet;
    let valid = rays
        .wrapping_byte_add(offset_of!(RayPacket, active))
        .cast::<i32>();
    match query_kind {
        Query::Nearest => {
            // SAFETY: a `RayPacket` begins as an `RTCRayHit16` and holds its aligned mask (asserted in `ray_packet`);
            // both belong to this thread alone, as does the query.
            unsafe { sys::embree_intersect16(valid, scene.handle(), query, rays.cast()) };
            if scene.has_instances() {
                packet.use_instance_ids();
            }
        }
        // SAFETY: as for the nearest hit; an `RTCRay16` is the beginning of an `RTCRayHit16`.
        Query::Any => unsafe { sys::embree_occluded16(valid, scene.handle(), query, rays.cast()) },
    }
}

/// Traces a packet in parts of `W` rays.
fn trace_split<const W: usize>(
    scene: SceneRef,
    query: *mut sys::EmbreeQuery,
    packet: &mut RayPacket,
    query_kind: Query,
) {
    let mut part = Lanes::<W>::new();
    for number in 0..LANES / W {
        part.load_rays(packet, number);
        if part.any_active() {
            part.trace(scene, query, query_kind);
            part.put_results(packet, number, query_kind);
        }
    }
}

/// State of a packet after untraceable lanes are deactivated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Remaining {
    /// No active lane is left.
    Nothing,
    /// All rays may be flagged as coherent, if they are.
    MayBeCoherent,
    /// Some ray must not be flagged as coherent (see [`is_vanishing`]).
    MustBeIncoherent,
}

/// Deactivates the lanes that Embree cannot trace, on which 3.13.5 aborts, and returns what is left.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.2"))]
fn keep_traceable(packet: &mut RayPacket) -> Remaining {
    packet.drop_untraceable();
    if !packet.any_active() {
        return Remaining::Nothing;
    }
    // Look for vanishing direction components in active lanes
    let mut vanishing = 0;
    for lane in 0..LANES {
        let [x, y, z] = [0, 1, 2].map(|axis| is_vanishing(packet.direction[axis][lane]));
        vanishing |= if x | y | z { packet.active[lane] } else { 0 };
    }
    if vanishing == 0 {
        Remaining::MayBeCoherent
    } else {
        Remaining::MustBeIncoherent
    }
}
