//! Analytic shapes, each given by its implicit form in object space, in f64, one file per shape.
//!
//! A shape is independent of instances, materials and acceleration structures. Its input is the exact f64 extension of
//! an f32 ray, its result the hit parameter in f64.
//!
//! Every result is backward stable: it is the exact result for a surface moved by a few roundings of the coordinates
//! involved. Convex solids are the overlap of parameter intervals, one per bounding surface, so that no ray passes
//! between two of their parts. A ray that starts on a shape says so ([`OriginSurface`]); its own root is then removed
//! by algebra, not by distance.

mod cone;
mod cube;
mod cylinder;
mod disk;
mod hit_packet;
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
pub(crate) use hit_packet::{ObjectHitPacket, refined_parameter, set_masked, set_vector, vector};
pub(crate) use parametrization::tangents;
pub use plane::Plane;
pub use polyhedron::{HalfSpace, Polyhedron, PolyhedronError};
pub use quad::Quad;
pub use quadric::{Quadric, QuadricError};
pub use sphere::Sphere;
pub use torus::Torus;

/// Ray in object space, with the surface that it starts on, if any.
#[derive(Clone, Copy, Debug)]
pub struct ShapeRay {
    /// Point of the ray at `t = 0`.
    pub origin: DVec3,
    /// Direction of any non-zero length, never renormalised: `t` is in units of its length.
    pub direction: DVec3,
    /// Smallest parameter in range; not negative.
    pub t_near: f64,
    /// Largest parameter in range; may be infinite.
    pub t_far: f64,
    /// Set if the ray starts on the shape that is intersected.
    pub origin_surface: Option<OriginSurface>,
}

impl ShapeRay {
    /// Creates a ray over `t` in [0, ∞) that does not start on the shape.
    pub fn new(origin: DVec3, direction: DVec3) -> ShapeRay {
        ShapeRay {
            origin,
            direction,
            t_near: 0.0,
            t_far: f64::INFINITY,
            origin_surface: None,
        }
    }

    /// Returns the point at parameter `t`.
    #[inline(always)]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + t * self.direction
    }

    /// Returns whether a hit at `t` is in range: within the interval, both ends included, and finite. False for NaN.
    #[inline(always)]
    pub(crate) fn in_range(&self, t: f64) -> bool {
        self.t_near <= t && t <= self.t_far && t < f64::INFINITY
    }
}

impl ShapeRay {
    /// Returns the discriminant to use. A ray that starts on a quadric intersects it, so if rounding has moved its
    /// start off the surface and its line misses, it is treated as a tangent.
    #[inline(always)]
    fn discriminant(&self, computed: f64) -> f64 {
        if self.origin_surface.is_some() {
            computed.max(0.0)
        } else {
            computed
        }
    }
}

/// Surface that a ray starts on. The ray's own root is divided out (root deflation), so no epsilon is needed.
///
/// The origin may be off the surface by its rounding to f32. A ray that does not go to the named side, by more than
/// that rounding, hits nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OriginSurface {
    /// Part that the ray starts on, as in [`ShapeHit::part`].
    pub part: u32,
    /// Side that the ray goes to.
    pub side: Side,
}

/// Side of a surface, relative to its normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Side that the normal points to.
    Outside,
    /// Side opposite to the normal.
    Inside,
}

/// One intersection of a ray and a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeHit {
    /// Ray parameter of the hit.
    pub t: f64,
    /// Number of the part: the face of a polyhedron, wall or cap of a cylinder, and so on; 0 for shapes of one part.
    pub part: u32,
}

/// Position and normal of a surface point, in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocatedPoint {
    /// Position, projected onto the surface.
    pub p: DVec3,
    /// Outward unit normal, as in [`ShapePoint::n`].
    pub n: DVec3,
    /// Bound on the distance of `p`, rounded to f32, from the surface; the origins of spawned rays are offset by it.
    pub error: HitErrorBound,
}

