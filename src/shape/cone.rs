//! Analytic shape: the cone x² + y² = w², w = (1 - z) / 2, between its base at z = -1 and its apex at z = 1.
//!
//! The discriminant is a sum of cross products (Lagrange's identity in the metric + + -), and the line is first moved
//! to its point nearest to the apex: `a` vanishes for lines along the wall, so `a t²` would magnify its rounding for a
//! distant ray, and near the apex all relevant terms are as small as the distance from it. The finite root survives `a
//! = 0`: there is no special case.

use std::f64::consts::TAU;

use glam::DVec3;

use super::disk::{flat_point, flat_surface};
use super::parametrization::{nearest_to_origin, polar, unit_angle};
use super::span::{Crossings, Span, TwoHits, crossings_of_wall, nearest, report};
use super::{Implicit, LocatedPoint, OriginSurface, ShapeHit, ShapePoint, ShapeRay, Side};
use crate::numeric::Bounds;
use crate::numeric::roots::quadratic_roots;

/// Cone around the z axis: base of radius 1 at z = -1, apex at z = 1.
///
/// Part 0 is the wall: `u` is the angle around z from +x towards +y as a fraction of the full circle, `v` increases
/// from 0 at the base to 1 at the apex, where `dpdu` vanishes and the normal is +z. Part 1 is the base, with the
/// surface coordinates of the square around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// True if a base closes the cone, which makes it a solid; else its positive side is the outer one.
    pub capped: bool,
}

/// Part number of the wall.
const WALL: u32 = 0;
/// Part number of the base.
const BASE: u32 = 1;

impl TwoHits for Cone {
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        let wall = wall_span(ray);
        // Clip at the base only: the nappe itself ends at the apex.
        let above_base = Span::slab(ray.origin.z, ray.direction.z, [-1.0, f64::INFINITY], [BASE, WALL]);
        if self.capped {
            let own_is_curved = ray.origin_surface.is_some_and(|l| l.part == WALL);
            wall.overlap(above_base).crossings_of_convex(ray, own_is_curved)
        } else {
            crossings_of_wall(&wall, &above_base, ray)
        }
    }
}

/// Returns the interval of the line inside the nappe below the apex, which is convex.
#[inline(always)]
fn wall_span(ray: &ShapeRay) -> Span {
    let d = ray.direction;
    // Shift the origin to the point nearest to the apex
    let (shift, o) = nearest_to_origin(ray.origin - DVec3::Z, d);
    let (w, dw) = (-0.5 * o.z, -0.5 * d.z);
    let a = d.x * d.x + d.y * d.y - dw * dw;
    let b = w * dw - (o.x * d.x + o.y * d.y);
    let rho = (o.x * o.x + o.y * o.y).sqrt();
    let c = (rho - w) * (rho + w);
    // Solve the quadratic, with the discriminant by cross products
    let (across_x, across_y) = (o.x * dw - w * d.x, o.y * dw - w * d.y);
    let moment = o.x * d.y - o.y * d.x;
    let discriminant = across_x * across_x + across_y * across_y - moment * moment;
    let [t0, t1] = quadratic_roots(a, b, c, ray.discriminant(discriminant));
    if !(t0 <= t1) {
        return Span::NONE;
    }
    let (t0, t1) = (shift + t0, shift + t1);
    if a >= 0.0 {
        // Inside between the roots, both on one nappe: the lower one if w is positive halfway.
        let halfway = w + (b / a) * dw;
        if halfway >= 0.0 {
            Span::new(t0, t1, WALL)
        } else {
            Span::NONE
        }
    } else if dw > 0.0 {
        Span::new(t1, f64::INFINITY, WALL)
    } else if matches!(
        ray.origin_surface,
        Some(OriginSurface {
            part: WALL,
            side: Side::Inside
        })
    ) {
        // For a direction steeper than the wall and upwards, no ray goes from the wall to the inside.
        Span::NONE
    } else {
        Span::new(f64::NEG_INFINITY, t0, WALL)
    }
}

impl Implicit for Cone {
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
        if part == BASE {
            return flat_point(p, -1.0, -DVec3::Z);
        }
        let (_, cos, sin) = polar(p);
        let surface = self.surface(p, part);
        let z = surface.p.z;
        let uv = [unit_angle(cos, sin), 0.5 * (z + 1.0)];
        let tangents = [
            TAU * (0.5 * (1.0 - z)) * DVec3::new(-sin, cos, 0.0),
            DVec3::new(-cos, -sin, 2.0),
        ];
        surface.parametrized(uv, tangents)
    }

    #[inline]
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        if part == BASE {
            return flat_surface(p, -1.0, -DVec3::Z);
        }
        let (rho, cos, sin) = polar(p);
        // Subtract the distance from the generator along its normal (2, 1) / √5.
        let excess = (2.0 * rho + p.z - 1.0) / 5.0;
        let z = (p.z - excess).clamp(-1.0, 1.0);
        let radius = 0.5 * (1.0 - z);
        let n = if radius == 0.0 {
            DVec3::Z
        } else {
            DVec3::new(2.0 * cos, 2.0 * sin, 1.0) / 5f64.sqrt()
        };
        LocatedPoint::new(DVec3::new(radius * cos, radius * sin, z), n, 1.0)
    }

    #[inline]
    fn is_solid(&self) -> bool {
        self.capped
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        self.capped && p.z >= -1.0 && p.x.hypot(p.y) <= 0.5 * (1.0 - p.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hit(capped: bool, o: [f64; 3], d: [f64; 3]) -> Option<ShapeHit> {
        Cone { capped }.intersect(&ShapeRay::new(DVec3::from_array(o), DVec3::from_array(d)))
    }

    #[test]
    fn the_wall_is_hit_at_half_height_and_the_base_from_below() {
        // At z = 0 the radius is 1/2.
        assert_eq!(
            hit(true, [3.0, 0.0, 0.0], [-1.0, 0.0, 0.0]),
            Some(ShapeHit { t: 2.5, part: WALL })
        );
        assert_eq!(
            hit(true, [0.25, 0.0, -4.0], [0.0, 0.0, 1.0]),
            Some(ShapeHit { t: 3.0, part: BASE })
        );
        // Open cone: up to the wall from inside, at x = 1/4 where z = 1/2.
        assert_eq!(
            hit(false, [0.25, 0.0, -4.0], [0.0, 0.0, 1.0]),
            Some(ShapeHit { t: 4.5, part: WALL })
        );
    }

    #[test]
    fn a_ray_along_a_generator_hits_the_opposite_wall_and_misses_the_mirror_nappe() {
        // From (-1, 0, 1) parallel to the generator (1, 0, -2): intersects x = -w, i.e. -1 + t = -t, at t = 1/2.
        let along = hit(true, [-1.0, 0.0, 1.0], [1.0, 0.0, -2.0]).unwrap();
        assert!((along.t - 0.5).abs() <= f64::EPSILON, "{along:?}");
        assert_eq!(hit(true, [3.0, 0.0, 2.0], [-1.0, 0.0, 0.0]), None);
        assert_eq!(
            hit(false, [0.3, 0.0, 5.0], [0.0, 0.0, -1.0]).map(|h| h.part),
            Some(WALL)
        );
    }

    #[test]
    fn a_ray_down_the_axis_hits_the_apex() {
        assert_eq!(
            hit(true, [0.0, 0.0, 3.0], [0.0, -0.0, -1.0]).map(|h| h.t),
            Some(2.0)
        );
        assert_eq!(Cone { capped: true }.point(DVec3::Z, 0).n, DVec3::Z);
    }
}
