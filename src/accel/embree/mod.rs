//! Finding hits with the system's Embree, 3.13 or 4.
//!
//! One Embree scene holds the world. A mesh whose object space is world space becomes native triangles under the
//! instance's own number, over the scene's own arrays. Everything else is one user geometry: each shape and each placed
//! mesh is one of its primitives, because Embree traverses one tree for each kind of geometry and pays for every further
//! one. A placed mesh has an Embree scene of its own, built once for all its instances; the callback carries the rays into
//! it in f64. Embree's own instances would round the inverse to f32, and on 3.13.5 a coherent `rtcOccluded16` over them
//! never returns.
//!
//! Infinite planes are outside Embree, which would drop them.
//!
//! Ties go to the smallest `t`, then instance, then primitive, wherever a callback decides. Between two native triangles at
//! the same `t` Embree decides, by the order in which it meets them.

mod device;
mod lanes;
mod raw;
mod scene;
mod sphere;
mod trace;
mod user;

use std::sync::Arc;

use self::device::Device;
use self::scene::EmbreeScene;
use self::trace::Width;
use self::user::UserGeometry;
use super::planes::Planes;
use super::{Accel, AccelError, AccelOptions, AccelReport, RayOrder, RayPacket};
use crate::scene::Scene;

/// Embree's structure over a scene that it borrows: Embree reads the vertices where they are.
pub struct EmbreeAccel<'s> {
    // In the order of release: whoever is called back goes last.
    world: EmbreeScene<'s>,
    user: Arc<UserGeometry<'s>>,
    device: Device,
    width: Width,
    planes: Planes,
    summary: String,
}

impl<'s> EmbreeAccel<'s> {
    /// Builds over a validated scene.
    ///
    /// # Errors
    ///
    /// Where the precision is `watertight`, the instruction set is unknown here, the running library is not the one whose
    /// headers were compiled in, or memory runs out.
    ///
    /// # Panics
    ///
    /// Where `options.progress` panics: the build is cancelled and the panic goes on.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<EmbreeAccel<'s>, AccelError> {
        let device = Device::new(options)?;
        let width = Width::of(&device, options.kernel);
        let (world, user) = scene::build(scene, &device, options)?;
        let summary = format!(
            "Embree {}, {}, {width}, {} triangles native, {} shapes and placed meshes as user geometry",
            device.identity().version,
            options.precision,
            scene::native_triangle_count(scene),
            user.primitive_count(),
        );
        Ok(EmbreeAccel {
            world,
            user,
            device,
            width,
            planes: Planes::of(scene),
            summary,
        })
    }

    /// How many callbacks have panicked since the build. Their lanes missed; the message is on standard error.
    pub fn panicked_callback_count(&self) -> u64 {
        self.user.panic_count()
    }
}

impl Accel for EmbreeAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        trace::intersect(&self.world, self.width, packets, order);
        if !self.planes.is_empty() {
            self.planes.intersect(packets);
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        trace::occluded(&self.world, self.width, packets, order);
        if !self.planes.is_empty() {
            self.planes.occluded(packets);
        }
    }

    fn report(&self) -> AccelReport {
        let memory = self.device.memory();
        AccelReport {
            bytes: memory.bytes(),
            peak_bytes: memory.peak_bytes(),
            embree: Some(self.device.identity().clone()),
            summary: self.summary.clone(),
        }
    }
}
