//! Analytic shapes of the reference tracer: faces, each with its equation and bounds, and surface coordinates.
//!
//! A face is a part of a plane n · x = h or of a quadric xᵀ Q x = 0 within half-spaces, or within the unit disk; or a
//! whole torus.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DVec3};
use whit::shape::{Implicit, Shape};

use super::approx::{Approx, Approx3, ROUNDING};
use super::hits::{Left, Ray};
use super::torus;

/// Implicit equation of a surface.
pub enum Equation {
    /// Plane with n · x = h.
    Plane(DVec3, f64),
    /// Quadric xᵀ Q x = 0 with x = (x, y, z, 1), by the upper triangle row by row.
    Quadric([f64; 10]),
    /// Sphere |x - c| = r, whose roots [`super::hits`] finds.
    Sphere(DVec3, f64),
    /// Torus around z whose tube has this radius.
    Torus(f64),
}

/// Bound of a face on its surface.
enum Limit {
    /// Half-space with n · x <= h.
    HalfSpace(DVec3, f64),
    /// Unit disk x² + y² <= 1.
    Round,
}

/// Part of a shape's surface.
pub struct Face {
    pub equation: Equation,
    limits: Vec<Limit>,
}

/// Surface coordinates and the point's derivatives by them.
#[derive(Clone, Copy)]
pub struct Chart {
    pub uv: [Approx; 2],
    pub derivatives: [Approx3; 2],
}

impl Chart {
    /// Chart of a surface without coordinates.
    pub const NONE: Chart = Chart {
        uv: [Approx::ZERO; 2],
        derivatives: [Approx3::ZERO; 2],
    };

    /// Returns whether there are no coordinates.
    pub fn is_empty(&self) -> bool {
        self.derivatives.iter().all(|d| d.value() == DVec3::ZERO)
    }
}

fn slab(axis: usize, low: f64, high: f64) -> [Limit; 2] {
    let n = DVec3::AXES[axis];
    [Limit::HalfSpace(n, high), Limit::HalfSpace(-n, -low)]
}

fn flat(n: DVec3, h: f64, limits: impl IntoIterator<Item = Limit>) -> Face {
    Face {
        equation: Equation::Plane(n, h),
        limits: limits.into_iter().collect(),
    }
}

fn curved(q: [f64; 10], limits: impl IntoIterator<Item = Limit>) -> Face {
    Face {
        equation: Equation::Quadric(q),
        limits: limits.into_iter().collect(),
    }
}

fn whole(equation: Equation) -> Face {
    Face {
        equation,
        limits: Vec::new(),
    }
}

/// Returns the faces of a convex solid that is the intersection of these half-spaces.
fn facets(half_spaces: &[(DVec3, f64)]) -> Vec<Face> {
    let face = |i: usize| {
        let others = half_spaces.iter().enumerate().filter(|&(j, _)| j != i);
        flat(
            half_spaces[i].0,
            half_spaces[i].1,
            others.map(|(_, &(n, h))| Limit::HalfSpace(n, h)),
        )
    };
    (0..half_spaces.len()).map(face).collect()
}

/// Returns the faces of a shape, by their part numbers.
pub fn faces(shape: &Shape) -> Vec<Face> {
    let z = DVec3::Z;
    match shape {
        Shape::Sphere(sphere) => vec![whole(Equation::Sphere(sphere.center, sphere.radius))],
        Shape::Torus(torus) => vec![whole(Equation::Torus(torus.minor_radius))],
        Shape::Plane => vec![flat(z, 0.0, [])],
        Shape::Disk => vec![flat(z, 0.0, [Limit::Round])],
        Shape::Quad => vec![flat(
            z,
            0.0,
            slab(0, -1.0, 1.0).into_iter().chain(slab(1, -1.0, 1.0)),
        )],
        Shape::Cube => {
            let sides = DVec3::AXES.map(|axis| [(-axis, 1.0), (axis, 1.0)]);
            facets(sides.as_flattened())
        }
        Shape::Polyhedron(solid) => {
            let half_spaces: Vec<_> = solid.half_spaces().iter().map(|s| (s.n, s.h)).collect();
            facets(&half_spaces)
        }
        Shape::Cylinder(cylinder) => {
            let wall = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0];
            let mut faces = vec![curved(wall, slab(2, -1.0, 1.0))];
            if cylinder.capped {
                faces.extend([flat(z, 1.0, [Limit::Round]), flat(-z, 1.0, [Limit::Round])]);
            }
            faces
        }
        // The wall satisfies x² + y² = (1 - z)² / 4.
        Shape::Cone(cone) => {
            let wall = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.25, 0.25, -0.25];
            let mut faces = vec![curved(wall, slab(2, -1.0, 1.0))];
            if cone.capped {
                faces.push(flat(-z, 1.0, [Limit::Round]));
            }
            faces
        }
        Shape::Quadric(quadric) => {
            // A quadric is clipped to its box.
            let clip = quadric.bounds();
            let limits = (0..3).flat_map(|axis| slab(axis, clip.min[axis], clip.max[axis]));
            vec![curved(quadric.coefficients(), limits)]
        }
    }
}

