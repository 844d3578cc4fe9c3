//! Sphere intersection where the quadratic equation cancels: distant and huge spheres, tangents, and rays from inside.

use std::cmp::Ordering;
use std::ops::RangeInclusive;

use glam::{DAffine3, DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{DoubleDouble, Ray, SplitMix64};
use crate::scene::Camera;
use crate::shape::oracle::{DoubleDouble3, dot, double_double3};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::expansion;
use crate::verify::harness::test_meshes::among_others;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

/// Values that all cases of spheres share.
const SPHERE: Case = Case {
    oracle: "exact sign of the discriminant, roots to 100 bits",
    unit: "ulp of t",
    ..Case::SHAPES
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H01",
        title: "distant sphere",
        construction: "the unit sphere from 10 to 10^3 radii away, aimed within 1.05 radii of its centre",
        bound: "no wrong decision, t to 1 ulp of f32; ties are right for a sphere moved by 16 roundings of f64",
        run: |trial| distant(trial, 1..=3),
        ..SPHERE
    },
    Case {
        id: "H01f",
        title: "very distant sphere",
        construction: "the same from 10^4 to 10^7 radii away, as far as a camera of the scene stands",
        bound: "as for H01",
        run: |trial| distant(trial, 4..=7),
        ..SPHERE
    },
    Case {
        id: "H02",
        title: "huge sphere",
        construction: "spheres of radius 10^3 to 10^8 as ground, seen downward from 0.001 to 1 above",
        bound: "no wrong decision, t to 1 ulp of f32; ties are right for a sphere moved by 16 roundings of f64",
        run: huge,
        ..SPHERE
    },
    Case {
        id: "H03",
        title: "tangents",
        construction: "lines that pass the unit sphere's centre at 1 ± k/2^24 radii, k to 64, exactly and turned at random",
        bound: "no wrong decision",
        run: tangents,
        ..SPHERE
    },
    Case {
        id: "H04",
        title: "from inside",
        construction: "rays from the centre, from inside and from rounded points on the sphere",
        bound: "no wrong root, t to 1 ulp of f32; ties as for H01",
        run: from_inside,
        ..SPHERE
    },
];

/// Distance by which rounding may seem to move the sphere, in roundings of 2^-53 relative to the coordinates involved:
/// a result that is exact for such a moved sphere is a tie.
const MOVED: f64 = 16.0 / (1u64 << 53) as f64;

/// Exact result for a ray and a sphere, with the deviations that rounding explains.
struct ExactRoots {
    /// Nearest root that is not behind the origin.
    t: Option<f64>,
    /// Both roots, rounded to f64; without real roots, the parameter of the closest approach twice.
    roots: [f64; 2],
    /// Admissible error of each root.
    slack: f64,
    /// Flag for a line so close to tangent that it may as well miss.
    is_tangent: bool,
}

impl ExactRoots {
    fn new(sphere: &Sphere, ray: &Ray) -> ExactRoots {
        // Compute the coefficients of a t² - 2 b t + c in 106 bits
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let f = [0, 1, 2].map(|k| DoubleDouble::of(o[k]) - DoubleDouble::of(sphere.center[k]));
        let direction = double_double3(d);
        let square = DoubleDouble::of(sphere.radius) * DoubleDouble::of(sphere.radius);
        let a = dot(direction, direction);
        let b = -dot(f, direction);
        let c = dot(f, f) - square;
        let (discriminant, sign) = discriminant(sphere, (o, d), f, a * square);
        // Bound the error of the roots for a sphere that rounding has moved
        let delta = MOVED * (o.length() + sphere.center.length() + sphere.radius);
        let length = a.nearest().sqrt();
        let half_chord = discriminant.nearest().abs().sqrt() / length;
        // With r² - h² for a line outside, h is imaginary: the distance from the sphere is h² / 2r.
        let is_tangent = half_chord * half_chord <= 2.0 * sphere.radius * delta;
        let slack = delta * sphere.radius / half_chord.max((sphere.radius * delta).sqrt()) / length;
        if sign == Ordering::Less {
            let nearest = b.nearest() / a.nearest();
            return ExactRoots {
                t: None,
                roots: [nearest; 2],
                slack: slack + half_chord / length,
                is_tangent,
            };
        }
        // Solve without cancellation: the root of larger magnitude first
        let root = discriminant.sqrt();
        let q = if b < DoubleDouble::ZERO {
            b - root
        } else {
            b + root
        };
        let mut roots = [(c / q).nearest(), (q / a).nearest()];
        roots.sort_by(f64::total_cmp);
        ExactRoots {
            t: roots.into_iter().find(|&t| t >= 0.0),
            roots,
            slack,
            is_tangent,
        }
    }

