//! Instanced spheres under mirroring, shear, stretching, and tiny and huge scales; and singular transforms.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{DoubleDouble, Ray, SplitMix64};
use crate::shape::{Shape, Sphere};
use crate::verify::harness::test_meshes::placed;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H23",
        title: "stretched and mirrored",
        construction: "spheres under maps of condition 1 to 10^4, mirrored, sheared and turned, from 2 to 100 sizes away",
        oracle: "the map's inverse and the roots to 90 bits",
        bound: "no wrong decision, t to 1 ulp; ties are right for a sphere moved by 16 roundings of f64 times the condition squared",
        unit: "ulp of t",
        run: |trial| placed_spheres(trial, stretched),
        ..Case::SHAPES
    },
    Case {
        id: "H24",
        title: "maps without an inverse",
        construction: "maps of rank 0, 1 and 2, of condition 10^13, of NaN and infinity; and valid ones of all sizes",
        oracle: "the construction of each map",
        bound: "maps without an inverse are rejected, valid ones are accepted",
        run: |trial| Ok(trial.in_chunks(&|random, count| singular(trial, random, count))),
        ..Case::FORMULAS
    },
    Case {
        id: "H25",
        title: "parameters kept",
        construction: "spheres scaled by 10^-6 to 10^6, rays with directions 10^-6 to 10^6 long",
        oracle: "the map's inverse and the roots to 90 bits",
        bound: "no wrong decision, t to 1 ulp; ties as for H23",
        unit: "ulp of t",
        run: |trial| placed_spheres(trial, scaled),
        ..Case::SHAPES
    },
];

/// Number of transforms of a case, which share the rays equally.
const MAPS: usize = 64;
/// Displacement of the sphere that rounding may explain, in roundings of 2^-53 of the coordinates involved, times the
/// square of the condition number: the relative error of the inverse grows with it, and so do the vectors that it
/// transforms.
const MOVED: f64 = 16.0 / (1u64 << 53) as f64;

/// Returns a rotation about a random axis.
pub(in crate::verify::cases) fn turn(random: &mut SplitMix64) -> DMat3 {
    DMat3::from_quat(DQuat::from_axis_angle(
        random.direction(),
        random.within(0.0, 6.0),
    ))
}

/// Returns an affine map of condition number up to 10^4.
fn stretched(random: &mut SplitMix64) -> DAffine3 {
    let mut stretch = || 10f64.powf(random.within(-2.0, 2.0)) * random.choose(&[1.0, -1.0]);
    let diagonal = DMat3::from_diagonal(DVec3::new(stretch(), stretch(), stretch()));
    let linear = turn(random) * diagonal * turn(random);
    DAffine3 {
        matrix3: linear,
        translation: linear * random.in_cube() * random.choose(&[0.0, 1.0, 10.0]),
    }
}

fn scaled(random: &mut SplitMix64) -> DAffine3 {
    let scale = 10f64.powf(random.within(-6.0, 6.0));
    DAffine3 {
        matrix3: scale * DMat3::IDENTITY,
        translation: 10.0 * scale * random.in_cube(),
    }
}

fn placed_spheres(trial: &CaseRunner, map: fn(&mut SplitMix64) -> DAffine3) -> Result<Counts, AccelError> {
    trial.over_parts(MAPS, &|number, trial| {
        let map = map(&mut SplitMix64::new(0x3a9, number as u64));
        let Some(scene) = placed(Shape::Sphere(Sphere::UNIT), map) else {
            return Ok(Counts::default());
        };
        let engine = trial.engine(&scene)?;
        let oracle = Oracle::new(&map);
        // Aim at a point of a ball slightly larger than the sphere
        let ray = |random: &mut SplitMix64| {
            let distance = 10f64.powf(random.within(0.3, 2.0));
            let origin = map.transform_point3(distance * random.direction()).as_vec3();
            let target = map.transform_point3(1.1 * random.unit().cbrt() * random.direction());
            let length = 10f64.powf(random.within(-6.0, 6.0));
            let way = (target - origin.as_dvec3()).normalize_or_zero();
            Ray::new(origin, (length * way).as_vec3())
        };
        Ok(trial.nearest(&engine, &ray, &|ray, hit, tally| oracle.judge(ray, hit, tally)))
    })
}

