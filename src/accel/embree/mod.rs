//! Placeholder.

use super::{Accel, AccelError, AccelOptions, AccelReport, RayOrder, RayPacket};
use crate::scene::Scene;

/// Placeholder.
pub struct EmbreeAccel<'s> {
    scene: &'s Scene,
}

impl<'s> EmbreeAccel<'s> {
    /// Placeholder.
    pub fn build(scene: &'s Scene, _options: &AccelOptions) -> Result<EmbreeAccel<'s>, AccelError> {
        Ok(EmbreeAccel { scene })
    }
}

impl Accel for EmbreeAccel<'_> {
    fn intersect(&self, _packets: &mut [RayPacket], _order: RayOrder) {
        let _ = self.scene;
    }

    fn occluded(&self, _packets: &mut [RayPacket], _order: RayOrder) {}

    fn report(&self) -> AccelReport {
        AccelReport::default()
    }
}
