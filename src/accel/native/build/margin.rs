//! Margin by which boxes in nodes are widened.

use crate::accel::morton::Box4;
use crate::accel::native::layout::NativeNode;

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
