//! Axis-aligned boxes in f64, and their conservative rounding to f32.

use glam::{DAffine3, DVec3};

/// Axis-aligned box, closed on all sides. Empty if any `min` exceeds its `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner of the box.
    pub min: DVec3,
    /// Upper corner of the box.
    pub max: DVec3,
}

impl Bounds {
    /// Empty box: the identity of [`Bounds::union`].
    pub const EMPTY: Bounds = Bounds {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };

    /// Returns the smallest box around `points`.
    pub fn of_points(points: impl IntoIterator<Item = DVec3>) -> Bounds {
        points.into_iter().fold(Bounds::EMPTY, |bounds, p| Bounds {
            min: bounds.min.min(p),
            max: bounds.max.max(p),
        })
    }

    /// Returns the smallest box around both boxes.
    pub fn union(self, other: Bounds) -> Bounds {
        Bounds {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Returns whether the box contains no point.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Returns the centre. It has no meaning for an empty box.
    pub fn center(&self) -> DVec3 {
        self.min + 0.5 * (self.max - self.min)
    }

    /// Returns the edge lengths; zero for an empty box.
    pub fn extent(&self) -> DVec3 {
        (self.max - self.min).max(DVec3::ZERO)
    }

    /// Returns the largest magnitude of any coordinate; zero for an empty box.
    pub fn magnitude(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        self.min.abs().max(self.max.abs()).max_element()
    }

    /// Returns the box around the eight transformed corners.
    pub fn transformed(&self, target_from_source: &DAffine3) -> Bounds {
        if self.is_empty() {
            return Bounds::EMPTY;
        }
        let corners = self.corners();
        Bounds::of_points(corners.map(|p| target_from_source.transform_point3(p)))
    }

    /// Returns the eight corners. They have no meaning for an empty box.
    pub fn corners(&self) -> [DVec3; 8] {
        // Bit k of a corner's number chooses the upper end along axis k
        std::array::from_fn(|corner| {
            let is_upper = glam::BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
            DVec3::select(is_upper, self.max, self.min)
        })
    }

    /// Returns the lower and upper corner in f32, rounded outward and then one step further, so that a surface whose
    /// points are themselves rounded to f32 stays inside.
    pub(crate) fn to_f32_outward(self) -> ([f32; 3], [f32; 3]) {
        let down = |x: f64| (x as f32).next_down().next_down();
        let up = |x: f64| (x as f32).next_up().next_up();
        (self.min.to_array().map(down), self.max.to_array().map(up))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_box_stays_empty_through_union_and_transform() {
        assert!(Bounds::EMPTY.union(Bounds::EMPTY).is_empty());
        assert!(Bounds::EMPTY.transformed(&DAffine3::IDENTITY).is_empty());
        assert_eq!(Bounds::EMPTY.magnitude(), 0.0);
    }

    #[test]
    fn outward_rounding_contains_the_exact_box() {
        let exact = Bounds::of_points([DVec3::new(0.1, -0.1, 1e9 + 0.3), DVec3::new(0.7, 0.3, 1e9 + 0.4)]);
        let (low, high) = exact.to_f32_outward();
        for axis in 0..3 {
            assert!(f64::from(low[axis]) < exact.min[axis]);
            assert!(f64::from(high[axis]) > exact.max[axis]);
        }
    }

    #[test]
    fn bounds_of_a_rotated_unit_cube_grow_to_sqrt_two() {
        let cube = Bounds::of_points([DVec3::splat(-0.5), DVec3::splat(0.5)]);
        let turned = cube.transformed(&DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_4));
        assert!((turned.extent().x - 2f64.sqrt()).abs() < 4.0 * f64::EPSILON);
        assert_eq!(turned.extent().z, 1.0);
    }
}
