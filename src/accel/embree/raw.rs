//! The bare loop that [`EmbreeAccel`]'s own is measured against: one call a packet and nothing else.

use super::{EmbreeAccel, Query};
use crate::accel::{RayOrder, RayPacket};

impl EmbreeAccel<'_> {
    /// As [`crate::accel::Accel::intersect`], unchecked and always 16 wide, for benchmarks.
    ///
    /// Every active ray must be traceable ([`RayPacket::drop_untraceable`]): Debian's Embree ends the process at one
    /// that is not.
    pub fn raw_intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        let mut query = Query::new(order);
        for packet in packets {
            query.intersect_whole(&self.top, packet);
        }
    }

    /// As [`crate::accel::Accel::occluded`], unchecked and always 16 wide, for benchmarks.
    pub fn raw_occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        let mut query = Query::new(order);
        for packet in packets {
            query.occluded_whole(&self.top, packet);
        }
    }
}
