//! The cube at its own faces, edges and corners, and along them: the slab test with zeros of either sign and directions
//! so small that their reciprocals overflow.

use glam::{DAffine3, DVec3, Vec3};

use super::meshes::scene;
use super::trial::{Answer, Tally, Trial};
use super::{Asks, Case, Closes};
use crate::accel::{AccelError, Hit};
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Shape;

const ORACLE: &str = "slabs compared as fractions, exactly; the cube is closed, so what touches it hits";

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H09",
        title: "slabs",
        construction: "directions of every pattern of 1, -1, 1/2, +0 and -0, from in, on and beside each slab of the cube",
        oracle: ORACLE,
        bound: "no wrong decision, t to 1 ulp",
        unit: "ulp of t",
        asks: Asks::Shapes,
        required: Closes::Faces,
        run: |trial| at_cube(trial, &[0.0, -0.0, 1.0, -1.0, 0.5]),
    },
    Case {
        id: "H09d",
        title: "slabs, tiny directions",
        construction: "the same with components down to the smallest float, alone and beside ordinary ones",
        oracle: ORACLE,
        bound: "no wrong decision, t to 1 ulp",
        unit: "ulp of t",
        asks: Asks::Shapes,
        required: Closes::Faces,
        run: |trial| {
            at_cube(
                trial,
                &[0.0, -0.0, 1.0, -1.0, 1e-45, -1e-45, 1e-30, -1e-30, 1e-19, 1e-17],
            )
        },
    },
];

/// In, on and beside a slab of the cube.
const PLACES: [f32; 6] = [-1.5, -1.0, -0.25, 0.5, 1.0, 3.0];

/// Centres of the cubes, along each axis: so far apart that rays start beside one only.
const CENTERS: [f64; 3] = [-8.0, 0.0, 8.0];

/// Cubes all around one, so that there is a tree to walk, all moved by `shift` along each axis.
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

/// Faces on 1 and -1, and on 0, which has no roundings beside it.
const SHIFTS: [f64; 3] = [0.0, 1.0, -1.0];

fn at_cube(trial: &Trial, components: &[f32]) -> Result<Tally, AccelError> {
    trial.over_parts(SHIFTS.len(), &|number, trial| {
        let shift = SHIFTS[number];
        let scene = cubes(shift);
        let centers: Vec<DVec3> = scene
            .instances
            .iter()
            .map(|cube| cube.world_from_object().translation)
            .collect();
        let engine = trial.engine(&scene)?;
        let ray = |random: &mut SplitMix64| {
            let mut vector =
                |from: &[f32]| Vec3::new(random.pick(from), random.pick(from), random.pick(from));
            let origin = vector(&PLACES) + shift as f32;
            let mut direction = vector(components);
            if direction == Vec3::ZERO {
                direction.z = 1.0;
            }
            Ray::new(origin, direction)
        };
        let judge = |ray: &Ray, hit, tally: &mut Tally| judge(&centers, ray, hit, tally);
        Ok(trial.nearest(&engine, &ray, &judge))
    })
}

/// A parameter as a fraction with a positive denominator: few bits each, so that products of two are exact in f64.
#[derive(Clone, Copy)]
struct Fraction(f64, f64);

impl Fraction {
    fn is_below(self, other: Fraction) -> bool {
        self.0 * other.1 < other.0 * self.1
    }
}

/// Where the ray meets one of the cubes first.
fn nearest(centers: &[DVec3], ray: &Ray) -> Option<f64> {
    let met = centers.iter().filter_map(|&center| nearest_of(center, ray));
    // What is farther than any f32 is out of reach.
    met.reduce(f64::min).filter(|&t| (t as f32) < f32::INFINITY)
}

/// Where the ray meets the cube about `center` first, exactly but for the last division.
fn nearest_of(center: DVec3, ray: &Ray) -> Option<f64> {
    let (mut enter, mut leave) = (Fraction(f64::NEG_INFINITY, 1.0), Fraction(f64::INFINITY, 1.0));
    for axis in 0..3 {
        let (o, d) = (
            f64::from(ray.origin[axis]) - center[axis],
            f64::from(ray.direction[axis]),
        );
        if d == 0.0 {
            if o.abs() > 1.0 {
                return None;
            }
            continue;
        }
        // Towards +1 along the axis or, mirrored, along its opposite.
        let (o, d) = if d > 0.0 { (o, d) } else { (-o, -d) };
        let [near, far] = [Fraction(-1.0 - o, d), Fraction(1.0 - o, d)];
        if enter.is_below(near) {
            enter = near;
        }
        if far.is_below(leave) {
            leave = far;
        }
    }
    if leave.is_below(enter) || leave.0 < 0.0 {
        return None;
    }
    let Fraction(above, below) = if enter.0 >= 0.0 { enter } else { leave };
    Some(above / below)
}

fn judge(centers: &[DVec3], ray: &Ray, hit: Option<Hit>, tally: &mut Tally) -> Answer {
    match (nearest(centers, ray), hit) {
        (None, None) => Answer::Right,
        (Some(t), Some(hit)) => {
            let nearest = t as f32;
            let ulp = f64::from(nearest.next_up()) - f64::from(nearest);
            let off = (f64::from(hit.t) - t).abs() / ulp;
            tally.note(off);
            Answer::wrong_if(!(off <= 1.0))
        }
        _ => Answer::Wrong,
    }
}