/// Returns a bounding sphere of the shape, in object space.
pub fn ball(shape: &Shape) -> (DVec3, f64) {
    match shape {
        Shape::Sphere(sphere) => (sphere.center, sphere.radius),
        Shape::Torus(torus) => (DVec3::ZERO, 1.0 + torus.minor_radius),
        Shape::Disk | Shape::Quad | Shape::Cube | Shape::Cylinder(_) | Shape::Cone(_) => {
            (DVec3::ZERO, 3f64.sqrt())
        }
        _ => (DVec3::ZERO, f64::INFINITY),
    }
}

/// Returns whether a solid contains `p`; surfaces without a volume contain nothing.
pub fn contains(shape: &Shape, p: DVec3) -> bool {
    let is_solid = match shape {
        Shape::Sphere(_) | Shape::Cube | Shape::Polyhedron(_) | Shape::Torus(_) => true,
        Shape::Cylinder(cylinder) => cylinder.capped,
        Shape::Cone(cone) => cone.capped,
        _ => false,
    };
    let behind = |face: &Face| face.equation.at(p) < 0.0;
    is_solid && faces(shape).iter().all(behind)
}

/// Returns aᵀ Q b of two homogeneous vectors.
fn form(q: &[f64; 10], (a, wa): (Approx3, f64), (b, wb): (Approx3, f64)) -> Approx {
    let (a, b) = (
        [a.x, a.y, a.z, Approx::exact(wa)],
        [b.x, b.y, b.z, Approx::exact(wb)],
    );
    let mut sum = Approx::ZERO;
    let mut next = q.iter();
    for i in 0..4 {
        for j in i..4 {
            let q = Approx::exact(*next.next().unwrap());
            if q.value != 0.0 {
                let both = if i == j {
                    a[i] * b[i]
                } else {
                    a[i] * b[j] + a[j] * b[i]
                };
                sum = sum + q * both;
            }
        }
    }
    sum
}

impl Face {
    /// Returns the largest number of intersections with a line.
    pub fn root_count(&self) -> u32 {
        match self.equation {
            Equation::Plane(..) | Equation::Sphere(..) => 1,
            Equation::Quadric(_) => 2,
            Equation::Torus(_) => 4,
        }
    }

    /// Returns the `root`-th intersection of a ray in object space with the face, and its slack.
    pub fn crossing(&self, ray: &Ray, root: u32, leaves: Option<Left>) -> Option<(Approx, f64)> {
        let (t, slack) = match &self.equation {
            Equation::Plane(..) if leaves.is_some() => return None,
            Equation::Plane(n, h) => {
                let n = Approx3::exact(*n);
                let t = (Approx::exact(*h) - n.dot(ray.origin)) / n.dot(ray.direction);
                (t, f64::INFINITY)
            }
            Equation::Quadric(q) => quadric_root(q, ray, root, leaves)?,
            Equation::Sphere(..) => return None,
            Equation::Torus(r) => torus::crossing(*r, ray, root, leaves)?,
        };
        let p = ray.origin + ray.direction * t;
        let within = self.limits.iter().map(|limit| match limit {
            Limit::HalfSpace(n, h) => (Approx::exact(*h) - Approx3::exact(*n).dot(p)).slack(),
            Limit::Round => (1.0 - (p.x.squared() + p.y.squared())).slack(),
        });
        Some((t, within.fold(slack, f64::min)))
    }

    /// Returns the normal at `p`, of any length, on the positive side.
    pub fn outward(&self, p: Approx3) -> Approx3 {
        match &self.equation {
            Equation::Plane(n, _) => Approx3::exact(*n),
            Equation::Sphere(center, _) => p - Approx3::exact(*center),
            // The normal points away from the nearest point of the circle.
            Equation::Torus(_) => {
                let rho = (p.x.squared() + p.y.squared()).sqrt();
                Approx3::from([p.x - p.x / rho, p.y - p.y / rho, p.z])
            }
            Equation::Quadric(q) => {
                let along = |axis: DVec3| form(q, (Approx3::exact(axis), 0.0), (p, 1.0));
                Approx3::from(DVec3::AXES.map(along))
            }
        }
    }

