//! The bare loop over Embree's own calls: what the rest of the program is measured against.

use super::EmbreeAccel;
use super::trace::{intersect_packet, new_query, occluded_packet};
use crate::accel::{RayOrder, RayPacket};

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
}
