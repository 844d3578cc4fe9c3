//! Analytic shape: the general quadric xᵀ Q x = 0 with homogeneous x = (x, y, z, 1), clipped by a box.
//!
//! The quadratic's coefficients are formed at the line's point nearest to the box's centre, and then once more halfway
//! between the roots, where they are smallest: those of a thin ellipsoid are huge anywhere else.

use glam::DVec3;

use super::parametrization::nearest_to_origin;
use super::span::{Crossings, NO_HIT, NO_HITS, Span, nearest, report};
use super::{Implicit, LocatedPoint, ShapeHit, ShapePoint, ShapeRay, Side};
use crate::numeric::Bounds;
use crate::numeric::roots::quadratic_roots;

/// Part of a quadric inside a clip box, an open surface. Its positive side is where xᵀ Q x > 0.
///
/// The surface coordinates are those of the point within the box, over [0, 1]², projected along the axis that the
/// normal is nearest to: y and z along x, z and x along y, x and y along z, the first mirrored if the normal points in
/// the negative direction of the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadric {
    q: [f64; 10],
    clip: Bounds,
}

/// Reason why a quadric is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum QuadricError {
    /// Coefficient that is infinite or NaN.
    #[error("a coefficient of the quadric is not finite")]
    NotFinite,
    /// Equation whose coefficients except for the constant are all zero.
    #[error("all coefficients of the quadric except the constant are zero, so it is not a surface")]
    Constant,
    /// Clip box without a volume.
    #[error("the quadric's clip box is empty, flat or not finite: give a low corner below a high one")]
    BadBox,
}

impl Quadric {
    /// Creates the quadric whose symmetric matrix has the upper triangle `q`, row by row: q00 q01 q02 q03 q11 q12 q13
    /// q22 q23 q33, so that the sphere is `[1, 0, 0, 0, 1, 0, 0, 1, 0, -1]` and `x y = z` has q01 = 1/2 and q23 = -1/2.
    pub fn new(q: [f64; 10], clip: Bounds) -> Result<Quadric, QuadricError> {
        if !q.iter().all(|x| x.is_finite()) {
            return Err(QuadricError::NotFinite);
        }
        if q[..9].iter().all(|x| *x == 0.0) {
            return Err(QuadricError::Constant);
        }
        let finite = clip.min.is_finite() && clip.max.is_finite();
        if !(finite && clip.min.cmplt(clip.max).all()) {
            return Err(QuadricError::BadBox);
        }
        Ok(Quadric { q, clip })
    }

    /// Returns the upper triangle of the matrix, row by row.
    pub fn coefficients(&self) -> [f64; 10] {
        self.q
    }

    /// Multiplies the upper left 3x3 of the matrix by `v`.
    #[inline(always)]
    fn linear(&self, v: DVec3) -> DVec3 {
        let q = &self.q;
        DVec3::new(
            q[0] * v.x + q[1] * v.y + q[2] * v.z,
            q[1] * v.x + q[4] * v.y + q[5] * v.z,
            q[2] * v.x + q[5] * v.y + q[7] * v.z,
        )
    }

    /// Returns xᵀ Q x and half its gradient at `p`.
    #[inline(always)]
    fn value(&self, p: DVec3) -> (f64, DVec3) {
        let affine = DVec3::new(self.q[3], self.q[6], self.q[8]);
        let half_gradient = self.linear(p) + affine;
        (p.dot(half_gradient) + affine.dot(p) + self.q[9], half_gradient)
    }

    /// Returns both hits of the ray inside the clip box.
    #[inline(always)]
    fn intersections(&self, ray: &ShapeRay) -> Crossings {
        // Form the quadratic at the line's point nearest to the box's centre
        let d = ray.direction;
        let center = self.clip.center();
        let (shift, o) = nearest_to_origin(ray.origin - center, d);
        let (c, half_gradient) = self.value(center + o);
        let a = d.dot(self.linear(d));
        let b = -d.dot(half_gradient);
        let clip = self.clip_span(ray);
        let middle = b / a;
        // Refine halfway between the roots, unless that is outside the box, where the coefficients are larger again.
        let [t0, t1] = if clip.contains(shift + middle) {
            let (c, half_gradient) = self.value(center + o + middle * d);
            let b = -d.dot(half_gradient);
            let half = (ray.discriminant(b * b - a * c).sqrt() / a).abs();
            // Nothing cancels: only roundings remain of `b`.
            [-half, half].map(|t| shift + middle + (b / a + t))
        } else {
            quadratic_roots(a, b, c, ray.discriminant(b * b - a * c)).map(|t| shift + t)
        };
        // Discard hits outside the clip box
        let cut = |t: f64| {
            if clip.contains(t) {
                ShapeHit { t, part: 0 }
            } else {
                NO_HIT
            }
        };
        let Some(origin_surface) = ray.origin_surface else {
            return [cut(t0), cut(t1)];
        };
        // The value changes sign at the own root in one direction and at the other root in the opposite one: the other
        // root lies ahead if it is the later of the two, and then beyond the start.
        let ahead = match origin_surface.side {
            Side::Outside => a < 0.0,
            Side::Inside => a > 0.0,
        };
        if ahead && t1 > 0.0 {
            [NO_HIT, cut(t1)]
        } else {
            NO_HITS
        }
    }

