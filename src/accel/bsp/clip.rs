//! Split of the bounds of a primitive by a plane.

use super::piece::PrimitivePiece;
use super::primitives::Primitives;

impl PrimitivePiece {
    /// Returns the parts on both sides of a plane that crosses the piece; `None` where the primitive itself has no
    /// part.
    ///
    /// The bounds are those of the exactly clipped triangle, rounded outward, within those of the piece.
    pub(super) fn split(
        &self,
        primitives: &Primitives,
        axis: usize,
        position: f32,
    ) -> [Option<PrimitivePiece>; 2] {
        // Split the box alone if the primitive is no triangle
        let Some(corners) = primitives.corners(self.number) else {
            let (mut left, mut right) = (*self, *self);
            left.high[axis] = position;
            right.low[axis] = position;
            return [Some(left), Some(right)];
        };
        // Compute in f64, where differences of f32 coordinates are nearly exact
        let [a, b, c] = corners;
        let corners = [
            a.as_dvec3().to_array(),
            b.as_dvec3().to_array(),
            c.as_dvec3().to_array(),
        ];
        // Bound the triangle's vertices on each side and its edges' crossings with the plane
        let plane = f64::from(position);
        let mut low = [[f64::INFINITY; 3]; 2];
        let mut high = [[f64::NEG_INFINITY; 3]; 2];
        let mut include = |side: usize, p: [f64; 3]| {
            for k in 0..3 {
                low[side][k] = low[side][k].min(p[k]);
                high[side][k] = high[side][k].max(p[k]);
            }
        };
        // Add each vertex to its side, and the crossing of each edge to both
        for i in 0..3 {
            let (p, q) = (corners[i], corners[(i + 1) % 3]);
            let (from, to) = (p[axis] - plane, q[axis] - plane);
            if from <= 0.0 {
                include(0, p);
            }
            if from >= 0.0 {
                include(1, p);
            }
            if from * to < 0.0 {
                let s = from / (from - to);
                let along = |k: usize| p[k] + s * (q[k] - p[k]);
                let mut crossing = [along(0), along(1), along(2)];
                crossing[axis] = plane;
                include(0, crossing);
                include(1, crossing);
            }
        }
        [self.within(low[0], high[0]), self.within(low[1], high[1])]
    }

    /// Returns the part within f64 bounds, rounded outward, or `None` if it is empty.
    fn within(&self, low: [f64; 3], high: [f64; 3]) -> Option<PrimitivePiece> {
        let mut part = *self;
        for axis in 0..3 {
            part.low[axis] = self.low[axis].max(round_down(low[axis]));
            part.high[axis] = self.high[axis].min(round_up(high[axis]));
            if part.low[axis] > part.high[axis] {
                return None;
            }
        }
        Some(part)
    }
}

#[inline(always)]
fn round_down(x: f64) -> f32 {
    let rounded = x as f32;
    if f64::from(rounded) > x {
        rounded.next_down()
    } else {
        rounded
    }
}

#[inline(always)]
fn round_up(x: f64) -> f32 {
    let rounded = x as f32;
    if f64::from(rounded) < x {
        rounded.next_up()
    } else {
        rounded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    fn one_triangle(corners: [[f32; 3]; 3]) -> Mesh {
        Mesh {
            positions: corners.to_vec().into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        }
    }

    #[test]
    fn a_right_triangle_cut_in_the_middle_leaves_a_trapezium_and_a_small_triangle() {
        let mesh = one_triangle([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]);
        let primitives = Primitives::of_mesh(&mesh).unwrap();
        let [left, right] = primitives.pieces()[0]
            .split(&primitives, 0, 1.0)
            .map(Option::unwrap);
        assert_eq!((left.low, left.high), ([0.0, 0.0, 0.0], [1.0, 2.0, 0.0]));
        assert_eq!((right.low, right.high), ([1.0, 0.0, 0.0], [2.0, 1.0, 0.0]));
    }

    #[test]
    fn clipped_polygon_may_be_on_one_side_of_a_plane() {
        // The hypotenuse cuts the box's upper right corner off; there the plane x = 1.5 has nothing above y = 0.5.
        let mesh = one_triangle([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]);
        let primitives = Primitives::of_mesh(&mesh).unwrap();
        let [_, upper] = primitives.pieces()[0]
            .split(&primitives, 1, 1.0)
            .map(Option::unwrap);
        let mut wide = upper;
        wide.high[0] = 2.0;
        let [kept, lost] = wide.split(&primitives, 0, 1.5);
        assert!(kept.is_some());
        assert_eq!(lost, None);
    }

    #[test]
    fn coplanar_triangle_goes_left_and_touching_triangle_keeps_its_side() {
        let piece = |low: f32, high: f32| PrimitivePiece::new(0, [low; 3], [high; 3]);
        assert_eq!(piece(1.0, 1.0).sides(0, 1.0), (true, false));
        assert_eq!(piece(0.0, 1.0).sides(0, 1.0), (true, false));
        assert_eq!(piece(1.0, 2.0).sides(0, 1.0), (false, true));
        assert_eq!(piece(0.0, 2.0).sides(0, 1.0), (true, true));
    }
}
