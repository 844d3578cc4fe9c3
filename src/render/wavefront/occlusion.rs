//! Occlusion queries for batches of shadow rays to several lights.

use crate::accel::{Accel, Coherence, MAX_BATCH, RayEnd, RayPacket};
use crate::scene::{Light, LightKind};

/// Ends of the shadow rays of a batch, and the order in which its packets are traced.
pub(in crate::render) struct TracingOrder {
    /// End that all rays of the packet at each place have in common, if there is one.
    ends: [Option<RayEnd>; MAX_BATCH],
    /// Index in the queue of the packet at each place.
    numbers: [usize; MAX_BATCH],
}

impl TracingOrder {
    /// Returns the order of the queue, for packets with these ends.
    pub(in crate::render) fn new(ends: [Option<RayEnd>; MAX_BATCH]) -> TracingOrder {
        TracingOrder {
            ends,
            numbers: std::array::from_fn(|index| index),
        }
    }

    /// Marks the blocked lanes of `packets`, the first of which is number `first` of the queue. Where it pays, those with the
    /// same end are moved next to each other and traced together.
    pub(in crate::render) fn occlude(
        &mut self,
        accel: &dyn Accel,
        packets: &mut [RayPacket],
        first: usize,
        order: Coherence,
    ) {
        if order == Coherence::Incoherent || !accel.gains_from_ends() {
            return accel.occluded(packets, order);
        }
        let ends = &mut self.ends[first..][..packets.len()];
        let numbers = &mut self.numbers[first..][..packets.len()];
        let mut start = 0;
        while start < packets.len() {
            // Move the packets with the end of the first behind it
            let end = ends[start];
            let mut next = start;
            for index in start..packets.len() {
                if ends[index] == end {
                    // A packet that is in its place is not copied onto itself
                    if index != next {
                        packets.swap(index, next);
                        ends.swap(index, next);
                        numbers.swap(index, next);
                    }
                    next += 1;
                }
            }
            // Trace them
            let together = &mut packets[start..next];
            match end {
                Some(end) => accel.occluded_towards(together, end),
                None => accel.occluded(together, order),
            }
            start = next;
        }
    }

    /// Returns the place of each of the first `count` packets of the queue.
    pub(in crate::render) fn places(&self, count: usize) -> [usize; MAX_BATCH] {
        let mut places = [0; MAX_BATCH];
        for (place, &number) in self.numbers[..count].iter().enumerate() {
            places[number] = place;
        }
        places
    }
}

/// Returns the end that all shadow rays to a light have in common.
pub(in crate::render) fn common_end(light: &Light) -> Option<RayEnd> {
    match light.kind {
        LightKind::Directional { to_light } => Some(RayEnd::Direction(to_light.as_vec3())),
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            Some(RayEnd::Point(position.as_vec3()))
        }
        LightKind::Area { .. } => None,
    }
}
