//! Placeholder.

use super::{Accel, AccelError, AccelOptions, AccelReport, RayOrder, RayPacket};
use crate::scene::Scene;

/// Placeholder.
pub struct BspAccel<'s> {
    scene: &'s Scene,
}

impl<'s> BspAccel<'s> {
    /// Placeholder.
    pub fn build(scene: &'s Scene, _options: &AccelOptions) -> Result<BspAccel<'s>, AccelError> {
        Ok(BspAccel { scene })
    }
}

impl Accel for BspAccel<'_> {
    fn intersect(&self, _packets: &mut [RayPacket], _order: RayOrder) {
        let _ = self.scene;
    }

    fn occluded(&self, _packets: &mut [RayPacket], _order: RayOrder) {}

    fn report(&self) -> AccelReport {
        AccelReport::default()
    }
}
