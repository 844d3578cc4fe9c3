//! Queries that every acceleration structure answers.

use glam::Vec3;

use super::packet::RayPacket;
use super::report::AccelReport;

/// Nearest-hit and occlusion queries for a batch of 16-lane packets against one built scene.
///
/// Queries take a batch so that a backend may interleave many rays: memory latency is the limit on large meshes. Lanes
/// whose ray is not traceable (see [`RayPacket::drop_untraceable`]) are deactivated, never traced.
pub trait Accel: Send + Sync {
    /// Finds the nearest hit of every active lane within its interval.
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence);

    /// Marks every active lane as blocked whose ray hits anything within its interval.
    fn occluded(&self, packets: &mut [RayPacket], order: Coherence);

    /// Marks blocked lanes as [`Accel::occluded`] does, for coherent rays that have their end in common, such as shadow
    /// rays to a light.
    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        let _ = end;
        self.occluded(packets, Coherence::Coherent);
    }

    /// Returns the number of coherent packets that a query should have, at most 64: more would leave the
    /// cache, fewer would leave work unshared.
    fn batch(&self) -> usize {
        BATCH
    }

    /// Returns statistics of the structure that was built.
    fn report(&self) -> AccelReport;
}

/// Number of packets of most queries: 24 KB of rays, half of an L1 cache.
pub(crate) const BATCH: usize = 16;
/// Largest number of packets that an [`Accel::batch`] may have.
pub(crate) const MAX_BATCH: usize = 64;

/// End that all rays of a query have in common, in world space. It changes the speed of the query, and which rays
/// it may change by rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RayEnd {
    /// Point in metres at which all rays end, up to rounding, such as a point light: their parameter there is `t_far` or
    /// slightly more.
    Point(Vec3),
    /// Direction of all rays, not normalised, such as that to a directional light. Rays whose direction differs in any
    /// component are traced correctly, but slowly.
    Direction(Vec3),
}

/// Coherence hint for the rays of a packet. It changes the speed, never the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coherence {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Rays without spatial coherence, for example after a bounce.
    Incoherent,
}
