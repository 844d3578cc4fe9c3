//! Construction of an acceleration structure by the chosen backend.

use super::accel_trait::Accel;
use super::auto;
use super::brute::BruteAccel;
use super::bsp::BspAccel;
#[cfg(feature = "embree")]
use super::embree::{self, EmbreeAccel};
use super::error::AccelError;
use super::native::NativeAccel;
use super::options::{AccelOptions, Backend};
use super::report::EmbreeIdentity;
use crate::scene::ValidScene;

/// Builds the acceleration structure of a scene.
pub fn build<'s>(
    scene: ValidScene<'s>,
    backend: Backend,
    options: &AccelOptions,
) -> Result<Box<dyn Accel + 's>, AccelError> {
    let scene = scene.get();
    match backend {
        #[cfg(feature = "embree")]
        Backend::Embree => Ok(Box::new(EmbreeAccel::build(scene, options)?)),
        #[cfg(not(feature = "embree"))]
        Backend::Embree => Err(AccelError::NoEmbree),
        Backend::Auto => auto::build(scene, options),
        Backend::Native => Ok(Box::new(NativeAccel::build(scene, options)?)),
        Backend::Bsp => Ok(Box::new(BspAccel::build(scene, options)?)),
        Backend::Brute => Ok(Box::new(BruteAccel::new(scene))),
    }
}

/// Returns the Embree that would be used when restricted to an instruction set; `None` for a backend without it.
///
/// # Errors
/// If Embree does not start, or was not compiled in.
pub fn identity(backend: Backend, isa: Option<&str>) -> Result<Option<EmbreeIdentity>, AccelError> {
    match backend {
        Backend::Embree => {}
        Backend::Auto if cfg!(feature = "embree") => {}
        _ => return Ok(None),
    }
    #[cfg(feature = "embree")]
    return embree::identity(isa).map(Some);
    #[cfg(not(feature = "embree"))]
    {
        let _ = isa;
        Err(AccelError::NoEmbree)
    }
}
