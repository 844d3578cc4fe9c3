//! Rounding-error bounds of the triangle test, and slab tests widened by them.
//!
//! The triangle test projects each vertex with an error of a few units in the last place of its distance from the ray's
//! origin. Along axis `a`, with `p` where the ray passes and `e` the extent of the tree, a vertex moves by at most
//! `2u (|v_a - o_a| + |d_a / d_z| |v_z - o_z|) <= 4u |p_a - o_a| + 4u e`, u = 2^-24. So a ray may hit a triangle that
//! it misses in exact arithmetic, and cells must not hide this hit. The first part is relative to the parameter on the
//! slab's axis and is added to the parameter's error, together with the rounding of the parameter itself; the second is
//! added to the planes.

use super::piece::CellBounds;
use crate::mesh::simd::div;

/// Relative error of a slab parameter: 4u by the triangle test; 4u by a difference, a reciprocal, a product and this
/// factor itself. Doubled, for the effect of one rounding on another.
const PARAMETER_ERROR: f32 = 16.0 * UNIT;
/// Error of a plane relative to the extent of the tree: 4u, doubled for the effect of one rounding on another.
const PLANE_ERROR: f32 = 8.0 * UNIT;
/// Unit roundoff of f32: half a unit in the last place of 1.
const UNIT: f32 = 5.960_464_5e-8;
/// Ratio to the largest direction component below which a component counts as zero: over any length the ray can have in
/// the tree it moves less than [`PLANE_ERROR`].
const ZERO_COMPONENT: f32 = 7.888_609e-31;

/// Distance by which a tree's planes and boxes are widened.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlabError(f32);

impl SlabError {
    /// Computes the error bound of a tree with that root cell.
    pub(super) fn of(root: &CellBounds) -> SlabError {
        let [x, y, z] = root.extent();
        SlabError(PLANE_ERROR * x.max(y).max(z))
    }

    /// Returns a coordinate moved down by the bound.
    #[inline(always)]
    pub(super) fn below(self, x: f32) -> f32 {
        (x - self.0).next_down()
    }

    /// Returns a coordinate moved up by the bound.
    #[inline(always)]
    pub(super) fn above(self, x: f32) -> f32 {
        (x + self.0).next_up()
    }
}

/// A line with precomputed reciprocals for slab tests.
#[derive(Clone, Copy, Debug)]
pub(in crate::accel) struct Line {
    /// Origin of the line.
    pub(in crate::accel) origin: [f32; 3],
    /// Reciprocal direction, its magnitude reduced by the slack; infinite, with a sign, where the component is zero.
    pub(in crate::accel) enter: [f32; 3],
    /// Reciprocal direction, its magnitude increased by the slack.
    pub(in crate::accel) leave: [f32; 3],
}

impl Line {
    /// Prepares the line of a ray with a finite, non-zero direction.
    #[inline(always)]
    pub(in crate::accel) fn new(origin: [f32; 3], direction: [f32; 3]) -> Line {
        let [x, y, z] = direction;
        let [enter, leave] = Line::reciprocals(&[[x], [y], [z]]);
        Line {
            origin,
            enter: [enter[0][0], enter[1][0], enter[2][0]],
            leave: [leave[0][0], leave[1][0], leave[2][0]],
        }
    }

    /// Computes [`Line::enter`] and [`Line::leave`] of `N` rays, by axis.
    #[inline(always)]
    pub(in crate::accel) fn reciprocals<const N: usize>(direction: &[[f32; N]; 3]) -> [[[f32; N]; 3]; 2] {
        // Scale the threshold by the largest component
        let mut least = [0.0f32; N];
        for row in direction {
            for i in 0..N {
                let part = row[i].abs() * ZERO_COMPONENT;
                least[i] = if part > least[i] { part } else { least[i] };
            }
        }
        // No loop over the axes, which would be vectorised in place of that over the rays
        let [x, y, z] = direction;
        let (x, y, z) = (
            reciprocal(x, &least),
            reciprocal(y, &least),
            reciprocal(z, &least),
        );
        [[x[0], y[0], z[0]], [x[1], y[1], z[1]]]
    }

