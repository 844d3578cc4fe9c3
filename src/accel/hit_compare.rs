//! Comparison of the results of two backends within f32 error bounds, to find which of them may be wrong.
//!
//! Every f32 ray is exact by definition, so each result can be compared to the exact one, computed in f64 from the
//! primitive it names. Two bounds on the f32 error, u = 2^-24, decide; lengths are relative to the ray's origin, in the
//! sheared frame of the watertight test (z along the largest direction component, in units of t):
//!
//! * of the parameter: that of pbrt-v4 for the watertight form (Pharr, Jakob, Humphreys, Physically Based Rendering,
//!   4th edition, section 6.8.8), plus that of the form with a normal, `t = n·(v0 - o) / n·d`, which Embree uses:
//!   `16 u |e1| |e2| |v0 - o| / |n·d|`. Both grow without bound as the triangle turns edge-on.
//! * of an edge function: pbrt's for the watertight form, plus that of a triple product, `16 √3 u |e| |v - o|` with the
//!   longest edge and the farthest vertex; √3 bounds `|d| / |d_z|`. Where an exact edge function is closer to zero than
//!   that, both hit and miss are valid.
//!
//! Rays that Embree transforms itself ([`Instancing::Native`]) reach object space by an inverse in f32 and have a larger
//! error, which [`compare_with_instancing`] and [`compare_occlusion_with_instancing`] allow for by the bound of
//! `TransformError`.
//!
//! Groups of shadow rays compute in a frame about their common end (`RayArithmetic::Group`), so their errors are
//! relative to the distance from it: [`compare_occlusion_in_group`] allows for them.
//!
//! Analytic shapes are computed in f64 by one function, so a backend with a different result for one is wrong.
//!
//! Two results are *the same* if they name the same primitive, each with its parameter in bounds. They *tie* if both
//! primitives lie within the bounds of each other, or if a hit that only one of them reports is within the bounds of a
//! miss. Else one is *wrong*.

use glam::{DMat3, DVec3};

use super::brute::ray_in;
use super::shape_query::{point_hit, shape_hit};
use super::{Hit, Instancing};
use crate::numeric::Ray;
use crate::scene::{Geometry, Instance, Scene};

/// Outcome of comparing the results of two backends for one ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HitComparison {
    /// Equal results, up to the rounding of the parameter.
    Same,
    /// Different results that exact arithmetic cannot decide between beyond the error bounds of f32.
    Tie,
    /// At least one result is wrong.
    Wrong,
}

/// Unit roundoff u of f32: half a unit in the last place at 1.
const UNIT: f64 = 5.960_464_477_539_063e-8;
/// Error bound of a triple product in f32, including the differences that form it: 3 roundings for differences of 3
/// factors, 3 for products, 5 for sums and differences; rounded up to a power of two for the approximate reciprocal of
/// Embree.
const TRIPLE_PRODUCT: f64 = 16.0 * UNIT;

/// Returns the bound on the relative error of n roundings in a row.
const fn gamma(n: f64) -> f64 {
    n * UNIT / (1.0 - n * UNIT)
}

/// Compares two results of [`super::Accel::intersect`] for `ray`, both from rays transformed into object space in f64.
pub fn compare(scene: &Scene, ray: &Ray, a: Option<Hit>, b: Option<Hit>) -> HitComparison {
    compare_with_instancing(scene, ray, [a, b], Instancing::Callback)
}

/// Compares two results of [`super::Accel::intersect`] for `ray`, one of them computed with `instancing`.
pub fn compare_with_instancing(
    scene: &Scene,
    ray: &Ray,
    [a, b]: [Option<Hit>; 2],
    instancing: Instancing,
) -> HitComparison {
    let arithmetic = RayArithmetic::Own(instancing);
    match (a, b) {
        (None, None) => HitComparison::Same,
        (Some(hit), None) | (None, Some(hit)) => match Exact::of(scene, ray, &hit, arithmetic) {
            Some(exact) if exact.is_within_bound(&hit) && exact.is_ambiguous(ray) => HitComparison::Tie,
            _ => HitComparison::Wrong,
        },
        (Some(a), Some(b)) => compare_hits(scene, ray, [&a, &b], arithmetic),
    }
}

