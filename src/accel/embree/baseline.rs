//! The bare loop over Embree's own calls: what the rest of the program is measured against.

use super::EmbreeAccel;
use super::query::{intersect_packet, new_query, occluded_packet};
use super::ray_packet::{Lanes, row};
use crate::accel::{LANES, RayOrder, RayPacket};

impl EmbreeAccel<'_> {
    /// `rtcIntersect16` on every packet and nothing else.
    ///
    /// Only for packets that went through [`RayPacket::drop_untraceable`] and whose other lanes end before they begin:
    /// Embree 3.13 as Debian builds it ends the process on a lane with a NaN or an infinite coordinate, on processors
    /// without packets of 16 even if it is off, and over its own instances on one beyond 2^36.
    pub fn raw_intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        let scene = self.world.as_ref();
        let mut query = new_query(scene.order(order));
        let query = &raw mut query;
        for packet in packets {
            intersect_packet(scene, query, packet);
        }
    }

    /// `rtcOccluded16` on every packet and nothing else; as [`EmbreeAccel::raw_intersect`].
    pub fn raw_occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        let scene = self.world.as_ref();
        let mut query = new_query(scene.order(order));
        let query = &raw mut query;
        for packet in packets {
            occluded_packet(scene, query, packet);
        }
    }
    /// `rtcIntersect1` on every active lane, and nothing else but what carries a ray there and its distance back; of the
    /// hits only these are kept. As [`EmbreeAccel::raw_intersect`].
    pub fn baseline_intersect1(&self, packets: &mut [RayPacket]) {
        self.raw_one_by_one(packets, |ray, query| ray.intersect(self.world.as_ref(), query));
    }

    /// `rtcOccluded1` on every active lane; as [`EmbreeAccel::baseline_intersect1`].
    pub fn raw_occluded_one_by_one(&self, packets: &mut [RayPacket]) {
        self.raw_one_by_one(packets, |ray, query| ray.occluded(self.world.as_ref(), query));
    }

    #[inline(always)]
    fn raw_one_by_one(
        &self,
        packets: &mut [RayPacket],
        ask: impl Fn(&mut Lanes<1>, *mut embree_sys::EmbreeQuery),
    ) {
        let mut query = new_query(RayOrder::Incoherent);
        let query = &raw mut query;
        for packet in packets {
            for lane in (0..LANES).filter(|&lane| packet.active[lane] != 0) {
                let mut ray = Lanes::new();
                ray.set(0, &packet.ray(lane));
                ask(&mut ray, query);
                packet.t_far[lane] = f32::from_bits(ray.get(row::T_FAR, 0));
            }
        }
    }
}
