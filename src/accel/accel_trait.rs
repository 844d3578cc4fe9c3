//! Queries that every acceleration structure answers.

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

    /// Returns statistics of the structure that was built.
    fn report(&self) -> AccelReport;
}

/// Coherence hint for the rays of a packet. It changes the speed, never the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coherence {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Rays without spatial coherence, for example after a bounce.
    Incoherent,
}