    /// Returns the error of `t` against the root at `expansion`, in ulps of f32.
    fn ulps(&self, t: f32, exact: f64) -> f64 {
        (f64::from(t) - exact).abs() / ulp(exact)
    }

    /// Returns whether `t` is the root at `expansion` of a sphere that rounding has moved.
    fn explains(&self, t: f32, exact: f64) -> bool {
        (f64::from(t) - exact).abs() <= self.slack + ulp(exact)
    }

    /// Judges a result and records its error.
    fn judge(&self, hit: Option<Hit>, tally: &mut Counts) -> Correctness {
        match (hit, self.t) {
            (None, None) => Correctness::Right,
            (None, Some(_)) => Correctness::tie_if(self.is_tangent || self.roots[1] <= self.slack),
            (Some(hit), Some(t)) if self.explains(hit.t, t) => {
                let off = self.ulps(hit.t, t);
                tally.record_error(off);
                if off <= 1.0 {
                    Correctness::Right
                } else {
                    Correctness::Tie
                }
            }
            (Some(hit), expected) => {
                let [first, second] = self.roots;
                let explains_hit = |root: f64| root >= -self.slack && self.explains(hit.t, root);
                // A root that is indistinguishable from the origin may count or not.
                let is_open = match expected {
                    None => self.is_tangent || second.abs() <= self.slack,
                    Some(_) => first.abs() <= self.slack,
                };
                Correctness::tie_if(is_open && (explains_hit(first) || explains_hit(second)))
            }
        }
    }
}

/// Error of a discriminant of 106 bits, as a share of its terms: 12 roundings of 2^-104 and a few to spare.
const DISCRIMINANT_ERROR: f64 = 32.0 / (1u64 << 52) as f64 / (1u64 << 52) as f64;

/// Returns `a r² - |f x d|²` and its exact sign. `f` is the line's origin `o` relative to the centre.
fn discriminant(
    sphere: &Sphere,
    (o, d): (DVec3, DVec3),
    f: DoubleDouble3,
    chord: DoubleDouble,
) -> (DoubleDouble, Ordering) {
    // Compute the discriminant from the moment of the line, to 106 bits
    let direction = double_double3(d);
    let moment = [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        f[i] * direction[j] - f[j] * direction[i]
    });
    let found = chord - dot(moment, moment);
    // The terms of the cross product may be larger than the moment itself.
    let size = chord.nearest() + dot(f, f).nearest() * d.length_squared();
    if found.nearest().abs() > DISCRIMINANT_ERROR * size {
        return (found, found.nearest().total_cmp(&0.0));
    }
    // Fall back to exact arithmetic
    let exact = expansion::discriminant(o, d, sphere.center, sphere.radius);
    (exact.to_double_double(), exact.sign())
}

/// Returns the distance from the f32 nearest to `x` to the next one.
fn ulp(x: f64) -> f64 {
    let nearest = (x as f32).abs();
    f64::from(nearest.next_up()) - f64::from(nearest)
}