type ExactPoint = [DoubleDouble; 3];

fn dot(a: ExactPoint, b: ExactPoint) -> DoubleDouble {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: ExactPoint, b: ExactPoint) -> ExactPoint {
    [0, 1, 2].map(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        a[i] * b[j] - a[j] * b[i]
    })
}

fn double_double3(v: DVec3) -> ExactPoint {
    v.to_array().map(DoubleDouble::of)
}

/// Exact intersection oracle for the unit sphere under an affine map.
pub(super) struct Oracle {
    /// Rows of the inverse of the linear part.
    inverse: [ExactPoint; 3],
    translation: ExactPoint,
    condition: f64,
}

impl Oracle {
    /// Creates the oracle of an invertible map.
    pub(in crate::verify::cases) fn new(map: &DAffine3) -> Oracle {
        // Invert the linear part by its adjugate, in double-double precision
        let [a, b, c] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(double_double3);
        let rows = [cross(b, c), cross(c, a), cross(a, b)];
        let determinant = dot(a, rows[0]);
        let norm = |m: DMat3| (m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs()).max_element();
        Oracle {
            inverse: rows.map(|row| row.map(|x| x / determinant)),
            translation: double_double3(map.translation),
            condition: norm(map.matrix3) * norm(map.matrix3.inverse()),
        }
    }

    /// Transforms a vector to object space.
    fn to_object_space(&self, v: ExactPoint) -> ExactPoint {
        self.inverse.map(|row| dot(row, v))
    }

    /// Returns both roots for the sphere of radius 1 + `delta`.
    fn roots(&self, ray: &Ray, delta: f64) -> Option<[DoubleDouble; 2]> {
        let o = double_double3(ray.origin.as_dvec3());
        // Transform the ray to object space
        let o = self.to_object_space([0, 1, 2].map(|k| o[k] - self.translation[k]));
        let d = self.to_object_space(double_double3(ray.direction.as_dvec3()));
        let radius = DoubleDouble::ONE + DoubleDouble::of(delta);
        // Solve the quadratic equation without cancellation
        let (a, b, c) = (dot(d, d), -dot(o, d), dot(o, o) - radius * radius);
        let discriminant = b * b - a * c;
        (discriminant > DoubleDouble::ZERO).then(|| {
            let root = discriminant.sqrt();
            let q = if b < DoubleDouble::ZERO {
                b - root
            } else {
                b + root
            };
            let [first, second] = [c / q, q / a];
            if first < second {
                [first, second]
            } else {
                [second, first]
            }
        })
    }

    /// Returns the entry point, if it lies ahead of the origin.
    fn ahead(roots: Option<[DoubleDouble; 2]>) -> Option<f64> {
        roots.map(|roots| roots[0].nearest()).filter(|&t| t > 0.0)
    }

    /// Returns the displacement of the sphere that rounding may explain, in object space.
    fn slack(&self, ray: &Ray) -> f64 {
        let o = double_double3(ray.origin.as_dvec3());
        let o = self.to_object_space([0, 1, 2].map(|k| o[k] - self.translation[k]));
        let place = self.to_object_space(self.translation);
        let length = |v: ExactPoint| dot(v, v).sqrt().nearest();
        MOVED * self.condition * self.condition * (1.0 + length(o) + length(place))
    }

    /// Returns the angle between the exact normal at the entry point and `n` or its opposite, and the angle that
    /// rounding explains: normals are transformed by the inverse transpose, which tilts those most that it shortens
    /// most.
    pub(in crate::verify::cases) fn tilt(&self, ray: &Ray, n: DVec3) -> Option<(f64, f64)> {
        // Find the exact hit point in object space
        let [t, _] = self.roots(ray, 0.0)?;
        let (o, d) = (
            double_double3(ray.origin.as_dvec3()),
            double_double3(ray.direction.as_dvec3()),
        );
        let along = self.to_object_space(d);
        let o = self.to_object_space([0, 1, 2].map(|k| o[k] - self.translation[k]));
        let p: ExactPoint = [0, 1, 2].map(|k| o[k] + t * along[k]);
        // Transform its normal by the inverse transpose, and compute the angle
        let column = |k: usize| [self.inverse[0][k], self.inverse[1][k], self.inverse[2][k]];
        let exact = [0, 1, 2].map(|k| dot(column(k), p));
        let length = |v: ExactPoint| dot(v, v).sqrt();
        let sine = length(cross(exact, double_double3(n))) / (length(exact) * length(double_double3(n)));
        // Bound the angle by the displacement of the hit point
        let largest = (0..3).map(|k| length(column(k)).nearest()).fold(0.0, f64::max);
        let cosine = (dot(p, along) / length(along)).nearest().abs();
        let bound = largest / length(exact).nearest() * self.slack(ray) / cosine;
        Some((sine.nearest().asin(), bound + NORMAL_ERROR))
    }

