//! Keeps the rays of a frame, so that backends can be compared on real work.

use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use super::{Monitor, RenderSettings, render};
use crate::accel::{Accel, AccelReport, RayOrder, RayPacket};
use crate::parallel;
use crate::scene::{Camera, Scene};

/// The rays of one frame, as they were asked.
#[derive(Clone, Debug, Default)]
pub struct RecordedRays {
    /// From the eye.
    pub camera: Vec<RayPacket>,
    /// From surfaces to lights, in the order of the rays that found the surfaces.
    pub shadow: Vec<RayPacket>,
    /// From mirrors.
    pub reflection: Vec<RayPacket>,
}

/// Renders the frame on one thread, in tile order, and keeps its rays. The picture is dropped.
///
/// Needs about 1.5 KB for every sixteen rays.
pub fn record(scene: &Scene, camera: &Camera, accel: &dyn Accel, settings: &RenderSettings) -> RecordedRays {
    let recorder = Recorder {
        accel,
        rays: Mutex::default(),
    };
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    let render_all = || render(scene, camera, &recorder, settings, &monitor);
    // One thread takes the tiles from first to last. Without a pool of its own the rays are the same in another order.
    match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
        Ok(pool) => parallel::install(&pool, render_all),
        Err(_) => render_all(),
    };
    recorder
        .rays
        .into_inner()
        .unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// A backend that writes down what another one is asked.
struct Recorder<'a> {
    accel: &'a dyn Accel,
    rays: Mutex<RecordedRays>,
}

impl Recorder<'_> {
    fn keep(&self, select: impl FnOnce(&mut RecordedRays) -> &mut Vec<RayPacket>, packets: &[RayPacket]) {
        let mut rays = self.rays.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        select(&mut rays).extend_from_slice(packets);
    }
}

impl Accel for Recorder<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        match order {
            RayOrder::Coherent => self.keep(|rays| &mut rays.camera, packets),
            RayOrder::Incoherent => self.keep(|rays| &mut rays.reflection, packets),
        }
        self.accel.intersect(packets, order);
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        self.keep(|rays| &mut rays.shadow, packets);
        self.accel.occluded(packets, order);
    }

    fn report(&self) -> AccelReport {
        self.accel.report()
    }
}
