//! Finding hits with the system's Embree, 3.13 or 4.
//!
//! One Embree scene holds the world. A mesh whose object space is world space becomes native triangles under the
//! instance's own number, over the scene's own arrays. Everything else is one user geometry: each shape and each placed
//! mesh is one of its primitives, because Embree traverses one tree for each kind of geometry and pays for every further
//! one. A placed mesh has an Embree scene of its own, built once for all its instances; the callback carries the rays into
//! it in f64.
//!
//! By [`Instancing::Native`](super::Instancing::Native) placed meshes are Embree's own instances instead, which carry rays
//! in f32 by an inverse in f32 (see `native`). On 3.13.5 a coherent `rtcOccluded16` over them never returns, so Embree is
//! never told of coherence where it has instances.
//!
//! What moves is a second user geometry, whose boxes Embree interpolates between steps of time; the callback works out the
//! instance's place at each ray's time. Where nothing moves there is none, and Embree asks for no time.
//!
//! Infinite planes are outside Embree, which would drop them.
//!
//! Ties go to the smallest `t`, then instance, then primitive, wherever a callback decides. Of native triangles that
//! coincide, in all three corners, Embree is given only the first by that rule. Between different native triangles that a
//! ray meets at the same `t`, at an edge they share or where they overlap in one plane, Embree decides, by the order in
//! which it meets them.

mod coincident;
mod device;
mod lanes;
mod native;
mod raw;
mod scene;
mod sphere;
mod trace;
mod user;

use std::sync::Arc;

use self::device::Device;
use self::scene::{Built, EmbreeScene};
use self::trace::Width;
use self::user::UserGeometry;
use super::planes::Planes;
use super::{Accel, AccelError, AccelOptions, AccelReport, RayOrder, RayPacket};
use crate::scene::{Instance, Scene};

/// Embree's structure over a scene that it borrows: Embree reads the vertices where they are.
pub struct EmbreeAccel<'s> {
    // In the order of release: whoever is called back goes last.
    world: EmbreeScene<'s>,
    users: [Arc<UserGeometry<'s>>; 2],
    device: Device,
    /// For coherent and for incoherent rays.
    widths: [Width; 2],
    planes: Planes,
    placed_mesh_count: usize,
    native_instance_count: usize,
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
        let Built {
            world,
            users,
            held_back_count,
            native_instance_count,
        } = scene::build(scene, &device, options)?;
        let mut summary = format!(
            "Embree {}, {}, {width}, {} triangles native, {} shapes and placed meshes as user geometry",
            device.identity().version,
            options.precision,
            scene::native_triangle_count(scene),
            users[0].primitive_count(),
        );
        if users[1].primitive_count() > 0 {
            summary += &format!(", {} that move", users[1].primitive_count());
        }
        if native_instance_count > 0 {
            summary += &format!(", {native_instance_count} placed meshes as Embree's instances");
        }
        if held_back_count > 0 {
            summary += &format!(", {held_back_count} triangles held back that coincide with earlier ones");
        }
        let user_count: usize = users.iter().map(|user| user.primitive_count()).sum();
        let object_count = user_count + native_instance_count;
        let widths = [width, width.for_incoherent(object_count)];
        let is_placed = |instance: &&Instance| scene::placed_mesh(scene, instance).is_some();
        Ok(EmbreeAccel {
            world,
            users,
            device,
            widths,
            planes: Planes::of(scene),
            native_instance_count,
            placed_mesh_count: scene.instances.iter().filter(is_placed).count(),
            summary,
        })
    }

    fn width(&self, order: RayOrder) -> Width {
        let [coherent, incoherent] = self.widths;
        match order {
            RayOrder::Coherent => coherent,
            RayOrder::Incoherent => incoherent,
        }
    }

    /// How many meshes stand elsewhere than in their own space, which [`super::AccelOptions::instancing`] is about.
    pub fn placed_mesh_count(&self) -> usize {
        self.placed_mesh_count
    }

    /// How many callbacks have panicked since the build. Their lanes missed; the message is on standard error.
    pub fn panicked_callback_count(&self) -> u64 {
        self.users.iter().map(|user| user.panic_count()).sum()
    }
}

impl Accel for EmbreeAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        trace::intersect(&self.world, self.width(order), packets, order);
        if !self.planes.is_empty() {
            self.planes.intersect(packets);
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        trace::occluded(&self.world, self.width(order), packets, order);
        if !self.planes.is_empty() {
            self.planes.occluded(packets);
        }
    }

    fn report(&self) -> AccelReport {
        let memory = self.device.memory();
        let [still, moving] = &self.users;
        let untold = still.byte_count()
            + moving.own_byte_count()
            + native::RECORD_BYTES * self.native_instance_count as u64;
        AccelReport {
            bytes: memory.bytes() + untold,
            peak_bytes: memory.peak_bytes() + untold,
            embree: Some(self.device.identity().clone()),
            summary: self.summary.clone(),
        }
    }
}
