//! Analytic shapes: each by its implicit form in object space, in f64, one file a shape.
//!
//! A shape knows nothing of instances, materials or acceleration structures. It is asked with the exact f64 extension
//! of an f32 ray and answers with the parameter in f64.
//!
//! Every answer is backward stable: it is the exact answer for a surface moved by a few roundings of the coordinates
//! involved. Convex solids are the overlap of parameter intervals, one a bounding surface, so that no ray slips
//! between two of their parts. A ray that starts on a shape says so ([`OriginSurface`]); its own root is then left out by
//! algebra, not by distance.

mod cone;
mod cube;
mod cylinder;
mod disk;
pub(crate) mod oracle;
mod parametrization;
mod plane;
mod polyhedron;
mod quad;
mod quadric;
mod span;
mod sphere;
#[cfg(test)]
mod tests;
mod torus;

use std::sync::Arc;

use glam::DVec3;

use crate::numeric::{Bounds, HitErrorBound};

pub use cone::Cone;
pub use cube::Cube;
pub use cylinder::Cylinder;
pub use disk::Disk;
pub(crate) use parametrization::tangents;
pub use plane::Plane;
pub use polyhedron::{HalfSpace, Polyhedron, PolyhedronError};
pub use quad::Quad;
pub use quadric::{Quadric, QuadricError};
pub use sphere::Sphere;
pub use torus::Torus;

/// A ray in object space, with what is known of where it starts.
#[derive(Clone, Copy, Debug)]
pub struct ShapeRay {
    /// The point at `t = 0`.
    pub origin: DVec3,
    /// Direction, of any non-zero length, never renormalised: `t` is measured in its length.
    pub direction: DVec3,
    /// Nearest parameter that counts; not negative.
    pub t_near: f64,
    /// Farthest parameter that counts; may be infinite.
    pub t_far: f64,
    /// Set where the ray starts on the very shape that is asked.
    pub leaving: Option<OriginSurface>,
}

impl ShapeRay {
    /// A ray over `t` in [0, ∞) that comes from elsewhere.
    pub fn new(origin: DVec3, direction: DVec3) -> ShapeRay {
        ShapeRay {
            origin,
            direction,
            t_near: 0.0,
            t_far: f64::INFINITY,
            leaving: None,
        }
    }

    /// The point at `t`.
    #[inline(always)]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.direction
    }

    /// Whether a crossing at `t` counts: within the interval, both ends included, and finite. NaN does not.
    #[inline(always)]
    pub fn admits(&self, t: f64) -> bool {
        self.t_near <= t && t <= self.t_far && t < f64::INFINITY
    }
}

impl ShapeRay {
    /// The discriminant to go by: a ray that starts on a quadric meets it, so where rounding has put its start beside
    /// the surface and its line misses, it touches instead.
    #[inline(always)]
    fn discriminant(&self, computed: f64) -> f64 {
        if self.leaving.is_some() {
            computed.max(0.0)
        } else {
            computed
        }
    }
}

/// The ray starts on this very shape: its own root is divided out (root deflation), so no epsilon is needed.
///
/// The origin may be off the surface by its rounding to f32. A ray that does not go to the side it names, by more than
/// that, meets nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OriginSurface {
    /// The part that it starts on, as in [`ShapeHit::part`].
    pub part: u32,
    /// The side that it goes to.
    pub side: Side,
}

/// A side of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The side that the normal points to.
    Outside,
    /// The other side.
    Inside,
}

/// One crossing of a ray and a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeHit {
    /// The ray's parameter.
    pub t: f64,
    /// The face of a polyhedron, wall or cap of a cylinder, and so on; 0 where there is one.
    pub part: u32,
}

/// What shading needs to know of a point on a shape, in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapePoint {
    /// The point, projected onto the surface.
    pub p: DVec3,
    /// Outward unit normal; for sheets (plane, disk, quad, whatever is open) that of the positive side.
    pub n: DVec3,
    /// Surface coordinates.
    pub uv: [f64; 2],
    /// Derivative of the point by `u`; zero where a pole makes it so.
    pub dpdu: DVec3,
    /// Derivative of the point by `v`; `dpdu x dpdv` points along `n`.
    pub dpdv: DVec3,
    /// How far `p`, rounded to f32, may lie from the surface: what to offset a new ray's origin by.
    pub error: HitErrorBound,
}

