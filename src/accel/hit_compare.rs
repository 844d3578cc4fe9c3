//! Whether two backends gave the same answer, and if not, whether either may be blamed.
//!
//! Every f32 ray is exact by definition, so each answer can be held against the exact one, computed in f64 from the
//! primitive it names. Two bounds of the f32 error, u = 2^-24, decide; lengths are relative to the ray's origin, in the
//! sheared frame of the watertight test (z along the largest direction component, in units of t):
//!
//! * of the parameter: that of pbrt-v4 for the watertight form (Pharr, Jakob, Humphreys, Physically Based Rendering,
//!   4th edition, section 6.8.8), plus that of the form with a normal, `t = n·(v0 - o) / n·d`, which Embree uses:
//!   `16 u |e1| |e2| |v0 - o| / |n·d|`. Both grow without bound as the triangle turns edge-on.
//! * of an edge function: pbrt's for the watertight form, plus that of a triple product, `16 √3 u |e| |v - o|` with the
//!   longest edge and the farthest corner; √3 bounds `|d| / |d_z|`. Where an exact edge function is closer to zero than
//!   that, hit or miss is anybody's guess.
//!
//! Where Embree places meshes itself ([`Instancing::Native`]), rays reach object space by an inverse in f32 and are off
//! by more, which [`compare_carried`] and [`compare_occlusion_carried`] allow for by the bound of [`TransformError`].
//!
//! Analytic shapes are computed in f64 by one function, so a backend that answers otherwise about one is wrong.
//!
//! Two answers are *the same* if they name the same primitive, each with its parameter in bounds. They *tie* if both
//! primitives lie within the bounds of each other, or if what only one of them found is too close to call. Else one is
//! *wrong*.

use glam::{DMat3, DVec3};

use super::brute::ray_in;
use super::shape_query::shape_hit;
use super::{Hit, Instancing};
use crate::numeric::Ray;
use crate::scene::{Geometry, Instance, Scene};

/// How two answers to the same question compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HitComparison {
    /// The same answer, up to the rounding of the parameter.
    Same,
    /// Different answers that exact arithmetic cannot prefer beyond the error bounds of f32.
    Tie,
    /// At least one answer is wrong.
    Wrong,
}

/// Half a unit in the last place of an f32 at 1.
const UNIT: f64 = 5.960_464_477_539_063e-8;
/// Roundings of a triple product in f32, with the differences it is made from: 3 for differences of 3 factors, 3 for
/// products, 5 for sums and differences; rounded up to a power of two for the reciprocal that Embree approximates.
const TRIPLE_PRODUCT: f64 = 16.0 * UNIT;

/// The bound on n roundings in a row.
const fn gamma(n: f64) -> f64 {
    n * UNIT / (1.0 - n * UNIT)
}

/// Compares two answers of [`super::Accel::intersect`] to `ray`, both by rays carried into object space in f64.
pub fn compare(scene: &Scene, ray: &Ray, a: Option<Hit>, b: Option<Hit>) -> HitComparison {
    compare_carried(scene, ray, [a, b], Instancing::Callback)
}

/// Compares two answers of [`super::Accel::intersect`] to `ray`, one of them by that kind of instancing.
pub fn compare_carried(
    scene: &Scene,
    ray: &Ray,
    [a, b]: [Option<Hit>; 2],
    instancing: Instancing,
) -> HitComparison {
    match (a, b) {
        (None, None) => HitComparison::Same,
        (Some(hit), None) | (None, Some(hit)) => match Exact::of(scene, ray, &hit, instancing) {
            Some(exact) if exact.explains(&hit) && exact.is_doubtful(ray) => HitComparison::Tie,
            _ => HitComparison::Wrong,
        },
        (Some(a), Some(b)) => compare_hits(scene, ray, [&a, &b], instancing),
    }
}

/// Compares two answers of [`super::Accel::occluded`] to `ray`.
///
/// Different answers cost a walk over the whole scene.
pub fn compare_occlusion(scene: &Scene, ray: &Ray, a: bool, b: bool) -> HitComparison {
    compare_occlusion_carried(scene, ray, [a, b], Instancing::Callback)
}