    /// Returns the point of the face near `t` of a ray in world space, in object space. Programs find it in f64 from
    /// the ray that they store, so that the only error is the ray's own, which is propagated by differences.
    pub fn point(&self, object_from_world: &DAffine3, ray: &Ray, t: f64) -> Approx3 {
        // Solve for the point in object space
        let (o, d) = (ray.origin, ray.direction);
        let at = |o: DVec3, d: DVec3| {
            let o = object_from_world.transform_point3(o);
            self.equation
                .nearest(o, object_from_world.transform_vector3(d), t)
        };
        let p = at(o.value(), d.value());
        // Propagate the ray's errors by differences
        let mut error = DVec3::splat(F64_ROUNDINGS * (p.length() + t * d.value().length()));
        for axis in DVec3::AXES {
            for side in [-1.0, 1.0] {
                let moved = at(o.value() + side * axis * o.error(), d.value());
                let turned = at(o.value(), d.value() + side * axis * d.error());
                error += (moved - p).abs() + (turned - p).abs();
            }
        }
        // Fall back to the ray's point if Newton's method diverged
        let p = if p.is_finite() {
            p
        } else {
            object_from_world.transform_point3(o.value() + t * d.value())
        };
        let error = if error.is_finite() {
            error
        } else {
            DVec3::splat(UNKNOWN)
        };
        // Project to the plane, which has no error along its axis
        let p = self.projected(Approx3::exact(p));
        let exactly = |axis: usize| self.is_across(axis);
        let error = [0, 1, 2].map(|axis| if exactly(axis) { 0.0 } else { error[axis] });
        p.widened(DVec3::from_array(error))
    }

    /// Returns whether all points of the face have one coordinate along this axis.
    fn is_across(&self, axis: usize) -> bool {
        matches!(self.equation, Equation::Plane(n, _) if n[axis].abs() == 1.0)
    }

    /// Returns `p` projected to the face along axes in which the face is exact.
    fn projected(&self, p: Approx3) -> Approx3 {
        let Equation::Plane(n, h) = self.equation else {
            return p;
        };
        let mut p = p.to_array();
        for axis in (0..3).filter(|&axis| self.is_across(axis)) {
            p[axis] = Approx::exact(n[axis] * h);
        }
        Approx3::from(p)
    }
}

/// Error bound of an unpredictable value, finite for arithmetic.
const UNKNOWN: f64 = 1e30;

/// Error of a root in f64, with the map to object space, relative to the ray's length; rounded up.
const F64_ROUNDINGS: f64 = 1e-13;

impl Equation {
    /// Evaluates the equation: zero on the surface, negative behind it.
    fn at(&self, p: DVec3) -> f64 {
        match self {
            Equation::Plane(n, h) => n.dot(p) - h,
            Equation::Quadric(q) => form(q, (Approx3::exact(p), 1.0), (Approx3::exact(p), 1.0)).value,
            Equation::Sphere(center, radius) => (p - center).length_squared() - radius * radius,
            Equation::Torus(r) => torus::distance(p, *r),
        }
    }

    /// Returns the point of the line near `t` that is on the surface, by Newton's method.
    fn nearest(&self, o: DVec3, d: DVec3, mut t: f64) -> DVec3 {
        /// Number of Newton steps; each doubles the digits of an f32.
        const STEPS: usize = 4;
        for _ in 0..STEPS {
            let (p, h) = (o + t * d, 1e-4 / d.length());
            // Exact for planes and quadrics, and nearly so for tori.
            let slope = (self.at(p + h * d) - self.at(p - h * d)) / (2.0 * h);
            t -= self.at(p) / slope;
        }
        o + t * d
    }
}

/// Returns the smaller or the larger root of F(o + t d) = 0, about the extremum of F along the line.
fn quadric_root(q: &[f64; 10], ray: &Ray, root: u32, leaves: Option<Left>) -> Option<(Approx, f64)> {
    let (o, d) = (ray.origin, ray.direction);
    let a = form(q, (d, 0.0), (d, 0.0));
    let middle = -(form(q, (o, 1.0), (d, 0.0)) / a);
    let aside = o + d * middle;
    // Near the extremum F = f + a (t - middle)².
    let square = -(form(q, (aside, 1.0), (aside, 1.0)) / a);
    let half = square.sqrt();
    let is_later = root == 1;
    match leaves {
        // F(o) = 0: the other root is twice as far as the middle.
        Some(Left { is_passed: false, .. }) => {
            return is_later.then_some((middle + middle, f64::INFINITY));
        }
        Some(_) => {
            // The root that was passed is the one nearer to the ray's origin.
            let was_first = ray.t_near.value < middle.value;
            return (is_later && was_first).then_some((middle + half, f64::INFINITY));
        }
        None => {}
    }
    let t = if is_later { middle + half } else { middle - half };
    Some((t, square.slack()))
}

