//! Traced ray packets with the paths of their rays.

use super::path_state::PathStatePacket;
use crate::accel::{Coherence, NO_HIT, RayPacket};
use crate::numeric::{LANES, Lanes, Lanes3};

/// Properties that all rays of a batch share.
#[derive(Clone, Copy)]
pub(in crate::render) struct BatchInfo {
    pub(in crate::render) order: Coherence,
    /// Number of bounces before these rays. In scenes where light goes through surfaces, each ray has its own depth
    /// instead.
    pub(in crate::render) depth: u32,
    /// True if the paths of these rays have left a diffuse surface, from which on they do not branch.
    pub(in crate::render) is_behind_bounce: bool,
}

impl BatchInfo {
    /// Returns the number of samples that a surface takes of a light of `samples` samples: one behind a diffuse surface.
    #[inline(always)]
    pub(in crate::render) fn light_samples(&self, samples: u32) -> u32 {
        if self.is_behind_bounce { 1 } else { samples }
    }
}

/// Traced packet with its pixels, weights and path states.
#[derive(Clone, Copy)]
pub(in crate::render) struct TracedPacket<'a> {
    pub(in crate::render) packet: &'a RayPacket,
    pub(in crate::render) pixel: &'a Lanes<u32>,
    /// Path throughput at the hits, after absorption and scattering along the rays.
    pub(in crate::render) weight: &'a Lanes3<f32>,
    pub(in crate::render) path_states: Option<PathStatePacket<'a>>,
}

impl TracedPacket<'_> {
    /// Returns whether any ray of non-zero weight has missed the scene, and so shows its background.
    #[inline(always)]
    pub(in crate::render) fn sees_background(&self) -> bool {
        let (packet, [r, g, b]) = (self.packet, self.weight);
        let mut sees = false;
        for l in 0..LANES {
            let is_miss = (packet.active[l] != 0) & (packet.instance[l] == NO_HIT);
            sees |= is_miss & ((r[l] != 0.0) | (g[l] != 0.0) | (b[l] != 0.0));
        }
        sees
    }
}
