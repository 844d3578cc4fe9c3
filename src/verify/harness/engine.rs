//! Acceleration structure with the scene that it was built over, for queries of single rays.

use glam::DVec3;

use super::system_under_test::SystemUnderTest;
use crate::accel::{Accel, AccelError, Coherence, EmbreeIdentity, Hit, LANES, RayPacket};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Scene;

/// Acceleration structure with the scene that it was built over.
pub(in crate::verify) struct Engine<'s> {
    pub(super) accel: Box<dyn Accel + 's>,
    pub(super) scene: &'s Scene,
}

impl<'s> Engine<'s> {
    /// Wraps a structure that was built elsewhere over `scene`.
    pub(in crate::verify) fn of(accel: Box<dyn Accel + 's>, scene: &'s Scene) -> Engine<'s> {
        Engine { accel, scene }
    }

    /// Packs the rays into packets and traces their nearest hits.
    pub(in crate::verify) fn traced(&self, rays: &[Ray], order: Coherence) -> Vec<RayPacket> {
        let mut packets = packets(rays);
        self.accel.intersect(&mut packets, order);
        packets
    }

    /// Returns the nearest hit of each ray.
    pub(in crate::verify) fn nearest(&self, rays: &[Ray], order: Coherence) -> Vec<Option<Hit>> {
        let packets = self.traced(rays, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].hit(i % LANES))
            .collect()
    }

    /// Returns whether each ray is occluded.
    pub(in crate::verify) fn blocked(&self, rays: &[Ray], order: Coherence) -> Vec<bool> {
        let mut packets = packets(rays);
        self.accel.occluded(&mut packets, order);
        (0..rays.len())
            .map(|i| packets[i / LANES].is_blocked(i % LANES))
            .collect()
    }
}

/// Returns the version and instruction set of Embree if the system under test uses it.
pub(in crate::verify) fn embree_identity(
    subject: &SystemUnderTest,
) -> Result<Option<EmbreeIdentity>, AccelError> {
    let scene = Scene::default();
    Ok((subject.build)(&scene)?.report().embree)
}

fn packets(rays: &[Ray]) -> Vec<RayPacket> {
    let mut packets = vec![RayPacket::EMPTY; rays.len().div_ceil(LANES)];
    for (i, ray) in rays.iter().enumerate() {
        packets[i / LANES].set(i % LANES, ray);
    }
    packets
}

/// Returns a ray from `origin`, rounded to f32, to `target`.
pub(in crate::verify) fn towards(origin: DVec3, target: DVec3) -> Ray {
    let origin = origin.as_vec3();
    Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
}

/// Returns a random ray order, which affects the speed but never the result.
pub(in crate::verify) fn order(random: &mut SplitMix64) -> Coherence {
    random.choose(&[Coherence::Coherent, Coherence::Incoherent])
}
