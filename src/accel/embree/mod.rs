//! The system's Embree, asked through `embree-sys`.
//!
//! Meshes that stand in world space are Embree's own triangles, over vertex and index arrays that stay where they are,
//! in the mapped file if that is where they came from. Everything else, spheres and placed meshes, is one user
//! geometry whose callbacks are Rust: a placed mesh has a scene of its own and gets the ray carried into its object
//! space, with `t` kept. (Embree's own instances transform in f32, and `rtcOccluded16` over them never returns on the
//! AVX-512 path of 3.13.5.)
//!
//! Among Embree's own triangles equal `t` is decided by Embree; the callbacks follow the common rule.

mod build;
mod device;
mod query;
mod raw;
mod user;

use super::{
    Accel, AccelError, AccelOptions, AccelReport, EmbreeIdentity, Kernel, Precision, RayOrder, RayPacket,
};
use crate::scene::Scene;
use build::EmbreeScene;
use device::Device;
use query::{Query, Width};
use user::UserGeometry;

/// Embree over a borrowed scene.
pub struct EmbreeAccel<'s> {
    /// Released before what it refers to.
    top: EmbreeScene,
    /// What the callbacks read; boxed, because Embree holds its address.
    user: Box<UserGeometry<'s>>,
    width: Width,
    identity: EmbreeIdentity,
    summary: String,
    device: Device,
}

impl<'s> EmbreeAccel<'s> {
    /// Builds the acceleration structure of a validated scene.
    pub fn build(scene: &'s Scene, options: &AccelOptions) -> Result<EmbreeAccel<'s>, AccelError> {
        if options.precision == Precision::Watertight {
            return Err(AccelError::NotWatertight);
        }
        let device = Device::new(options)?;
        let identity = device.identity(options);
        let width = match options.kernel {
            Kernel::Packet => device.packet_width(),
            Kernel::Single => Width::One,
        };
        let user = build::user_geometry(scene, &device, width, options)?;
        let top = build::top_scene(scene, &device, &user, options)?;
        Ok(EmbreeAccel {
            summary: format!(
                "Embree {} ({}, {}), {} own triangle meshes, {} user primitives",
                identity.version,
                identity.isa,
                options.precision,
                top.mesh_count(),
                user.primitive_count()
            ),
            top,
            user,
            width,
            identity,
            device,
        })
    }
}

impl Accel for EmbreeAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
        let mut query = Query::new(order);
        for packet in packets {
            packet.drop_untraceable();
            query.intersect(&self.top, packet, self.width);
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
        let mut query = Query::new(order);
        for packet in packets {
            packet.drop_untraceable();
            query.occluded(&self.top, packet, self.width);
        }
    }

    fn report(&self) -> AccelReport {
        debug_assert!(!self.user.has_panicked());
        AccelReport {
            bytes: self.device.bytes(),
            peak_bytes: self.device.peak_bytes(),
            embree: Some(self.identity.clone()),
            summary: self.summary.clone(),
        }
    }
}