    /// Returns the interval of the line inside the clip box.
    #[inline(always)]
    fn clip_span(&self, ray: &ShapeRay) -> Span {
        let slab = |axis: usize| {
            let range = [self.clip.min[axis], self.clip.max[axis]];
            Span::slab(ray.origin[axis], ray.direction[axis], range, [0; 2])
        };
        slab(0).overlap(slab(1)).overlap(slab(2))
    }
}

/// Number of Newton steps that project a point onto the surface: the first leaves the square of its distance, the
/// second that of a rounding.
const PROJECTION_STEPS: usize = 2;

impl Implicit for Quadric {
    #[inline]
    fn bounds(&self) -> Bounds {
        self.clip
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        nearest(ray, self.intersections(ray))
    }

    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        report(ray, self.intersections(ray), out);
    }

    fn point(&self, p: DVec3, _part: u32) -> ShapePoint {
        // Project the point onto the surface
        let mut p = p;
        for _ in 0..PROJECTION_STEPS {
            let (value, half_gradient) = self.value(p);
            let square = half_gradient.length_squared();
            if square > 0.0 {
                p -= (0.5 * value / square) * half_gradient;
            }
        }
        let g = self.value(p).1;
        let along = g.abs().max_position();
        let (right, up) = ((along + 1) % 3, (along + 2) % 3);
        let (center, extent) = (self.clip.center(), self.clip.extent());
        // Mirror if the normal points in the negative direction of the axis, so that dpdu x dpdv points along the
        // normal.
        let spans = [extent[right] * 1f64.copysign(g[along]), extent[up]];
        let uv = [
            (p[right] - center[right]) / spans[0] + 0.5,
            (p[up] - center[up]) / spans[1] + 0.5,
        ];
        // On the surface g · dp = 0, which gives the component along the third axis.
        let tangent = |axis: usize, span: f64| {
            let slope = if g[along] == 0.0 { 0.0 } else { g[axis] / g[along] };
            span * (DVec3::AXES[axis] - slope * DVec3::AXES[along])
        };
        let tangents = [tangent(right, spans[0]), tangent(up, spans[1])];
        LocatedPoint::new(p, g.normalize_or(DVec3::Z), self.clip.magnitude()).parametrized(uv, tangents)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saddle_is_hit_where_its_height_is_the_product() {
        let mut q = [0.0; 10];
        (q[1], q[8]) = (0.5, -0.5);
        let clip = Bounds {
            min: -DVec3::ONE,
            max: DVec3::ONE,
        };
        let saddle = Quadric::new(q, clip).unwrap();
        let hit = saddle.intersect(&ShapeRay::new(DVec3::new(0.5, -0.5, 4.0), -DVec3::Z));
        assert_eq!(hit.map(|h| h.t), Some(4.25));
        assert_eq!(
            saddle.intersect(&ShapeRay::new(DVec3::new(1.5, 0.5, 4.0), -DVec3::Z)),
            None
        );
    }

    #[test]
    fn invalid_quadrics_are_rejected() {
        let clip = Bounds {
            min: -DVec3::ONE,
            max: DVec3::ONE,
        };
        let mut q = [0.0; 10];
        q[9] = 1.0;
        assert_eq!(Quadric::new(q, clip), Err(QuadricError::Constant));
        q[0] = f64::NAN;
        assert_eq!(Quadric::new(q, clip), Err(QuadricError::NotFinite));
        q[0] = 1.0;
        assert_eq!(Quadric::new(q, Bounds::EMPTY), Err(QuadricError::BadBox));
    }
}
