//! Boxes in SIMD registers, and the margin by which those in nodes are widened.

use glam::Vec3A;

use crate::accel::native::layout::{Box3, NativeNode};

/// Axis-aligned box of two 16-byte registers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Box4 {
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
}

impl Box4 {
    /// Box that contains no point.
    pub(super) const EMPTY: Box4 = Box4 {
        low: Vec3A::INFINITY,
        high: Vec3A::NEG_INFINITY,
    };

    /// Extends the box to a point.
    #[inline(always)]
    pub(super) fn add_point(&mut self, p: Vec3A) {
        self.low = self.low.min(p);
        self.high = self.high.max(p);
    }

    /// Extends the box to another one.
    #[inline(always)]
    pub(super) fn add(&mut self, other: &Box4) {
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
    }

    /// Returns half the surface area of a box that is not empty.
    #[inline(always)]
    pub(super) fn half_area(&self) -> f32 {
        let [x, y, z] = (self.high - self.low).to_array();
        x * y + y * z + z * x
    }

    /// Returns the same box as plain arrays.
    pub(super) fn to_box3(self) -> Box3 {
        Box3 {
            low: self.low.to_array(),
            high: self.high.to_array(),
        }
    }
}

/// Distance by which boxes in nodes are widened.
///
/// The triangle test of single rays moves a vertex by up to `4u` times the extent of the tree (u = 2^-24, see
/// `accel::bsp::error_bounds`), so that it may find a hit that lies outside the exact box, which must not hide it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Margin(f32);

impl Margin {
    /// Margin relative to the extent of the tree: 4u, doubled for the effect of one rounding on another.
    const RELATIVE: f32 = 4.0 * f32::EPSILON;

    /// Computes the margin of a tree with those bounds.
    pub(super) fn of(bounds: &Box4) -> Margin {
        Margin(Margin::RELATIVE * (bounds.high - bounds.low).max_element())
    }

    /// Stores a widened box as that of a child.
    #[inline(always)]
    pub(super) fn store(self, node: &mut NativeNode, slot: usize, bounds: &Box4) {
        let [low, high] = [bounds.low.to_array(), bounds.high.to_array()];
        for axis in 0..3 {
            node.bounds[0][axis][slot] = (low[axis] - self.0).next_down();
            node.bounds[1][axis][slot] = (high[axis] + self.0).next_up();
        }
    }
}
