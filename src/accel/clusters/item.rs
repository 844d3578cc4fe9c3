//! Box of a primitive that is clustered.

use glam::{DVec3, Vec3};

/// A box in f32, precise enough for a heuristic, with its primitive.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct Item {
    pub(super) min: [f32; 3],
    pub(super) index: u32,
    pub(super) max: [f32; 3],
    /// Flag for the last member of a cluster, not 0 if it is.
    pub(super) last: u32,
}

impl Item {
    #[inline(always)]
    pub(super) fn new(index: u32, bounds: [Vec3; 2]) -> Item {
        // Differences of such numbers are finite.
        const MAX_COORDINATE: f32 = f32::MAX / 4.0;
        let number = |x: f32| {
            if x.is_nan() {
                0.0
            } else {
                x.clamp(-MAX_COORDINATE, MAX_COORDINATE)
            }
        };
        let [min, max] = bounds.map(|corner| corner.to_array().map(number));
        Item {
            min,
            index,
            max,
            last: 0,
        }
    }

    pub(super) fn is_last(&self) -> bool {
        self.last != 0
    }

    pub(super) fn midpoint(&self) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|axis| f64::from(self.center(axis))))
    }

    /// Returns the midpoint of the box along an axis.
    #[inline(always)]
    pub(super) fn center(&self, axis: usize) -> f32 {
        0.5 * (self.min[axis] + self.max[axis])
    }
}