/// Compares two results of [`super::Accel::occluded`] for `ray`.
///
/// Different results cost a loop over the whole scene.
pub fn compare_occlusion(scene: &Scene, ray: &Ray, a: bool, b: bool) -> HitComparison {
    compare_occlusion_with_instancing(scene, ray, [a, b], Instancing::Callback)
}

/// Compares two results of [`super::Accel::occluded`] for `ray`, one of them computed with `instancing`.
pub fn compare_occlusion_with_instancing(
    scene: &Scene,
    ray: &Ray,
    blocked: [bool; 2],
    instancing: Instancing,
) -> HitComparison {
    compare_blocked(scene, ray, blocked, RayArithmetic::Own(instancing))
}

/// Compares a result of [`super::Accel::occluded_towards`] for `ray` with that of another backend. `distance` is that of
/// the ray's origin from the common end, or for a common direction from the farthest origin of the query's rays, in the
/// maximum norm.
pub fn compare_occlusion_in_group(
    scene: &Scene,
    ray: &Ray,
    blocked: [bool; 2],
    distance: f64,
) -> HitComparison {
    compare_blocked(scene, ray, blocked, RayArithmetic::Group { distance })
}

fn compare_blocked(scene: &Scene, ray: &Ray, [a, b]: [bool; 2], arithmetic: RayArithmetic) -> HitComparison {
    if a == b {
        return HitComparison::Same;
    }
    // Find a primitive that the exact ray clearly hits, or whose result is ambiguous
    let mut any_ambiguous = false;
    for (index, instance) in scene.instances.iter().enumerate() {
        let count = scene.geometries[instance.geometry as usize].primitive_count();
        for primitive in 0..count as u32 {
            let exact = Exact::of_primitive(scene, ray, [index as u32, primitive], arithmetic);
            match exact.map(|exact| exact.classify(ray)) {
                Some(Classification::Hit) => return HitComparison::Wrong,
                Some(Classification::Ambiguous) => any_ambiguous = true,
                Some(Classification::Miss) | None => (),
            }
        }
    }
    if any_ambiguous {
        HitComparison::Tie
    } else {
        HitComparison::Wrong
    }
}

fn compare_hits(scene: &Scene, ray: &Ray, [a, b]: [&Hit; 2], arithmetic: RayArithmetic) -> HitComparison {
    let exact = |hit| Exact::of(scene, ray, hit, arithmetic);
    let (Some(exact_a), Some(exact_b)) = (exact(a), exact(b)) else {
        return HitComparison::Wrong;
    };
    if !exact_a.is_within_bound(a) || !exact_b.is_within_bound(b) {
        return HitComparison::Wrong;
    }
    if (a.instance, a.primitive) == (b.instance, b.primitive) {
        return HitComparison::Same;
    }
    let ties = (exact_a.t - exact_b.t).abs() <= exact_a.t_error + exact_b.t_error;
    // A hit that only one backend reports may be ambiguous: the other backend may go on to the next surface.
    let nearer = if exact_a.t < exact_b.t { &exact_a } else { &exact_b };
    if ties || nearer.is_ambiguous(ray) {
        HitComparison::Tie
    } else {
        HitComparison::Wrong
    }
}

/// Arithmetic of a backend, on which its errors depend.
#[derive(Clone, Copy, Debug, PartialEq)]
enum RayArithmetic {
    /// Coordinates relative to the ray's own origin, in object space.
    Own(Instancing),
    /// Coordinates relative to the common end of a group's rays, or to a point amid their origins, which is at most this far
    /// from the ray's origin.
    Group { distance: f64 },
}

