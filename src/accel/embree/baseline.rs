//! Baseline loops over Embree's own calls, against which the rest of the program is measured.

use super::embree_accel::EmbreeAccel;
use super::query::ray_packet::{Lanes, row};
use super::query::trace::{new_query, trace_packet};
use crate::accel::{Coherence, LANES, Query, RayPacket};

impl EmbreeAccel<'_> {
    /// Calls `rtcIntersect16` on every packet and does nothing else.
    ///
    /// Valid only for packets that went through [`RayPacket::drop_untraceable`] and whose inactive lanes have
    /// `t_far < t_near`: Embree 3.13 as Debian builds it ends the process on a lane with a NaN or an infinite
    /// coordinate, on processors without packets of 16 even if the lane is inactive, and over its own instances on a
    /// coordinate beyond 2^36.
    pub fn baseline_intersect16(&self, packets: &mut [RayPacket], order: Coherence) {
        self.baseline16(packets, order, Query::Nearest);
    }

    /// Calls `rtcOccluded16` on every packet and does nothing else, under the conditions of
    /// [`EmbreeAccel::baseline_intersect16`].
    pub fn baseline_occluded16(&self, packets: &mut [RayPacket], order: Coherence) {
        self.baseline16(packets, order, Query::Any);
    }

    #[inline(always)]
    fn baseline16(&self, packets: &mut [RayPacket], order: Coherence, query_kind: Query) {
        let scene = self.world.as_ref();
        let mut query = new_query(scene.order(order));
        let query = &raw mut query;
        for packet in packets {
            trace_packet(scene, query, packet, query_kind);
        }
    }

    /// Calls `rtcIntersect1` on every active lane and copies only the ray in and the distance out; other hit data is
    /// dropped. The conditions of [`EmbreeAccel::baseline_intersect16`] apply.
    pub fn baseline_intersect1(&self, packets: &mut [RayPacket]) {
        self.baseline1(packets, Query::Nearest);
    }

    /// Calls `rtcOccluded1` on every active lane, in the manner of [`EmbreeAccel::baseline_intersect1`].
    pub fn baseline_occluded1(&self, packets: &mut [RayPacket]) {
        self.baseline1(packets, Query::Any);
    }

    #[inline(always)]
    fn baseline1(&self, packets: &mut [RayPacket], query_kind: Query) {
        let mut query = new_query(Coherence::Incoherent);
        let query = &raw mut query;
        for packet in packets {
            for lane in (0..LANES).filter(|&lane| packet.active[lane] != 0) {
                let mut ray = Lanes::<1>::new();
                ray.set(0, &packet.ray(lane));
                ray.trace(self.world.as_ref(), query, query_kind);
                packet.t_far[lane] = f32::from_bits(ray.get(row::T_FAR, 0));
            }
        }
    }
}