    /// Returns whether the coordinate grows along the line; a zero component counts by its sign.
    #[inline(always)]
    pub(in crate::accel) fn rises(&self, axis: usize) -> bool {
        self.enter[axis].is_sign_positive()
    }

    /// Returns the interval of parameters in which the line is below (`side` < 0) or above (`side` > 0) a thick plane.
    pub(super) fn half_space(
        &self,
        axis: usize,
        position: f32,
        side: f32,
        slab_error: SlabError,
    ) -> [f32; 2] {
        let border = if side < 0.0 {
            slab_error.above(position)
        } else {
            slab_error.below(position)
        };
        let distance = border - self.origin[axis];
        // The product with an infinite reciprocal is infinite, or NaN on the border itself: both parts then count.
        let or = |t: f32, otherwise: f32| if t.is_nan() { otherwise } else { t };
        if self.rises(axis) == (side > 0.0) {
            [or(distance * self.enter[axis], f32::NEG_INFINITY), f32::INFINITY]
        } else {
            [f32::NEG_INFINITY, or(distance * self.leave[axis], f32::INFINITY)]
        }
    }
}

/// Returns the reciprocals of the components of `N` directions along one axis, for entry and exit. Components up to `least`
/// count as zero, with an infinite reciprocal.
#[inline(always)]
fn reciprocal<const N: usize>(components: &[f32; N], least: &[f32; N]) -> [[f32; N]; 2] {
    let quotients = div(&[1.0; N], components);
    let [mut enter, mut leave] = [[0.0; N]; 2];
    for i in 0..N {
        let infinite = f32::INFINITY.copysign(components[i]);
        let reciprocal = if components[i].abs() <= least[i] {
            infinite
        } else {
            quotients[i]
        };
        enter[i] = reciprocal * (1.0 - PARAMETER_ERROR);
        leave[i] = reciprocal * (1.0 + PARAMETER_ERROR);
    }
    [enter, leave]
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT_CELL: CellBounds = CellBounds {
        low: [0.0; 3],
        high: [1.0; 3],
    };

    #[test]
    fn ray_in_a_plane_is_on_both_sides() {
        let slab_error = SlabError::of(&UNIT_CELL);
        for zero in [0.0, -0.0, 1e-40, -1e-40] {
            let line = Line::new([0.5, 0.0, 0.0], [zero, 1.0, 0.0]);
            for side in [-1.0, 1.0] {
                let [from, to] = line.half_space(0, 0.5, side, slab_error);
                assert!(from <= 0.0 && to >= f32::MAX, "{zero} {side}: {from} {to}");
            }
        }
    }

    #[test]
    fn ray_parallel_beside_a_plane_is_on_one_side() {
        let line = Line::new([0.25, 0.0, 0.0], [-0.0, 1.0, 0.0]);
        let slab_error = SlabError::of(&UNIT_CELL);
        let [from, to] = line.half_space(0, 0.5, -1.0, slab_error);
        assert!(from <= 0.0 && to >= f32::MAX);
        let [from, to] = line.half_space(0, 0.5, 1.0, slab_error);
        assert!(from > f32::MAX || to < 0.0);
    }

    #[test]
    fn intervals_at_a_crossed_plane_overlap() {
        let line = Line::new([0.0; 3], [1.0, 0.0, 0.0]);
        let slab_error = SlabError::of(&UNIT_CELL);
        let [_, leave] = line.half_space(0, 0.5, -1.0, slab_error);
        let [enter, _] = line.half_space(0, 0.5, 1.0, slab_error);
        // Each border may be off by the slack of the plane and, relative to 0.5, that of the parameter, and an ulp.
        let most = PLANE_ERROR + 0.5 * PARAMETER_ERROR + f32::EPSILON;
        assert!(enter < 0.5 && 0.5 < leave && leave - enter < 2.0 * most);
    }
}
