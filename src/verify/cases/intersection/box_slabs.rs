//! Slab test of the cube with rays in, along and across its faces, edges and corners: zeros of either sign, and
//! directions so small that their reciprocals overflow.

use glam::{DAffine3, DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Shape;
use crate::verify::harness::test_meshes::scene;
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts};

const ORACLE: &str =
    "slabs compared exactly, as fractions; the cube is closed, so a ray that touches it hits it";

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H09",
        title: "slabs",
        construction: "directions of every pattern of 1, -1, 1/2, +0 and -0, from in, on and beside each slab of the cube",
        oracle: ORACLE,
        bound: "no wrong decision, t to 1 ulp",
        unit: "ulp of t",
        run: |trial| at_cube(trial, &[0.0, -0.0, 1.0, -1.0, 0.5]),
        ..Case::SHAPES
    },
    Case {
        id: "H09d",
        title: "slabs, tiny directions",
        construction: "the same with components down to the smallest float, alone and mixed with ordinary ones",
        oracle: ORACLE,
        bound: "no wrong decision, t to 1 ulp",
        unit: "ulp of t",
        run: |trial| {
            at_cube(
                trial,
                &[0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 1e-30, -1e-30, 1e-19, 1e-17],
            )
        },
        ..Case::SHAPES
    },
];

/// Coordinates in, on and beside a slab of the cube.
const COORDINATES: [f32; 6] = [-1.5, -1.0, -0.25, 0.5, 1.0, 3.0];

/// Centres of the cubes along each axis, so far apart that rays start beside one only.
const CENTERS: [f64; 3] = [-8.0, 0.0, 8.0];

/// Returns a scene of 27 cubes on a grid, so that the acceleration structure has several nodes, translated by `shift`
/// along each axis.
fn cubes(shift: f64) -> Scene {
    let mut scene = scene(vec![Geometry::Shape(Shape::Cube)]);
    scene.instances = (0..27)
        .filter_map(|number| {
            let center = DVec3::new(CENTERS[number % 3], CENTERS[number / 3 % 3], CENTERS[number / 9]);
            let place = DAffine3::from_translation(center + DVec3::splat(shift));
            Instance::new("", 0, 0, place).ok()
        })
        .collect();
    scene
}

/// Translations that put faces on 1 and -1, and on 0, where no rounding hides a difference.
const SHIFTS: [f64; 3] = [0.0, 1.0, -1.0];

fn at_cube(trial: &CaseRunner, components: &[f32]) -> Result<Counts, AccelError> {
    trial.over_parts(SHIFTS.len(), &|number, trial| {
        let shift = SHIFTS[number];
        let scene = cubes(shift);
        let centers: Vec<DVec3> = scene
            .instances
            .iter()
            .map(|cube| cube.world_from_object().translation)
            .collect();
        let engine = trial.engine(&scene)?;
        // Draw origin and direction from the lists of coordinates
        let ray = |random: &mut SplitMix64| {
            let mut vector =
                |from: &[f32]| Vec3::new(random.choose(from), random.choose(from), random.choose(from));
            let origin = vector(&COORDINATES) + shift as f32;
            let mut direction = vector(components);
            if direction == Vec3::ZERO {
                direction.z = 1.0;
            }
            Ray::new(origin, direction)
        };
        // Compare with the exact slab test of all cubes
        let judge = |ray: &Ray, hit, tally: &mut Counts| judge(&centers, ray, hit, tally);
        Ok(trial.nearest(&engine, &ray, &judge))
    })
}

/// Parameter as a fraction with a positive denominator; both have so few bits that products of two are exact in f64.
#[derive(Clone, Copy)]
struct Fraction(f64, f64);

impl Fraction {
    fn is_below(self, other: Fraction) -> bool {
        self.0 * other.1 < other.0 * self.1
    }
}

/// Returns the parameter of the nearest hit on any of the cubes.
fn nearest(centers: &[DVec3], ray: &Ray) -> Option<f64> {
    let hits = centers.iter().filter_map(|&center| nearest_of(center, ray));
    // A parameter beyond the largest f32 counts as a miss.
    hits.reduce(f64::min).filter(|&t| (t as f32) < f32::INFINITY)
}

/// Returns the parameter of the nearest hit on the cube about `center`, exact but for the final division.
fn nearest_of(center: DVec3, ray: &Ray) -> Option<f64> {
    let (mut enter, mut exit) = (Fraction(f64::NEG_INFINITY, 1.0), Fraction(f64::INFINITY, 1.0));
    for axis in 0..3 {
        let (o, d) = (
            f64::from(ray.origin[axis]) - center[axis],
            f64::from(ray.direction[axis]),
        );
        // A ray parallel to the slab hits only from inside it
        if d == 0.0 {
            if o.abs() > 1.0 {
                return None;
            }
            continue;
        }
        // Mirror the axis, so that the direction is positive
        let (o, d) = if d > 0.0 { (o, d) } else { (-o, -d) };
        // Clip the interval to the slab
        let [near, far] = [Fraction(-1.0 - o, d), Fraction(1.0 - o, d)];
        if enter.is_below(near) {
            enter = near;
        }
        if far.is_below(exit) {
            exit = far;
        }
    }
    // Return the entry point, or the exit point if the origin is inside
    if exit.is_below(enter) || exit.0 < 0.0 {
        return None;
    }
    let Fraction(above, below) = if enter.0 >= 0.0 { enter } else { exit };
    Some(above / below)
}

fn judge(centers: &[DVec3], ray: &Ray, hit: Option<Hit>, tally: &mut Counts) -> Correctness {
    match (nearest(centers, ray), hit) {
        (None, None) => Correctness::Right,
        (Some(t), Some(hit)) => {
            let nearest = t as f32;
            let ulp = f64::from(nearest.next_up()) - f64::from(nearest);
            let off = (f64::from(hit.t) - t).abs() / ulp;
            tally.record_error(off);
            Correctness::wrong_if(!(off <= 1.0))
        }
        _ => Correctness::Wrong,
    }
}
