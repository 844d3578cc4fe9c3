//! Analytic shape: the plane z = 0.

use glam::DVec3;

use super::span::{Crossings, NO_HIT, TwoHits, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay};
use crate::numeric::Bounds;

/// Unbounded plane z = 0; its positive side is +z, its surface coordinates are x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane;

impl TwoHits for Plane {
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        [crossing(ray), NO_HIT]
    }
}

/// Returns the hit of the ray on z = 0. A ray within the plane misses, and one that starts on the plane does not
/// return.
///
/// The result is one subtraction-free division of exact numbers: within half an ulp.
#[inline(always)]
pub(super) fn crossing(ray: &ShapeRay) -> ShapeHit {
    if ray.direction.z == 0.0 || ray.origin_surface.is_some() {
        return NO_HIT;
    }
    // Adding 0 turns -0 into +0, so that a ray that starts on the plane hits at +0.
    let t = -ray.origin.z / ray.direction.z + 0.0;
    ShapeHit { t, part: 0 }
}

impl Implicit for Plane {
    #[inline]
    fn bounds(&self) -> Bounds {
        Bounds {
            min: DVec3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, 0.0),
            max: DVec3::new(f64::INFINITY, f64::INFINITY, 0.0),
        }
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        nearest(ray, self.intersections(ray))
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        report(ray, self.intersections(ray), out);
    }

    fn point(&self, p: DVec3, part: u32) -> ShapePoint {
        self.surface(p, part)
            .parametrized([p.x, p.y], [DVec3::X, DVec3::Y])
    }

    #[inline(always)]
    fn surface(&self, p: DVec3, _part: u32) -> LocatedPoint {
        LocatedPoint::new(DVec3::new(p.x, p.y, 0.0), DVec3::Z, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_crosses_once_from_either_side_and_never_when_parallel() {
        let hit = |o: DVec3, d: DVec3| Plane.intersect(&ShapeRay::new(o, d)).map(|h| h.t);
        assert_eq!(
            hit(DVec3::new(5.0, 7.0, 3.0), DVec3::new(1.0, 0.0, -2.0)),
            Some(1.5)
        );
        assert_eq!(hit(DVec3::new(0.0, 0.0, -3.0), DVec3::Z), Some(3.0));
        assert_eq!(hit(DVec3::new(0.0, 0.0, 3.0), DVec3::Z), None);
        for z in [0.0, -0.0, 1.0] {
            for d in [0.0, -0.0] {
                assert_eq!(hit(DVec3::new(0.0, 0.0, z), DVec3::new(1.0, 0.0, d)), None);
            }
        }
    }
}
