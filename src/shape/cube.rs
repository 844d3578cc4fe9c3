//! Analytic shape: the cube [-1, 1]³ as three slabs, clipped by Cyrus and Beck.

use glam::DVec3;

use super::span::{Crossings, Span, TwoHits, UNIT, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay};
use crate::numeric::Bounds;

/// Axis-aligned cube [-1, 1]³. Part `2 axis` is the face at -1 of that axis, `2 axis + 1` the face at +1; the surface
/// coordinates of each face cover [0, 1]².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cube;

impl TwoHits for Cube {
    /// Returns both hits of the ray by the overlap of three slabs.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let (o, d) = (ray.origin, ray.direction);
        Span::slab(o.x, d.x, UNIT, [0, 1])
            .overlap(Span::slab(o.y, d.y, UNIT, [2, 3]))
            .overlap(Span::slab(o.z, d.z, UNIT, [4, 5]))
            .crossings_of_convex(ray, false)
    }
}

/// Returns the axis and the side, -1 or 1, of the face `part`.
#[inline(always)]
fn face(part: u32) -> (usize, f64) {
    let side = if part & 1 == 0 { -1.0 } else { 1.0 };
    ((part / 2).min(2) as usize, side)
}

impl Implicit for Cube {
    #[inline]
    fn bounds(&self) -> Bounds {
        Bounds {
            min: -DVec3::ONE,
            max: DVec3::ONE,
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
        let (axis, side) = face(part);
        let (right, up) = ((axis + 1) % 3, (axis + 2) % 3);
        let surface = self.surface(p, part);
        let p = surface.p;
        let uv = [0.5 * (side * p[right] + 1.0), 0.5 * (p[up] + 1.0)];
        let tangents = [2.0 * side * DVec3::AXES[right], 2.0 * DVec3::AXES[up]];
        surface.parametrized(uv, tangents)
    }

    #[inline(always)]
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        // Select by comparisons, which loops over lanes vectorise, rather than by an index
        let (axis, side) = face(part);
        let (x, y, z) = (axis == 0, axis == 1, axis == 2);
        let p = p.clamp(-DVec3::ONE, DVec3::ONE);
        let p = DVec3::new(
            if x { side } else { p.x },
            if y { side } else { p.y },
            if z { side } else { p.z },
        );
        let unit = |is_axis: bool| if is_axis { 1.0 } else { 0.0 };
        LocatedPoint::new(p, side * DVec3::new(unit(x), unit(y), unit(z)), 1.0)
    }

    #[inline]
    fn is_solid(&self) -> bool {
        true
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        p.abs().cmple(DVec3::ONE).all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hit(o: DVec3, d: DVec3) -> Option<ShapeHit> {
        Cube.intersect(&ShapeRay::new(o, d))
    }

    #[test]
    fn every_face_is_hit_head_on_with_its_part_number() {
        for part in 0..6 {
            let n = Cube.point(DVec3::ZERO, part).n;
            assert_eq!(hit(3.0 * n, -n), Some(ShapeHit { t: 2.0, part }));
            assert_eq!(hit(DVec3::ZERO, n), Some(ShapeHit { t: 1.0, part }));
        }
    }

    #[test]
    fn a_ray_in_a_face_along_an_edge_or_through_a_corner_hits_and_one_beside_misses() {
        for zero in [0.0, -0.0] {
            assert!(hit(DVec3::new(1.0, 0.3, -5.0), DVec3::new(zero, zero, 1.0)).is_some());
            assert!(hit(DVec3::new(1.0, -1.0, -5.0), DVec3::new(zero, zero, 1.0)).is_some());
            assert!(
                hit(
                    DVec3::new(1.0 + f64::EPSILON, 0.0, -5.0),
                    DVec3::new(zero, zero, 1.0)
                )
                .is_none()
            );
        }
        assert_eq!(hit(DVec3::splat(3.0), -DVec3::ONE).map(|h| h.t), Some(2.0));
        // Ray through the corner (1, 1, 1) only.
        assert_eq!(
            hit(DVec3::new(0.0, 1.0, 2.0), DVec3::new(1.0, 0.0, -1.0)).map(|h| h.t),
            Some(1.0)
        );
    }
}
