//! Analytic shape: the unit disk x² + y² <= 1 in the plane z = 0.

use glam::DVec3;

use super::span::{Crossings, NO_HIT, TwoHits, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay, plane};
use crate::numeric::Bounds;

/// Unit disk in the plane z = 0. Its positive side is +z; its surface coordinates are those of the square around it, (x
/// + 1) / 2 and (y + 1) / 2, which have no pole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk;

impl TwoHits for Disk {
    /// Returns the hit of the ray on the disk.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let hit = plane::crossing(ray);
        let p = ray.at(hit.t);
        let is_inside = p.x * p.x + p.y * p.y <= 1.0;
        [if is_inside { hit } else { NO_HIT }, NO_HIT]
    }
}

impl Implicit for Disk {
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

/// Returns the surface point of the square [-1, 1]² at height `z` whose normal `n` is +z or -z; seen from outside, u
/// increases to the right and v upwards.
#[inline]
pub(super) fn flat_point(p: DVec3, z: f64, n: DVec3) -> ShapePoint {
    let uv = [0.5 * (n.z * p.x + 1.0), 0.5 * (p.y + 1.0)];
    let tangents = [2.0 * n.z * DVec3::X, 2.0 * DVec3::Y];
    flat_surface(p, z, n).parametrized(uv, tangents)
}

/// Returns position and normal of [`flat_point`].
#[inline(always)]
pub(super) fn flat_surface(p: DVec3, z: f64, n: DVec3) -> LocatedPoint {
    LocatedPoint::new(DVec3::new(p.x, p.y, z), n, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn disk_includes_its_rim_exactly() {
        let hit = |x: f64| Disk.intersect(&ShapeRay::new(DVec3::new(x, 0.0, 2.0), -DVec3::Z));
        assert_eq!(hit(1.0), Some(ShapeHit { t: 2.0, part: 0 }));
        assert_eq!(hit(1.0 + f64::EPSILON), None);
    }
}
