//! Hits in the packets that Embree passes to callbacks: their recording, by the kind of query.

use crate::accel::embree::query::ray_packet::{CallbackPacket, number_of_instance, row};
use crate::accel::{ACTIVE, Hit, NO_HIT, Query};

/// Writes a hit into Embree's packet, unless an equally near hit has a lower index.
#[inline(always)]
pub(super) fn record_hit(
    packet: CallbackPacket,
    lane: usize,
    t_far: f32,
    found: &Hit,
    query_kind: Query,
) -> i32 {
    if query_kind == Query::Any {
        packet.set(row::T_FAR, lane, f32::NEG_INFINITY.to_bits());
        return ACTIVE;
    }
    // A lane without a hit has the highest index, so a hit at its very end is recorded.
    if found.t == t_far && number_of(packet, lane) <= [found.instance, found.primitive] {
        return 0;
    }
    packet.set(row::T_FAR, lane, found.t.to_bits());
    packet.set(row::U, lane, found.u.to_bits());
    packet.set(row::V, lane, found.v.to_bits());
    packet.set(row::PRIMITIVE, lane, found.primitive);
    packet.set(row::INSTANCE, lane, found.instance);
    packet.set(row::LEVEL, lane, NO_HIT);
    ACTIVE
}

/// Returns instance and primitive of a lane's hit; the highest indices if it has none.
#[inline(always)]
pub(super) fn number_of(packet: CallbackPacket, lane: usize) -> [u32; 2] {
    let geometry = packet.load_one(row::INSTANCE, lane);
    let level = packet.load_one(row::LEVEL, lane);
    let primitive = packet.load_one(row::PRIMITIVE, lane);
    [number_of_instance([geometry, level]), primitive]
}
