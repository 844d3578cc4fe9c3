//! Backend that takes the sooner of Embree and the native tree for each kind of ray.
//!
//! Rays with a common end go to the native tree, whose groups are faster than packets. All others go to Embree where its
//! packets save more time than building its structure takes, by a forecast that depends on the scene and the expected
//! rays alone ([`BackendChoice`]).

mod forecast;

pub use forecast::{BackendChoice, Structures};

#[cfg(feature = "embree")]
use super::embree::EmbreeAccel;
use super::native::NativeAccel;
use super::{Accel, AccelError, AccelOptions};
#[cfg(feature = "embree")]
use super::{AccelReport, Coherence, RayEnd, RayPacket};
use crate::scene::Scene;

/// Builds the structures of a validated scene that are forecast to take the least time.
pub fn build<'s>(scene: &'s Scene, options: &AccelOptions) -> Result<Box<dyn Accel + 's>, AccelError> {
    match BackendChoice::new(scene, &options.rays).structures {
        #[cfg(feature = "embree")]
        Structures::Embree => Ok(Box::new(EmbreeAccel::build(scene, options)?)),
        #[cfg(feature = "embree")]
        Structures::Both => Ok(Box::new(BothAccel {
            native: NativeAccel::build(scene, options)?,
            embree: EmbreeAccel::build(scene, options)?,
        })),
        _ => Ok(Box::new(NativeAccel::build(scene, options)?)),
    }
}

/// The native tree for rays with a common end, and Embree's structure for all others.
#[cfg(feature = "embree")]
struct BothAccel<'s> {
    native: NativeAccel<'s>,
    embree: EmbreeAccel<'s>,
}

#[cfg(feature = "embree")]
impl Accel for BothAccel<'_> {
    fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
        if !self.native.intersect_group(packets, order) {
            self.embree.intersect(packets, order);
        }
    }

    fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
        self.embree.occluded(packets, order);
    }

    fn occluded_towards(&self, packets: &mut [RayPacket], end: RayEnd) {
        self.native.occluded_towards(packets, end);
    }

    fn gains_from_ends(&self) -> bool {
        self.native.gains_from_ends()
    }

    fn batch(&self) -> usize {
        self.native.batch()
    }

    fn report(&self) -> AccelReport {
        // Add the memory of both
        let mut report = self.embree.report();
        let native = self.native.report();
        report.bytes += native.bytes;
        report.peak_bytes += native.bytes;
        report.parts.extend(native.parts);
        report.summary = format!("{}; {}", native.summary, report.summary);
        report
    }
}