/// Surface point with the data that shading needs, in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapePoint {
    /// Position, projected onto the surface.
    pub p: DVec3,
    /// Outward unit normal; for open surfaces (plane, disk, quad, uncapped shapes) that of the positive side.
    pub n: DVec3,
    /// Surface coordinates u and v.
    pub uv: [f64; 2],
    /// Derivative of the point by `u`; zero at a pole.
    pub dpdu: DVec3,
    /// Derivative of the point by `v`; `dpdu x dpdv` points along `n`.
    pub dpdv: DVec3,
    /// Bound on the distance of `p`, rounded to f32, from the surface; the origins of spawned rays are offset by it.
    pub error: HitErrorBound,
}

/// Largest error of the f64 projection onto a surface of unit size: 8 roundings of 2^-53.
const PROJECTION_ERROR: f64 = 8.0 / (1u64 << 53) as f64;

impl LocatedPoint {
    /// Creates a point with its error bound: rounding to f32, and the roundings of the projection relative to the
    /// larger of `size` and the coordinates.
    #[inline(always)]
    fn new(p: DVec3, n: DVec3, size: f64) -> LocatedPoint {
        let projection = PROJECTION_ERROR * p.abs().max_element().max(size);
        LocatedPoint {
            p,
            n,
            error: HitErrorBound(HitErrorBound::of_exact_point(p).0 + DVec3::splat(projection)),
        }
    }

    /// Returns the point with surface coordinates and the derivatives by them.
    #[inline(always)]
    fn parametrized(self, uv: [f64; 2], [dpdu, dpdv]: [DVec3; 2]) -> ShapePoint {
        ShapePoint {
            p: self.p,
            n: self.n,
            uv,
            dpdu,
            dpdv,
            error: self.error,
        }
    }
}

/// Surface given by an implicit equation, in object space.
pub trait Implicit {
    /// Returns the bounding box of the surface; infinite for the plane.
    fn bounds(&self) -> Bounds;

    /// Returns the nearest hit with `t_near <= t <= t_far`, both ends included.
    fn intersect(&self, ray: &ShapeRay) -> Option<ShapeHit>;

    /// Reports every hit within the ray's interval, entries and exits, in ascending `t`. If a ray touches a solid, its
    /// entry and its exit have equal `t`.
    fn crossings(&self, ray: &ShapeRay, out: &mut dyn FnMut(ShapeHit));

    /// Returns the surface point of `part` at `p`, which lies near the surface.
    fn point(&self, p: DVec3, part: u32) -> ShapePoint;

    /// Returns position and normal of [`Implicit::point`], to identical bits.
    #[inline]
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        let ShapePoint { p, n, error, .. } = self.point(p, part);
        LocatedPoint { p, n, error }
    }

    /// Returns whether the surface encloses a volume; false for open surfaces.
    #[inline]
    fn is_solid(&self) -> bool {
        false
    }

    /// Returns whether a solid's volume, boundary included, contains `p`; false for open surfaces.
    #[inline]
    fn contains(&self, _p: DVec3) -> bool {
        false
    }
}

/// Any analytic shape, stored by value; large data is shared.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Sphere of any centre and radius.
    Sphere(Sphere),
    /// Unbounded plane z = 0.
    Plane,
    /// Axis-aligned cube [-1, 1]³.
    Cube,
    /// Convex polyhedron, the intersection of half-spaces.
    Polyhedron(Arc<Polyhedron>),
    /// Unit disk in the plane z = 0.
    Disk,
    /// Square [-1, 1]² in the plane z = 0.
    Quad,
    /// Cylinder around the z axis.
    Cylinder(Cylinder),
    /// Cone around the z axis.
    Cone(Cone),
    /// Torus around the z axis.
    Torus(Torus),
    /// General quadric clipped by a box.
    Quadric(Arc<Quadric>),
}

/// Evaluates `$body` with `$shape` bound to the shape that `$of` holds.
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
    fn surface(&self, p: DVec3, part: u32) -> LocatedPoint {
        forward!(self, shape => shape.surface(p, part))
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