/// [`compare_occlusion`], where one of the answers is by that kind of instancing.
pub fn compare_occlusion_carried(
    scene: &Scene,
    ray: &Ray,
    [a, b]: [bool; 2],
    instancing: Instancing,
) -> HitComparison {
    if a == b {
        return HitComparison::Same;
    }
    let mut doubtful = false;
    for (index, instance) in scene.instances.iter().enumerate() {
        let count = scene.geometries[instance.geometry as usize].primitive_count();
        for primitive in 0..count as u32 {
            let exact = Exact::of_primitive(scene, ray, [index as u32, primitive], instancing);
            match exact.map(|exact| exact.decision(ray)) {
                Some(Decision::Hit) => return HitComparison::Wrong,
                Some(Decision::Doubtful) => doubtful = true,
                Some(Decision::Miss) | None => (),
            }
        }
    }
    if doubtful {
        HitComparison::Tie
    } else {
        HitComparison::Wrong
    }
}

fn compare_hits(scene: &Scene, ray: &Ray, [a, b]: [&Hit; 2], instancing: Instancing) -> HitComparison {
    let exact = |hit| Exact::of(scene, ray, hit, instancing);
    let (Some(exact_a), Some(exact_b)) = (exact(a), exact(b)) else {
        return HitComparison::Wrong;
    };
    if !exact_a.explains(a) || !exact_b.explains(b) {
        return HitComparison::Wrong;
    }
    if (a.instance, a.primitive) == (b.instance, b.primitive) {
        return HitComparison::Same;
    }
    let ties = (exact_a.t - exact_b.t).abs() <= exact_a.t_error + exact_b.t_error;
    // What only one has found may be too close to call: the other was free to go on to the next surface.
    let nearer = if exact_a.t < exact_b.t { &exact_a } else { &exact_b };
    if ties || nearer.is_doubtful(ray) {
        HitComparison::Tie
    } else {
        HitComparison::Wrong
    }
}

/// How far a ray may be from the exact one when it reaches object space, in lengths there, by the maximum norm.
///
/// Carried in f64 and rounded it is exact by definition. Embree's own instances round the map M to f32, invert it there
/// by cofactors over the determinant, and apply the inverse, all in f32. With κ = ‖M‖ ‖M⁻¹‖ by largest row sums, the
/// rounding of M moves M⁻¹ by κ u ‖M⁻¹‖, that of the cofactors, two products and a difference each, by 6 κ u ‖M⁻¹‖, as
/// ‖M‖² / |det M| is κ ‖M⁻¹‖ at most. The map of the ray adds 4 u ‖M⁻¹‖ (Higham, Accuracy and Stability of Numerical
/// Algorithms, 2nd edition, chapters 3 and 14). An error of the determinant, 8 u times the product of the columns'
/// lengths over it, scales object space.
#[derive(Clone, Copy, Debug, Default)]
struct TransformError {
    origin: f64,
    /// For each unit of t.
    direction: f64,
    /// Relative to the coordinates of what is met.
    scale: f64,
}

/// Roundings of a coefficient of M⁻¹, of its determinant's reciprocal and of the map, each in u: see [`TransformError`].
const INVERSE: f64 = 12.0;
const DETERMINANT: f64 = 10.0;

impl TransformError {
    fn new(instance: &Instance, ray: &Ray, instancing: Instancing) -> TransformError {
        if instancing != Instancing::Native || instance.is_identity() {
            return TransformError::default();
        }
        if instance.is_moving() {
            // Embree is never left to place these.
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
        }
    }

    /// How far the ray may be where it meets, at `t`, something with that largest coordinate.
    fn at(&self, t: f64, coordinate: f64) -> f64 {
        self.origin + self.direction * t.abs() + self.scale * coordinate
    }
}

/// What f64 says about one ray and one primitive, with the bounds of what f32 may say.
#[derive(Clone, Copy, Debug)]
struct Exact {
    t: f64,
    /// Bound on the error of an f32 `t`.
    t_error: f64,
    /// How far inside the line runs; negative outside.
    margin: f64,
    /// Bound on the error of an f32 margin.
    edge_error: f64,
}

/// What the exact margins say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Decision {
    Hit,
    Miss,
    Doubtful,
}

impl Exact {
    /// `None` if there is no such primitive; of a shape it is its nearest part.
    fn of(scene: &Scene, ray: &Ray, hit: &Hit, instancing: Instancing) -> Option<Exact> {
        let instance = scene.instances.get(hit.instance as usize)?;
        if let Geometry::Shape(shape) = scene.geometries.get(instance.geometry as usize)? {
            let expected = shape_hit(hit.instance, instance, shape, ray)?;
            (expected.primitive == hit.primitive).then_some(())?;
        }
        Exact::of_primitive(scene, ray, [hit.instance, hit.primitive], instancing)
    }

