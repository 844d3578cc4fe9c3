//! Analytic shape: the square [-1, 1]² in the plane z = 0.

use glam::DVec3;

use super::disk::{flat_point, flat_surface};
use super::span::{Crossings, NO_HIT, TwoHits, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay, plane};
use crate::numeric::Bounds;

/// Square [-1, 1]² in the plane z = 0. Its positive side is +z; its surface coordinates cover [0, 1]².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quad;

impl TwoHits for Quad {
    /// Returns the hit of the ray on the square, edges included.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let hit = plane::crossing(ray);
        let p = ray.at(hit.t);
        let is_inside = (p.x.abs() <= 1.0) & (p.y.abs() <= 1.0);
        [if is_inside { hit } else { NO_HIT }, NO_HIT]
    }
}

impl Implicit for Quad {
    #[inline]
    fn bounds(&self) -> Bounds {
        Bounds {
            min: DVec3::new(-1.0, -1.0, 0.0),
            max: DVec3::new(1.0, 1.0, 0.0),
        }
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        nearest(ray, self.intersections(ray))
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        report(ray, self.intersections(ray), out);
    }

    fn point(&self, p: DVec3, _part: u32) -> ShapePoint {
        flat_point(p, 0.0, DVec3::Z)
    }

    #[inline(always)]
    fn surface(&self, p: DVec3, _part: u32) -> LocatedPoint {
        flat_surface(p, 0.0, DVec3::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_and_corners_belong_to_the_square() {
        let hit = |x: f64, y: f64| Quad.intersect(&ShapeRay::new(DVec3::new(x, y, -4.0), 2.0 * DVec3::Z));
        for (x, y) in [(1.0, 0.3), (-1.0, -1.0), (1.0, 1.0), (0.0, 0.0)] {
            assert_eq!(hit(x, y), Some(ShapeHit { t: 2.0, part: 0 }));
        }
        assert_eq!(hit(1.0 + f64::EPSILON, 0.0), None);
        assert_eq!(hit(0.0, -1.5), None);
    }
}