/// Returns the angle from +x towards +y as a fraction of a full turn.
fn turn(y: Approx, x: Approx) -> Approx {
    let angle = y.atan2(x) / Approx::rounded(TAU);
    if angle.value < 0.0 {
        angle + Approx::ONE
    } else {
        angle
    }
}

/// Returns coordinates in the square [-1, 1]² with these axes.
fn square_chart(p: Approx3, right: DVec3, up: DVec3) -> Chart {
    let part = |axis: DVec3| (Approx3::exact(axis).dot(p) + Approx::ONE) * 0.5;
    Chart {
        uv: [part(right), part(up)],
        derivatives: [right, up].map(|axis| Approx3::exact(2.0 * axis)),
    }
}

/// Returns the derivative of a rotation around the z axis: 2π (-y, x, 0).
fn around(p: Approx3) -> Approx3 {
    let turned = Approx3::from([-p.y, p.x, Approx::ZERO]);
    turned * Approx::rounded(TAU)
}

/// Returns the coordinates that `shape` documents for a point of a part, in object space.
pub fn chart(shape: &Shape, part: u32, p: Approx3) -> Chart {
    let rho = (p.x.squared() + p.y.squared()).sqrt();
    match (shape, part) {
        (Shape::Plane, _) => Chart {
            uv: [p.x, p.y],
            derivatives: [DVec3::X, DVec3::Y].map(Approx3::exact),
        },
        (Shape::Disk | Shape::Quad, _) | (Shape::Cylinder(_), 1) => square_chart(p, DVec3::X, DVec3::Y),
        (Shape::Cylinder(_), 2) | (Shape::Cone(_), 1) => square_chart(p, -DVec3::X, DVec3::Y),
        (Shape::Cube, _) => {
            let axis = part as usize / 2;
            let side = if part.is_multiple_of(2) { -1.0 } else { 1.0 };
            square_chart(p, side * DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3])
        }
        (Shape::Cylinder(_), _) => Chart {
            uv: [turn(p.y, p.x), (p.z + Approx::ONE) * 0.5],
            derivatives: [around(p), Approx3::exact(2.0 * DVec3::Z)],
        },
        // v increases along the wall: from the radius 1 to 0 while z goes from -1 to 1.
        (Shape::Cone(_), _) => Chart {
            uv: [turn(p.y, p.x), (p.z + Approx::ONE) * 0.5],
            derivatives: [
                around(p),
                Approx3::from([-(p.x / rho), -(p.y / rho), Approx::exact(2.0)]),
            ],
        },
        (Shape::Sphere(sphere), _) => {
            let f = p - Approx3::exact(sphere.center);
            let rho = (f.x.squared() + f.y.squared()).sqrt();
            let up = Approx3::from([-(f.z * (f.x / rho)), -(f.z * (f.y / rho)), rho]);
            Chart {
                uv: [turn(f.y, f.x), rho.atan2(-f.z) / Approx::rounded(PI)],
                derivatives: [around(f), up * Approx::rounded(PI)],
            }
        }
        (Shape::Torus(_), _) => {
            let out = rho - Approx::ONE;
            let up = Approx3::from([-(p.z * (p.x / rho)), -(p.z * (p.y / rho)), out]);
            Chart {
                uv: [turn(p.y, p.x), turn(p.z, out)],
                derivatives: [around(p), up * Approx::rounded(TAU)],
            }
        }
        (Shape::Polyhedron(solid), _) => {
            let axes = tangents(solid.half_spaces()[part as usize].n);
            Chart {
                uv: axes.map(|axis| Approx3::rounded(axis).dot(p)),
                derivatives: axes.map(Approx3::rounded),
            }
        }
        _ => Chart::NONE,
    }
}

/// Returns tangents by Duff et al., JCGT 6(1), 2017: x̂ and ŷ by the shortest rotation from ±ẑ to `n`, not normalised.
fn tangents(n: DVec3) -> [DVec3; 2] {
    let sign = 1f64.copysign(n.z);
    let w = 1.0 / (1.0 + n.z.abs());
    [
        DVec3::new(1.0 - n.x * n.x * w, -n.x * n.y * w, -sign * n.x),
        DVec3::new(-n.x * n.y * w * sign, sign * (1.0 - n.y * n.y * w), -n.y),
    ]
}

/// Returns the largest offset, in object space, by which a program may move a spawned ray off the surface at `p`.
pub fn step(p: Approx3) -> f64 {
    8.0 * ROUNDING * p.value().abs().max_element().max(1.0)
}
