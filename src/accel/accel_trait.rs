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

    /// Marks blocked lanes as [`Accel::occluded`] does, for coherent rays that all end at `target` up to rounding, such
    /// as shadow rays to a point light: their parameter at `target` is `t_far` or slightly more.
    fn occluded_from_target(&self, packets: &mut [RayPacket], target: Vec3) {
        let _ = target;
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

/// Coherence hint for the rays of a packet. It changes the speed, never the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coherence {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Rays without spatial coherence, for example after a bounce.
    Incoherent,
}