    /// `None` if there is no such primitive. A shape is one, whatever its part.
    fn of_primitive(
        scene: &Scene,
        ray: &Ray,
        [instance, primitive]: [u32; 2],
        instancing: Instancing,
    ) -> Option<Exact> {
        let instance = scene.instances.get(instance as usize)?;
        match scene.geometries.get(instance.geometry as usize)? {
            Geometry::Mesh(mesh) => {
                ((primitive as usize) < mesh.triangles.len()).then_some(())?;
                Some(Exact::of_triangle(
                    mesh.corners_f64(primitive),
                    &ray_in(instance, ray),
                    &TransformError::new(instance, ray, instancing),
                ))
            }
            Geometry::Shape(shape) => Some(Exact::of_shape(shape_hit(0, instance, shape, ray))),
        }
    }

    /// Every backend finds shapes by the same f64 arithmetic on the same ray: nothing but the parameter's own rounding
    /// is open.
    fn of_shape(hit: Option<Hit>) -> Exact {
        let (t, margin) = hit.map_or((f64::NAN, f64::NEG_INFINITY), |hit| (hit.t.into(), f64::INFINITY));
        Exact {
            t,
            t_error: t.abs() * gamma(1.0),
            margin,
            edge_error: 0.0,
        }
    }

    fn of_triangle(corners: [DVec3; 3], ray: &Ray, carried: &TransformError) -> Exact {
        let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let largest_corner = corners.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let [a, b, c] = corners.map(|p| p - origin);
        let (e1, e2) = (b - a, c - a);
        let n = e1.cross(e2);
        let t = n.dot(a) / n.dot(direction);
        // The sheared frame: x and y in lengths, z in units of t.
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
        let edge = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let [pa, pb, pc] = projected;
        let edges = [edge(pc, pb), edge(pa, pc), edge(pb, pa)];
        let det: f64 = edges.iter().sum();
        let margin = edges
            .iter()
            .map(|e| e * det.signum())
            .fold(f64::INFINITY, f64::min);
        let largest = |k: usize| projected.iter().map(|p| p[k].abs()).fold(0.0, f64::max);
        let [max_x, max_y, max_z] = [0, 1, 2].map(largest);
        let max_e = edges.iter().map(|e| e.abs()).fold(0.0, f64::max);
        // pbrt's bounds, with z before its scaling where it enters x and y.
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
        let longest = e1.length().max(e2.length()).max((e2 - e1).length());
        let normal_form_t = TRIPLE_PRODUCT * e1.length() * e2.length() * reach / n.dot(direction).abs();
        // The same shift of all corners: along the ray by its part across the plane, and each edge function by twice
        // the shift in the sheared frame times the edge's two sheared extents.
        let shift = carried.at(t, largest_corner);
        let carried_t = 3f64.sqrt() * shift * n.length() / n.dot(direction).abs();
        let t_error = watertight_t + normal_form_t + carried_t + gamma(2.0) * t.abs();
        Exact {
            t,
            t_error,
            margin,
            edge_error: delta_e + TRIPLE_PRODUCT * longest * reach * 3f64.sqrt() + 8.0 * shift * longest,
        }
    }

    /// Whether a backend may have reported this hit: its parameter within bounds, and not clearly outside.
    fn explains(&self, hit: &Hit) -> bool {
        // Edge-on, the exact parameter is NaN or the bound infinite, and nothing can be held against the hit.
        let off = (f64::from(hit.t) - self.t).abs();
        let is_clear = off > self.t_error || self.margin < -self.edge_error;
        !is_clear
    }

    fn decision(&self, ray: &Ray) -> Decision {
        let (from, to) = (f64::from(ray.t_near), f64::from(ray.t_far));
        let clearly = |sign: f64| {
            let margin = self.margin * sign > self.edge_error;
            let near = (self.t - from) * sign > self.t_error;
            let far = (to - self.t) * sign > self.t_error;
            [margin, near, far]
        };
        if clearly(1.0) == [true; 3] {
            Decision::Hit
        } else if clearly(-1.0) != [false; 3] {
            Decision::Miss
        } else {
            Decision::Doubtful
        }
    }

    /// Whether hit or miss is too close to call.
    fn is_doubtful(&self, ray: &Ray) -> bool {
        self.decision(ray) == Decision::Doubtful
    }
}