/// Bound on the deviation of a ray from the exact one in object space, as a length there, in the maximum norm.
///
/// A group's frame is reached by differences. With z the depth, u = 2^-24 and slopes up to 2, a vertex there has an error
/// of u · 2 z of its difference, and of u · 2 z, u · 2 z and u · 4 z of the shear; the ray's x / z has three roundings
/// and one of the centre's, u · 8 z at depth z. Both act as a shift of the vertex relative to the ray.
///
/// A ray transformed in f64 and rounded is exact by definition. Embree's own instances round the matrix M to f32,
/// invert it there by cofactors over the determinant, and apply the inverse, all in f32. With κ = ‖M‖ ‖M⁻¹‖ by largest
/// row sums, the rounding of M moves M⁻¹ by κ u ‖M⁻¹‖, that of the cofactors, two products and a difference each, by 6
/// κ u ‖M⁻¹‖, as ‖M‖² / |det M| is κ ‖M⁻¹‖ at most. The transform of the ray adds 4 u ‖M⁻¹‖ (Higham, Accuracy and
/// Stability of Numerical Algorithms, 2nd edition, chapters 3 and 14). An error of the determinant, 8 u times the
/// product of the columns' lengths over it, scales object space.
#[derive(Clone, Copy, Debug, Default)]
struct TransformError {
    origin: f64,
    /// Deviation per unit of t.
    direction: f64,
    /// Deviation relative to the coordinates of the hit primitive.
    scale: f64,
    /// Deviation relative to the distance of the hit primitive's farthest vertex from the ray's origin.
    reach: f64,
}

/// Error of a vertex relative to a ray in a group's frame, relative to the depth: see [`TransformError`].
const GROUP_FRAME: f64 = 18.0 * UNIT;

/// Roundings of a coefficient of M⁻¹, of its determinant's reciprocal and of the transform, each in u: see
/// [`TransformError`].
const INVERSE: f64 = 12.0;
const DETERMINANT: f64 = 10.0;

impl TransformError {
    fn new(instance: &Instance, ray: &Ray, arithmetic: RayArithmetic) -> TransformError {
        // Groups hold baked meshes only, and only Embree's own instances are transformed in f32
        match arithmetic {
            RayArithmetic::Group { distance } if instance.is_identity() => {
                return TransformError {
                    origin: GROUP_FRAME * distance,
                    reach: GROUP_FRAME,
                    ..TransformError::default()
                };
            }
            RayArithmetic::Own(Instancing::Native) if !instance.is_identity() => {}
            _ => return TransformError::default(),
        }
        if instance.is_moving() {
            // Embree's own instances never move, so these are transformed in f64.
            return TransformError::default();
        }
        let (map, inverse) = (instance.world_from_object(), instance.object_from_world().matrix3);
        let norm = |m: &DMat3| (m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs()).max_element();
        let size = |v: DVec3| v.abs().max_element();
        let inverse_error = INVERSE * UNIT * norm(&map.matrix3) * norm(&inverse) * norm(&inverse);
        let m = map.matrix3;
        let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
        TransformError {
            origin: inverse_error * (size(ray.origin.as_dvec3()) + size(map.translation)),
            direction: inverse_error * size(ray.direction.as_dvec3()),
            scale: DETERMINANT * UNIT * lengths / m.determinant().abs(),
            reach: 0.0,
        }
    }

    /// Returns the bound on the deviation at parameter `t`, for a primitive with this largest coordinate, in the world and
    /// relative to the ray's origin.
    fn at(&self, t: f64, coordinate: f64, reach: f64) -> f64 {
        self.origin + self.direction * t.abs() + self.scale * coordinate + self.reach * reach
    }
}

/// Intersection of one ray and one primitive in f64, with bounds on the error of an f32 result.
#[derive(Clone, Copy, Debug)]
struct Exact {
    t: f64,
    /// Bound on the error of an f32 `t`.
    t_error: f64,
    /// Smallest edge function, positive if the line passes inside the triangle and negative outside.
    margin: f64,
    /// Bound on the error of an f32 margin.
    edge_error: f64,
}

