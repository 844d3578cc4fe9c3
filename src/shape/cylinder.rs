//! Analytic shape: the cylinder x² + y² = 1 between z = -1 and z = 1.
//!
//! The line's distance from the axis is computed by a cross product, `(o × d)_z`, not by the difference of two squares;
//! the constant term is factored as for the sphere.

use std::f64::consts::TAU;

use glam::DVec3;

use super::disk::{flat_point, flat_surface};
use super::parametrization::{polar, unit_angle};
use super::span::{Crossings, Span, TwoHits, UNIT, crossings_of_wall, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay};
use crate::numeric::Bounds;
use crate::numeric::roots::quadratic_roots;

/// Cylinder around the z axis with radius 1 and z in [-1, 1].
///
/// Part 0 is the wall: `u` is the angle around z from +x towards +y as a fraction of the full circle, `v` increases
/// from 0 at z = -1 to 1 at z = 1. Parts 1 (z = 1) and 2 (z = -1) are the caps, with the surface coordinates of the
/// square around them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// True if caps close the cylinder, which makes it a solid; else it is a tube, whose positive side is the outer
    /// one.
    pub capped: bool,
}

/// Part number of the wall.
const WALL: u32 = 0;
/// Part number of the upper cap.
const TOP: u32 = 1;
/// Part number of the lower cap.
const BOTTOM: u32 = 2;

impl TwoHits for Cylinder {
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let wall = wall_span(ray);
        let caps = Span::slab(ray.origin.z, ray.direction.z, UNIT, [BOTTOM, TOP]);
        if self.capped {
            let own_is_curved = ray.origin_surface.is_some_and(|l| l.part == WALL);
            wall.overlap(caps).crossings_of_convex(ray, own_is_curved)
        } else {
            crossings_of_wall(&wall, &caps, ray)
        }
    }
}

/// Returns the interval of the line inside the infinite cylinder. A line along the axis is entirely inside or outside.
#[inline(always)]
fn wall_span(ray: &ShapeRay) -> Span {
    let (o, d) = (ray.origin, ray.direction);
    let a = d.x * d.x + d.y * d.y;
    let rho = (o.x * o.x + o.y * o.y).sqrt();
    let c = (rho - 1.0) * (rho + 1.0);
    // Handle a line along the axis
    if a == 0.0 {
        return if c <= 0.0 || ray.origin_surface.is_some() {
            Span::ALL
        } else {
            Span::NONE
        };
    }
    // Solve the quadratic, with the discriminant by a cross product
    let b = -(o.x * d.x + o.y * d.y);
    let moment = o.x * d.y - o.y * d.x;
    let [t0, t1] = quadratic_roots(a, b, c, ray.discriminant(a - moment * moment));
    if t0 <= t1 {
        Span::new(t0, t1, WALL)
    } else {
        Span::NONE
    }
}

impl Implicit for Cylinder {
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
        match part {
            TOP => return flat_point(p, 1.0, DVec3::Z),
            BOTTOM => return flat_point(p, -1.0, -DVec3::Z),
            _ => {}
        }
        let surface = self.surface(p, part);
        let DVec3 { x: cos, y: sin, z } = surface.p;
        let uv = [unit_angle(cos, sin), 0.5 * (z + 1.0)];
        let tangents = [TAU * DVec3::new(-sin, cos, 0.0), 2.0 * DVec3::Z];
        surface.parametrized(uv, tangents)
    }

    #[inline]
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        match part {
            TOP => return flat_surface(p, 1.0, DVec3::Z),
            BOTTOM => return flat_surface(p, -1.0, -DVec3::Z),
            _ => {}
        }
        let (_, cos, sin) = polar(p);
        let p = DVec3::new(cos, sin, p.z.clamp(-1.0, 1.0));
        LocatedPoint::new(p, DVec3::new(cos, sin, 0.0), 1.0)
    }

    #[inline]
    fn is_solid(&self) -> bool {
        self.capped
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        self.capped && p.x * p.x + p.y * p.y <= 1.0 && p.z.abs() <= 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hit(capped: bool, o: [f64; 3], d: [f64; 3]) -> Option<ShapeHit> {
        Cylinder { capped }.intersect(&ShapeRay::new(DVec3::from_array(o), DVec3::from_array(d)))
    }

    #[test]
    fn open_tube_is_passed_where_caps_are_hit() {
        for zero in [0.0, -0.0] {
            assert_eq!(
                hit(true, [0.5, 0.0, 3.0], [zero, zero, -1.0]),
                Some(ShapeHit { t: 2.0, part: TOP })
            );
            assert_eq!(
                hit(true, [0.5, 0.0, -3.0], [zero, zero, 1.0]),
                Some(ShapeHit { t: 2.0, part: BOTTOM })
            );
            assert_eq!(hit(false, [0.5, 0.0, 3.0], [zero, zero, -1.0]), None);
        }
        // Down through the open top onto the inner wall: x = 0.5 + t/4 = 1 at t = 2, where z = 2 - 2 = 0.
        assert_eq!(
            hit(false, [0.5, 0.0, 2.0], [0.25, 0.0, -1.0]),
            Some(ShapeHit { t: 2.0, part: WALL })
        );
    }

    #[test]
    fn ray_along_the_wall_hits_solid_but_not_tube() {
        assert_eq!(
            hit(true, [1.0, 0.0, 3.0], [0.0, 0.0, -1.0]).map(|h| h.t),
            Some(2.0)
        );
        assert_eq!(hit(false, [1.0, 0.0, 3.0], [0.0, 0.0, -1.0]), None);
        assert_eq!(hit(true, [1.0 + f64::EPSILON, 0.0, 3.0], [0.0, 0.0, -1.0]), None);
    }

    #[test]
    fn a_ray_through_the_rim_hits() {
        // From (2, 0, 2) to (1, 0, 1), the ray touches the solid in one point.
        assert_eq!(
            hit(true, [2.0, 0.0, 2.0], [-1.0, 0.0, -1.0]).map(|h| h.t),
            Some(1.0)
        );
        assert_eq!(
            hit(true, [0.0, 0.0, 2.0], [1.0, 0.0, -1.0]).map(|h| h.t),
            Some(1.0)
        );
    }
}
