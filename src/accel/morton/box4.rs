//! Boxes in SIMD registers.

use glam::Vec3A;

use crate::parallel;

/// Axis-aligned box of two 16-byte registers.
#[derive(Clone, Copy, Debug)]
pub(in crate::accel) struct Box4 {
    pub(in crate::accel) low: Vec3A,
    pub(in crate::accel) high: Vec3A,
}

impl Box4 {
    /// Box that contains no point.
    pub(in crate::accel) const EMPTY: Box4 = Box4 {
        low: Vec3A::INFINITY,
        high: Vec3A::NEG_INFINITY,
    };

    /// Returns the smallest box around all `points`.
    pub(in crate::accel) fn around(points: &[[f32; 3]]) -> Box4 {
        // Number of points of a task
        const CHUNK: usize = 1 << 16;
        let parts = parallel::map_chunks(points, CHUNK, &|_, points| {
            let mut part = Box4::EMPTY;
            for point in points {
                part.add_point(Vec3A::from(*point));
            }
            part
        });
        let mut bounds = Box4::EMPTY;
        for part in &parts {
            bounds.add(part);
        }
        bounds
    }

    /// Extends the box to a point.
    #[inline(always)]
    pub(in crate::accel) fn add_point(&mut self, p: Vec3A) {
        self.low = self.low.min(p);
        self.high = self.high.max(p);
    }

    /// Extends the box to another one.
    #[inline(always)]
    pub(in crate::accel) fn add(&mut self, other: &Box4) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }

    /// Returns twice the midpoint.
    #[inline(always)]
    pub(in crate::accel) fn twice_centre(&self) -> Vec3A {
        self.low + self.high
    }

    /// Returns half the surface area of a box that is not empty.
    #[inline(always)]
    pub(in crate::accel) fn half_area(&self) -> f32 {
        let [x, y, z] = (self.high - self.low).to_array();
        x * y + y * z + z * x
    }
}