/// Classification of an exact result relative to the f32 error bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Classification {
    Hit,
    Miss,
    Ambiguous,
}

impl Exact {
    /// Evaluates the primitive of `hit`; `None` if it does not exist or is not the nearest part of its shape.
    fn of(scene: &Scene, ray: &Ray, hit: &Hit, arithmetic: RayArithmetic) -> Option<Exact> {
        let instance = scene.instances.get(hit.instance as usize)?;
        if let Geometry::Shape(shape) = scene.geometries.get(instance.geometry as usize)? {
            let expected = shape_hit(hit.instance, instance, shape, ray)?;
            (expected.primitive == hit.primitive).then_some(())?;
        }
        Exact::of_primitive(scene, ray, [hit.instance, hit.primitive], arithmetic)
    }

    /// Evaluates one primitive; `None` if it does not exist. A shape is one primitive, regardless of its part.
    fn of_primitive(
        scene: &Scene,
        ray: &Ray,
        [instance, primitive]: [u32; 2],
        arithmetic: RayArithmetic,
    ) -> Option<Exact> {
        let instance = scene.instances.get(instance as usize)?;
        match scene.geometries.get(instance.geometry as usize)? {
            Geometry::Mesh(mesh) => {
                ((primitive as usize) < mesh.triangles.len()).then_some(())?;
                Some(Exact::of_triangle(
                    mesh.corners_f64(primitive),
                    &ray_in(instance, ray),
                    &TransformError::new(instance, ray, arithmetic),
                ))
            }
            Geometry::Shape(shape) => Some(Exact::of_shape(shape_hit(0, instance, shape, ray))),
            Geometry::Points(cloud) => {
                ((primitive as usize) < cloud.len()).then_some(())?;
                Some(Exact::of_shape(point_hit(0, instance, cloud, primitive, ray)))
            }
        }
    }

    /// Evaluates a shape. Every backend uses the same f64 arithmetic on the same ray, so the bound is that of rounding
    /// the parameter once.
    fn of_shape(hit: Option<Hit>) -> Exact {
        let (t, margin) = hit.map_or((f64::NAN, f64::NEG_INFINITY), |hit| (hit.t.into(), f64::INFINITY));
        Exact {
            t,
            t_error: t.abs() * gamma(1.0),
            margin,
            edge_error: 0.0,
        }
    }