/// What the f64 projection onto a surface of unit size may leave over: 8 roundings of 2^-53.
const PROJECTION_ERROR: f64 = 8.0 / (1u64 << 53) as f64;

impl ShapePoint {
    /// A point with its error bound: rounding to f32, and the roundings of the projection relative to the larger of
    /// `size` and the coordinates.
    #[inline(always)]
    fn new(p: DVec3, n: DVec3, uv: [f64; 2], [dpdu, dpdv]: [DVec3; 2], size: f64) -> ShapePoint {
        let projection = PROJECTION_ERROR * p.abs().max_element().max(size);
        ShapePoint {
            p,
            n,
            uv,
            dpdu,
            dpdv,
            error: HitErrorBound(HitErrorBound::of_exact_point(p).0 + DVec3::splat(projection)),
        }
    }
}

/// A surface given by an equation, in object space.
pub trait Implicit {
    /// A box around it; infinite for the plane.
    fn bounds(&self) -> Bounds;

    /// The nearest crossing with `t_near <= t <= t_far`, both ends included.
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit>;

    /// Every crossing within the ray's interval, entries and exits, in ascending `t`. Where a ray touches a solid, its
    /// entry and its exit have the same `t`.
    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit));

    /// The point of `part` at `p`, which lies near it.
    fn point(&self, p: DVec3, part: u32) -> ShapePoint;

    /// Whether the surface encloses a volume; sheets do not.
    #[inline]
    fn is_solid(&self) -> bool {
        false
    }

    /// Whether a solid's volume, boundary included, contains `p`. A sheet contains nothing.
    #[inline]
    fn contains(&self, _p: DVec3) -> bool {
        false
    }
}

/// Any shape, stored by value; what is large is shared.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A sphere of any centre and radius.
    Sphere(Sphere),
    /// The plane z = 0.
    Plane,
    /// The cube [-1, 1]³.
    Cube,
    /// A convex polyhedron.
    Polyhedron(Arc<Polyhedron>),
    /// The unit disk in the plane z = 0.
    Disk,
    /// The square [-1, 1]² in the plane z = 0.
    Quad,
    /// A cylinder around the z axis.
    Cylinder(Cylinder),
    /// A cone around the z axis.
    Cone(Cone),
    /// A torus around the z axis.
    Torus(Torus),
    /// A general quadric cut off by a box.
    Quadric(Arc<Quadric>),
}

/// Runs `$body` with `$shape` bound to the shape that `$of` holds.
macro_rules! forward {
    ($of:expr, $shape:ident => $body:expr) => {
        match $of {
            Shape::Sphere($shape) => $body,
            Shape::Plane => {
                let $shape = &Plane;
                $body
            }
            Shape::Cube => {
                let $shape = &Cube;
                $body
            }
            Shape::Polyhedron($shape) => {
                let $shape = &**$shape;
                $body
            }
            Shape::Disk => {
                let $shape = &Disk;
                $body
            }
            Shape::Quad => {
                let $shape = &Quad;
                $body
            }
            Shape::Cylinder($shape) => $body,
            Shape::Cone($shape) => $body,
            Shape::Torus($shape) => $body,
            Shape::Quadric($shape) => {
                let $shape = &**$shape;
                $body
            }
        }
    };
}

impl Implicit for Shape {
    #[inline]
    fn bounds(&self) -> Bounds {
        forward!(self, shape => Implicit::bounds(shape))
    }

    #[inline]
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit> {
        forward!(self, shape => shape.intersect(ray))
    }

    #[inline]
    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit)) {
        forward!(self, shape => shape.crossings(ray, out));
    }

    #[inline]
    fn point(&self, p: DVec3, part: u32) -> ShapePoint {
        forward!(self, shape => shape.point(p, part))
    }

    #[inline]
    fn is_solid(&self) -> bool {
        forward!(self, shape => shape.is_solid())
    }

    #[inline]
    fn contains(&self, p: DVec3) -> bool {
        forward!(self, shape => shape.contains(p))
    }
}