/// Traces rays at one sphere among other geometries.
fn at_sphere(
    trial: &CaseRunner,
    sphere: Sphere,
    ray: impl Fn(&mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    at_sphere_from(trial, sphere, 0.0, ray)
}

/// Traces rays at one sphere, in a scene with a camera `farthest` units away; without a camera if that is 0.
fn at_sphere_from(
    trial: &CaseRunner,
    sphere: Sphere,
    farthest: f64,
    ray: impl Fn(&mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    let mut scene = among_others(Shape::Sphere(sphere), sphere.center, sphere.radius);
    if farthest > 0.0 {
        scene.cameras = vec![Camera {
            world_from_camera: DAffine3::from_translation(farthest * DVec3::Z),
            ..Camera::default()
        }];
    }
    let engine = trial.engine(&scene)?;
    Ok(trial.nearest(&engine, &ray, &|ray, hit, tally| {
        // One of the other geometries may occlude the sphere.
        if hit.is_some_and(|hit| hit.instance != 0) {
            return Correctness::Right;
        }
        ExactRoots::new(&sphere, ray).judge(hit, tally)
    }))
}

/// Traces rays from distances of powers of ten of the radius.
fn distant(trial: &CaseRunner, powers: RangeInclusive<i32>) -> Result<Counts, AccelError> {
    let distances: Vec<f64> = powers.map(|power| 10f64.powi(power)).collect();
    let farthest = distances.iter().copied().fold(0.0, f64::max);
    at_sphere_from(trial, Sphere::UNIT, farthest, |random| {
        let distance = random.choose(&distances);
        let origin = (distance * random.direction()).as_vec3();
        // Aim at a point of a ball a little larger than the sphere
        let target = 1.05 * random.unit().cbrt() * random.direction();
        Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    })
}

fn huge(trial: &CaseRunner) -> Result<Counts, AccelError> {
    const MIN_EXPONENT: i32 = 3;
    const COUNT: usize = 6;
    trial.over_parts(COUNT, &|number, trial| {
        let radius = 10f64.powi(MIN_EXPONENT + number as i32);
        let sphere = Sphere {
            center: DVec3::new(0.0, -radius, 0.0),
            radius,
        };
        at_sphere(&trial, sphere, |random| {
            let height = 10f64.powf(random.within(-3.0, 0.0));
            let down = random.direction();
            let direction = DVec3::new(down.x, -down.y.abs(), down.z);
            Ray::new(Vec3::new(0.0, height as f32, 0.0), direction.as_vec3())
        })
    })
}

fn tangents(trial: &CaseRunner) -> Result<Counts, AccelError> {
    at_sphere(trial, Sphere::UNIT, |random| {
        let offset = 1.0 + (random.below(129) as f64 - 64.0) * 0.5f64.powi(24);
        let distance = random.choose(&[2.0, 5.0, 100.0]);
        if random.below(2) == 0 {
            // Choose a line along an axis, so that the offset is exact where f32 can represent it
            let axis = random.below(3);
            let sign = random.choose(&[1.0, -1.0]);
            let mut origin = Vec3::ZERO;
            origin[axis] = -(sign * distance) as f32;
            origin[(axis + 1) % 3] = random.choose(&[1.0, -1.0]) * offset as f32;
            return Ray::new(origin, sign as f32 * Vec3::AXES[axis]);
        }
        // Choose a tangent of random direction
        let direction = random.direction();
        let beside = direction.cross(random.direction()).normalize_or_zero();
        let origin = offset * beside - distance * direction;
        Ray::new(origin.as_vec3(), direction.as_vec3())
    })
}

fn from_inside(trial: &CaseRunner) -> Result<Counts, AccelError> {
    at_sphere(trial, Sphere::UNIT, |random| {
        let origin = match random.below(4) {
            0 => DVec3::ZERO,
            1 => random.unit() * random.direction(),
            2 => DVec3::AXES[random.below(3)] * random.choose(&[1.0, -1.0]),
            _ => random.direction(),
        };
        let direction = random.direction() * 10f64.powi(random.below(7) as i32 - 3);
        Ray::new(origin.as_vec3(), direction.as_vec3())
    })
}