    fn of_triangle(corners: [DVec3; 3], ray: &Ray, transform_error: &TransformError) -> Exact {
        // Compute the exact parameter from the plane of the triangle
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let largest_corner = corners.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let [a, b, c] = corners.map(|p| p - origin);
        let (e1, e2) = (b - a, c - a);
        let n = e1.cross(e2);
        let t = n.dot(a) / n.dot(direction);
        // Project the vertices into the sheared frame: x and y in lengths, z in units of t
        let d = direction.to_array();
        let z = (0..3)
            .max_by(|&i, &j| d[i].abs().total_cmp(&d[j].abs()))
            .unwrap_or(2);
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let project = |p: DVec3| {
            let p = p.to_array();
            [p[x] - d[x] / d[z] * p[z], p[y] - d[y] / d[z] * p[z], p[z] / d[z]]
        };
        let projected = [a, b, c].map(project);
        // Evaluate the edge functions
        let edge = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let [pa, pb, pc] = projected;
        let edges = [edge(pc, pb), edge(pa, pc), edge(pb, pa)];
        let det: f64 = edges.iter().sum();
        let margin = edges
            .iter()
            .map(|e| e * det.signum())
            .fold(f64::INFINITY, f64::min);
        // Bound the watertight form as pbrt does, with the unscaled z where it enters x and y
        let largest = |k: usize| projected.iter().map(|p| p[k].abs()).fold(0.0, f64::max);
        let [max_x, max_y, max_z] = [0, 1, 2].map(largest);
        let max_e = edges.iter().map(|e| e.abs()).fold(0.0, f64::max);
        // `depth` is z before its scaling by the direction.
        let depth = max_z * d[z].abs();
        let reach = [a, b, c]
            .iter()
            .map(|p| p.abs().max_element())
            .fold(0.0, f64::max);
        let delta_z = gamma(3.0) * max_z;
        let delta_x = gamma(5.0) * (max_x + depth);
        let delta_y = gamma(5.0) * (max_y + depth);
        let delta_e = 2.0 * (gamma(2.0) * max_x * max_y + delta_y * max_x + delta_x * max_y);
        let watertight_t = 3.0 * (gamma(3.0) * max_e * max_z + delta_e * max_z + delta_z * max_e) / det.abs();
        // Bound the form with a normal, which Embree uses
        let longest = e1.length().max(e2.length()).max((e2 - e1).length());
        let normal_form_t = TRIPLE_PRODUCT * e1.length() * e2.length() * reach / n.dot(direction).abs();
        // Add the error of the ray transform, which acts as a shift of all vertices: along the ray by the part across
        // the plane, and each edge function by twice the shift in the sheared frame times the edge's two sheared
        // extents
        let shift = transform_error.at(t, largest_corner, reach);
        let transform_t = 3f64.sqrt() * shift * n.length() / n.dot(direction).abs();
        let t_error = watertight_t + normal_form_t + transform_t + gamma(2.0) * t.abs();
        Exact {
            t,
            t_error,
            margin,
            edge_error: delta_e + TRIPLE_PRODUCT * longest * reach * 3f64.sqrt() + 8.0 * shift * longest,
        }
    }

    /// Returns whether a backend may have reported this hit: its parameter is within bounds, and it is not clearly
    /// outside.
    fn is_within_bound(&self, hit: &Hit) -> bool {
        // Edge-on, the exact parameter is NaN or the bound infinite, and no hit can be rejected.
        let off = (f64::from(hit.t) - self.t).abs();
        let is_clear = off > self.t_error || self.margin < -self.edge_error;
        !is_clear
    }

    fn classify(&self, ray: &Ray) -> Classification {
        let (from, to) = (f64::from(ray.t_near), f64::from(ray.t_far));
        let clearly = |sign: f64| {
            let margin = self.margin * sign > self.edge_error;
            let near = (self.t - from) * sign > self.t_error;
            let far = (to - self.t) * sign > self.t_error;
            [margin, near, far]
        };
        if clearly(1.0) == [true; 3] {
            Classification::Hit
        } else if clearly(-1.0) != [false; 3] {
            Classification::Miss
        } else {
            Classification::Ambiguous
        }
    }

    /// Returns whether both hit and miss are within the error bounds.
    fn is_ambiguous(&self, ray: &Ray) -> bool {
        self.classify(ray) == Classification::Ambiguous
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::accel::native::testing::baked;
    use crate::mesh::Mesh;

    #[test]
    fn group_ties_where_a_ray_passes_an_outline_by_its_error_relative_to_the_light() {
        let mesh = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]].into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        };
        let scene = baked(mesh);
        // Aim at a light above, from a millimetre below the triangle and some way inside an edge
        let compare = |inside: f32, distance| {
            let origin = Vec3::new(1.0, inside, -0.001);
            let ray = Ray::new(origin, Vec3::Z);
            compare_occlusion_in_group(&scene, &ray, [true, false], distance)
        };
        // The error is 18 u, 1.1e-6 of the distance from the light
        assert_eq!(compare(1e-4, 0.001), HitComparison::Wrong);
        assert_eq!(compare(1e-4, 100.0), HitComparison::Tie);
        assert_eq!(compare(0.01, 100.0), HitComparison::Wrong);
        let ray = Ray::new(Vec3::new(1.0, 1e-4, -0.001), Vec3::Z);
        assert_eq!(compare_occlusion(&scene, &ray, true, false), HitComparison::Wrong);
    }
}
