//! Analytic shape: the torus (|p|² + 1 - r²)² = 4 (x² + y²), around the z axis.
//!
//! The condition number of the quartic grows with the fourth power of the origin's distance, so its coefficients are
//! formed at the line's point nearest to the centre, for a unit direction: there `|p|² = m + τ²` and the cubic term
//! vanishes. Roots are isolated between the extrema, without radicals, and polished on the distance form
//! `(ρ - 1)² + z² - r² = 0`, whose rounding is a few ulps of the coordinates for any thickness of the tube. For a ray that starts on
//! the torus its own root is divided out, which leaves a cubic.

use std::f64::consts::TAU;

use glam::DVec3;

use super::parametrization::{nearest_to_origin, polar, unit_angle};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay, Side};
use crate::numeric::Bounds;
use crate::numeric::roots::{cubic_sign_changes, quartic_sign_changes};

/// Solid torus around the z axis; the centre line of its tube is the unit circle in z = 0.
///
/// `u` is the angle around z from +x towards +y, `v` the angle around the tube from its outer equator towards +z, both
/// as fractions of the full circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torus {
    /// Radius of the tube, in (0, 1).
    pub minor_radius: f64,
}

/// Margin by which the searched interval exceeds the torus, so that both of its ends lie outside in spite of rounding.
const MARGIN: f64 = 1.0 / (1 << 20) as f64;

/// Line in the form from which the quartic is built.
struct TorusLine {
    /// Point of the line nearest to the centre.
    foot: DVec3,
    /// Unit direction of the line.
    direction: DVec3,
    /// Ray parameter at `foot`, and its change per unit of length.
    t_foot: f64,
    t_unit: f64,
    /// Interval of length, from `foot`, outside which the line cannot hit the torus.
    reach: [f64; 2],
}

impl Torus {
    /// Prepares the line of a ray; `None` if it passes the torus at a distance.
    #[inline(always)]
    fn line(&self, ray: &ShapeRay) -> Option<TorusLine> {
        let r = self.minor_radius;
        let t_unit = 1.0 / ray.direction.length();
        let direction = ray.direction * t_unit;
        // Shift twice: the second shift removes the rounding error of the first for a distant origin.
        let (first, o) = nearest_to_origin(ray.origin, ray.direction);
        let (second, foot) = nearest_to_origin(o, ray.direction);
        // Clip to the bounding sphere
        let room = (1.0 + r) * (1.0 + r) - foot.length_squared();
        if !(room >= 0.0 || ray.origin_surface.is_some()) {
            return None;
        }
        let half = room.max(0.0).sqrt() + MARGIN;
        let mut reach = [-half, half];
        // Clip to the slab |z| <= r
        if direction.z != 0.0 {
            let middle = -foot.z / direction.z;
            let thick = r / direction.z.abs() + MARGIN;
            reach = [reach[0].max(middle - thick), reach[1].min(middle + thick)];
        } else if foot.z.abs() > r && ray.origin_surface.is_none() {
            return None;
        }
        (reach[0] < reach[1]).then_some(TorusLine {
            foot,
            direction,
            t_foot: first + second,
            t_unit,
            reach,
        })
    }

    /// Returns the coefficients of the quartic in the length along the line, constant term first.
    #[inline(always)]
    fn quartic(&self, line: &TorusLine) -> [f64; 5] {
        let (p, d, r) = (line.foot, line.direction, self.minor_radius);
        let k = p.length_squared() + (1.0 - r) * (1.0 + r);
        let rho = (p.x * p.x + p.y * p.y).sqrt();
        // Evaluate k² - 4 ρ², with k - 2 ρ = (ρ - 1)² + z² - r².
        let from_circle = ((rho - 1.0) * (rho - 1.0) + p.z * p.z).sqrt();
        let constant = (from_circle - r) * (from_circle + r) * (k + 2.0 * rho);
        let across = d.x * d.x + d.y * d.y;
        [
            constant,
            -8.0 * (p.x * d.x + p.y * d.y),
            2.0 * k - 4.0 * across,
            0.0,
            1.0,
        ]
    }

    /// Passes the hits in ascending order to `found` until it returns false.
    #[inline]
    fn search(&self, ray: &ShapeRay, mut found: impl FnMut(ShapeHit) -> bool) {
        let Some(line) = self.line(ray) else {
            return;
        };
        let c = self.quartic(&line);
        let hit = |tau: f64| ShapeHit {
            t: line.t_foot + tau * line.t_unit,
            part: 0,
        };
        // Without an own root, isolate the roots of the quartic
        let Some(origin_surface) = ray.origin_surface else {
            let mut enters = false;
            return quartic_sign_changes(&c, line.reach, true, |tau| {
                enters = !enters;
                found(hit(self.polished(&line, tau, enters, POLISH_LIMIT)))
            });
        };
        // Divide the own root out by synthetic division by (τ - own); the remainder, the start's distance from the
        // surface, is dropped.
        let own = -line.t_foot / line.t_unit;
        let c2 = c[3] + own;
        let c1 = c[2] + own * c2;
        let cubic = [c[1] + own * c1, c1, c2, 1.0];
        if !(own < line.reach[1]) {
            return;
        }
        // Isolate the roots of the cubic beyond the start
        let starts_outside = origin_surface.side == Side::Outside;
        let mut enters = !starts_outside;
        cubic_sign_changes(&cubic, [own, line.reach[1]], starts_outside, |tau| {
            enters = !enters;
            let limit = 0.25 * (tau - own);
            found(hit(self.polished(&line, tau, enters, limit)))
        });
    }

