//! Bounds of primitives, or of their parts within a cell, and the box around them.

use glam::Vec3;

/// An axis-aligned box in f32. Empty when any `low` exceeds its `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CellBounds {
    /// Lowest corner of the box.
    pub(super) low: [f32; 3],
    /// Highest corner of the box.
    pub(super) high: [f32; 3],
}

impl CellBounds {
    /// Box that contains nothing.
    pub(super) const EMPTY: CellBounds = CellBounds {
        low: [f32::INFINITY; 3],
        high: [f32::NEG_INFINITY; 3],
    };

    /// Grows the box to contain a piece.
    #[inline(always)]
    pub(super) fn include(&mut self, piece: &PrimitivePiece) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(piece.low[axis]);
            self.high[axis] = self.high[axis].max(piece.high[axis]);
        }
    }

    /// Returns half the surface area; 0 for an empty box.
    #[inline(always)]
    pub(super) fn half_area(&self) -> f32 {
        let [x, y, z] = self.extent();
        x * y + y * z + z * x
    }

    /// Returns the edge lengths; 0 for an empty box.
    #[inline(always)]
    pub(super) fn extent(&self) -> [f32; 3] {
        // No closure here: one that is not inlined would be compiled for the lowest instruction set.
        let mut extent = [0.0; 3];
        for axis in 0..3 {
            extent[axis] = (self.high[axis] - self.low[axis]).max(0.0);
        }
        extent
    }
}

/// A primitive, or the part of it that lies within a cell.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct PrimitivePiece {
    /// Lowest corner of its bounds.
    pub(super) low: [f32; 3],
    /// Index of the primitive in the tree.
    pub(super) number: u32,
    /// Highest corner of its bounds.
    pub(super) high: [f32; 3],
}

impl PrimitivePiece {
    /// Creates a piece from its bounds.
    pub(super) fn new(number: u32, low: [f32; 3], high: [f32; 3]) -> PrimitivePiece {
        PrimitivePiece { low, number, high }
    }

    /// Returns the piece of a whole triangle.
    #[inline(always)]
    pub(super) fn of_triangle(number: u32, [a, b, c]: [Vec3; 3]) -> PrimitivePiece {
        PrimitivePiece::new(number, a.min(b).min(c).to_array(), a.max(b).max(c).to_array())
    }

    /// Returns on which sides of a plane the piece has a part: (left, right). A piece within the plane is on the left.
    #[inline(always)]
    pub(super) fn sides(&self, axis: usize, position: f32) -> (bool, bool) {
        let right = self.high[axis] > position;
        (self.low[axis] < position || !right, right)
    }
}