    /// Judges a result. Rays start outside, so the first root ahead is the entry point.
    pub(in crate::verify::cases) fn judge(
        &self,
        ray: &Ray,
        hit: Option<Hit>,
        tally: &mut Counts,
    ) -> Correctness {
        let expected = Oracle::ahead(self.roots(ray, 0.0));
        match (hit, expected) {
            (None, None) => return Correctness::Right,
            (Some(hit), Some(exact)) => {
                let ulp = f64::from(hit.t.next_up()) - f64::from(hit.t);
                let off = (f64::from(hit.t) - exact).abs() / ulp;
                if off <= 1.0 {
                    tally.record_error(off);
                    return Correctness::Right;
                }
            }
            _ => {}
        }
        self.judge_displaced(ray, hit)
    }

    /// Judges a result that is not exact, by spheres that are smaller and larger by what rounding explains.
    fn judge_displaced(&self, ray: &Ray, hit: Option<Hit>) -> Correctness {
        let delta = self.slack(ray);
        let [inner, outer] = [-delta, delta].map(|delta| self.roots(ray, delta));
        match hit {
            None if Oracle::ahead(inner).is_none() => Correctness::Tie,
            None => Correctness::Wrong,
            Some(hit) => {
                // Require t between the entry points of both spheres
                let ulp = f64::from(hit.t.next_up()) - f64::from(hit.t);
                let t = f64::from(hit.t);
                let Some(low) = Oracle::ahead(outer) else {
                    return Correctness::Wrong;
                };
                let last = outer.map(|roots| roots[1].nearest());
                let high = Oracle::ahead(inner).or(last).unwrap_or(low);
                let is_between = low - ulp <= t && t <= high + ulp;
                Correctness::tie_if(is_between)
            }
        }
    }
}

/// Error of a normal that is rounded to f32, in radians.
const NORMAL_ERROR: f64 = 2.0 * f32::EPSILON as f64;

/// Returns a matrix, and whether it must be rejected.
fn any_map(random: &mut SplitMix64) -> (DMat3, bool) {
    let (left, right) = (turn(random), turn(random));
    let size = 10f64.powf(random.within(-30.0, 30.0));
    let between = |random: &mut SplitMix64| random.within(0.1, 1.0);
    let (diagonal, is_bad) = match random.below(6) {
        0 => (DVec3::ZERO, true),
        1 => (DVec3::X, true),
        2 => (DVec3::new(1.0, 0.5, 0.0), true),
        3 => (DVec3::new(1.0, 1.0, 1e-13 * between(random)), true),
        4 => (
            DVec3::new(1.0, random.choose(&[f64::NAN, f64::INFINITY]), 1.0),
            true,
        ),
        // The condition number is half a million times below the limit for rejection.
        _ => (DVec3::new(1.0, between(random), 1e-6 * between(random)), false),
    };
    (size * left * DMat3::from_diagonal(diagonal) * right, is_bad)
}

fn singular(trial: &CaseRunner, random: &mut SplitMix64, count: usize) -> Counts {
    let mut tally = Counts::default();
    for _ in 0..count {
        let (matrix, is_bad) = any_map(random);
        let is_refused = !(trial.subject.formulas.is_invertible)(&DAffine3::from_mat3(matrix));
        tally.count(Correctness::wrong_if(is_bad != is_refused), || {
            format!("{matrix:?}: {}", if is_refused { "refused" } else { "taken" })
        });
    }
    tally
}