    /// Refines a root by Newton steps on the distance form, at most `limit` long, each at most half the previous one.
    #[inline]
    fn polished(&self, line: &TorusLine, tau: f64, enters: bool, limit: f64) -> f64 {
        let (mut tau, mut limit) = (tau, limit.min(0.25 * self.minor_radius));
        for _ in 0..POLISH_STEPS {
            let p = line.foot + tau * line.direction;
            let d = line.direction;
            let rho = (p.x * p.x + p.y * p.y).sqrt();
            let from_circle = ((rho - 1.0) * (rho - 1.0) + p.z * p.z).sqrt();
            let value = (from_circle - self.minor_radius) * (from_circle + self.minor_radius);
            let slope = 2.0 * ((rho - 1.0) * (p.x * d.x + p.y * d.y) / rho + p.z * d.z);
            let step = value / slope;
            if (slope < 0.0) != enters || !(step.abs() <= limit) {
                break;
            }
            tau -= step;
            limit = 0.5 * step.abs();
        }
        tau
    }
}

/// Number of Newton steps; the first removes the quartic's own rounding, the others the remainder that deflation
/// dropped.
const POLISH_STEPS: usize = 3;
/// Longest step that the quartic's rounding explains, unless the line is nearly tangent: √2^-53.
const POLISH_LIMIT: f64 = 1.1e-8;

impl Implicit for Torus {
    #[inline]
    fn bounds(&self) -> Bounds {
        let reach = 1.0 + self.minor_radius;
        let max = DVec3::new(reach, reach, self.minor_radius);
        Bounds { min: -max, max }
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        let mut first = None;
        self.search(ray, |hit| {
            first = ray.in_range(hit.t).then_some(hit);
            hit.t < ray.t_near
        });
        first
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        self.search(ray, |hit| {
            if ray.in_range(hit.t) {
                out(hit);
            }
            true
        });
    }

    fn point(&self, p: DVec3, _part: u32) -> ShapePoint {
        let r = self.minor_radius;
        // Project the point onto the tube
        let (rho, cos, sin) = polar(p);
        let from_circle = (rho - 1.0).hypot(p.z);
        let (out, up) = if from_circle == 0.0 {
            (1.0, 0.0)
        } else {
            ((rho - 1.0) / from_circle, p.z / from_circle)
        };
        let rho = 1.0 + r * out;
        // Compute normal and derivatives
        let n = DVec3::new(out * cos, out * sin, up);
        let dpdu = TAU * rho * DVec3::new(-sin, cos, 0.0);
        let dpdv = TAU * r * DVec3::new(-up * cos, -up * sin, out);
        let p = DVec3::new(rho * cos, rho * sin, r * up);
        let uv = [unit_angle(cos, sin), unit_angle(out, up)];
        LocatedPoint::new(p, n, 1.0).parametrized(uv, [dpdu, dpdv])
    }

    #[inline]
    fn is_solid(&self) -> bool {
        true
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        (p.x.hypot(p.y) - 1.0).hypot(p.z) <= self.minor_radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TORUS: Torus = Torus { minor_radius: 0.25 };

    fn all(o: [f64; 3], d: [f64; 3]) -> Vec<f64> {
        let mut t = Vec::new();
        let ray = ShapeRay::new(DVec3::from_array(o), DVec3::from_array(d));
        TORUS.crossings(&ray, &mut |hit| t.push(hit.t));
        t
    }

    #[test]
    fn a_ray_across_the_equator_crosses_four_times() {
        for zero in [0.0, -0.0] {
            let t = all([3.0, zero, zero], [-1.0, zero, zero]);
            for (t, exact) in t.iter().zip([1.75, 2.25, 3.75, 4.25]) {
                assert!((t - exact).abs() <= 4.0 * f64::EPSILON * exact, "{t} for {exact}");
            }
            assert_eq!(t.len(), 4);
        }
    }

    #[test]
    fn a_ray_down_the_hole_misses_and_one_through_the_tube_crosses_twice() {
        assert!(all([0.0, 0.0, 3.0], [0.0, 0.0, -1.0]).is_empty());
        assert!(all([0.74, 0.0, 3.0], [0.0, 0.0, -1.0]).is_empty());
        assert_eq!(all([1.0, 0.0, 3.0], [0.0, 0.0, -1.0]).len(), 2);
    }
}
