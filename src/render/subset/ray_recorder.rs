//! Recording of the rays of a frame, to compare backends on real workloads.

use std::sync::{Mutex, MutexGuard};

use super::super::driver::render;
use super::super::monitor::Monitor;
use super::super::settings::RenderSettings;
use crate::accel::{Accel, AccelReport, Coherence, MAX_BATCH, RayEnd, RayPacket};
use crate::parallel;
use crate::scene::{Camera, ValidScene};

/// Rays of one frame, in the order of their queries.
#[derive(Clone, Debug, Default)]
pub struct RecordedRays {
    /// Camera rays, for nearest-hit queries.
    pub camera: Vec<RayPacket>,
    /// Shadow rays, in the order of the rays that found the surfaces.
    pub shadow: Vec<RayPacket>,
    /// Secondary rays from surfaces, for nearest-hit queries.
    pub reflection: Vec<RayPacket>,
    /// Index of the first packet of each query for shadow rays, in ascending order.
    pub shadow_queries: Vec<usize>,
}

/// Renders the frame on one thread, in tile order, and returns its rays. The image is discarded.
///
/// Needs about 1.5 KB for every sixteen rays.
pub fn record(
    scene: ValidScene,
    camera: &Camera,
    accel: &dyn Accel,
    settings: &RenderSettings,
) -> RecordedRays {
    let recorder = Recorder {
        accel,
        rays: Mutex::default(),
    };
    let monitor = Monitor::default();
    let render_all = || render(scene, camera, &recorder, settings, &monitor);
    // A single thread renders tiles in order. Without a pool of its own, the rays are equal but in a different order.
    let recorded = match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => parallel::install(&pool, render_all),
        Err(_) => render_all(),
    };
    debug_assert!(recorded.is_ok(), "no one cancels it");
    recorder
        .rays
        .into_inner()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// [`Accel`] wrapper that records every query before forwarding it.
struct Recorder<'a> {
    accel: &'a dyn Accel,
    rays: Mutex<RecordedRays>,
}

impl Recorder<'_> {
    fn rays(&self) -> MutexGuard<'_, RecordedRays> {
        self.rays.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    fn keep_shadow_rays(&self, packets: &[RayPacket]) {
        let mut rays = self.rays();
        let start = rays.shadow.len();
        rays.shadow_queries.push(start);
        rays.shadow.extend_from_slice(packets);
    }
}

impl Accel for Recorder<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        match order {
            Coherence::Coherent => self.rays().camera.extend_from_slice(packets),
            Coherence::Incoherent => self.rays().reflection.extend_from_slice(packets),
        }
        self.accel.intersect(packets, order);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.keep_shadow_rays(packets);
        self.accel.occluded(packets, order);
    }

    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        self.keep_shadow_rays(packets);
        self.accel.occluded_towards(packets, end);
    }

    /// Returns true, so that rays are recorded in queries that serve every backend.
    fn gains_from_ends(&self) -> bool {
        true
    }

    /// Returns the largest batch, so that rays are recorded in an order that serves every backend.
    fn batch(&self) -> usize {
        MAX_BATCH
    }

    fn report(&self) -> AccelReport {
        self.accel.report()
    }
}
