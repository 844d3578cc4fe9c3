//! Queries that every acceleration structure answers.

use glam::Vec3;

use super::packet::{LANES, RayPacket};
use super::report::AccelReport;
use crate::numeric::Ray;

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

    /// Returns whether [`Accel::occluded_towards`] is faster than [`Accel::occluded`], which is when it pays to sort rays
    /// by the ends they have in common.
    fn gains_from_ends(&self) -> bool {
        false
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

impl RayEnd {
    /// Returns the point at which all active rays end, up to the rounding of their directions, or the direction of all if
    /// they have no end.
    pub(crate) fn common(packets: &[RayPacket]) -> Option<RayEnd> {
        // Twice the rounding of a direction, relative to the origin and the target
        const TOLERANCE: f64 = 2.0 * f32::EPSILON as f64;
        let rays = || active_rays(packets);
        // Compare the directions of unbounded rays
        let first = rays().next()?;
        if first.t_far == f32::INFINITY {
            let is_parallel = rays().all(|ray| ray.direction == first.direction);
            return is_parallel.then_some(RayEnd::Direction(first.direction));
        }
        // Compare the ends of the others
        let end = |ray: &Ray| ray.at(f64::from(ray.t_far));
        let target = end(&first);
        let ends_there = |ray: Ray| {
            let size = ray.origin.as_dvec3().abs().max(target.abs()).max_element();
            (end(&ray) - target).abs().max_element() <= TOLERANCE * size
        };
        (target.is_finite() && rays().all(ends_there)).then(|| RayEnd::Point(target.as_vec3()))
    }

    /// Returns the distance of the origin of `ray` from the common end of `packets`, or from the farthest of their origins if
    /// they have a direction, in the maximum norm.
    pub(crate) fn distance(&self, ray: &Ray, packets: &[RayPacket]) -> f64 {
        let origin = ray.origin.as_dvec3();
        let distance = |point: Vec3| (point.as_dvec3() - origin).abs().max_element();
        match *self {
            RayEnd::Point(target) => distance(target),
            RayEnd::Direction(_) => {
                active_rays(packets).fold(0.0, |farthest, ray| distance(ray.origin).max(farthest))
            }
        }
    }
}

/// Returns the rays of all active lanes.
fn active_rays(packets: &[RayPacket]) -> impl Iterator<Item = Ray> {
    packets.iter().flat_map(|packet| {
        let active = (0..LANES).filter(|&lane| packet.is_active(lane));
        active.map(|lane| packet.ray(lane))
    })
}

/// Coherence hint for the rays of a packet. It changes the speed, never the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coherence {
    /// Camera rays, or shadow rays in the order of their camera rays.
    Coherent,
    /// Rays without spatial coherence, for example after a bounce.
    Incoherent,
}
