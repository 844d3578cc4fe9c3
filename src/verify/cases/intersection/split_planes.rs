//! Split planes of a spatial tree: walls on integer coordinates, with rays in the split planes and through the lines
//! and points where they intersect.

use glam::{DVec3, Vec3};

use crate::accel::AccelError;
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::Geometry;
use crate::verify::harness::reference::Reference;
use crate::verify::harness::test_meshes::{box_of, mesh, scene};
use crate::verify::harness::{Case, CaseRunner, Counts, judge_against};

const ORACLE: &str = "brute force; a difference within the derived f32 bounds is a tie";

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H32",
        title: "splitting planes",
        construction: "rays in, along and off whole coordinates, components 0, -0 and denormal, among unit boxes",
        oracle: ORACLE,
        bound: "no wrong hit or miss",
        run: |trial| among_boxes(trial, on_planes),
        ..Case::TRIANGLES
    },
    Case {
        id: "H33",
        title: "cell corners",
        construction: "rays through points and lines with two or three whole coordinates, among unit boxes",
        oracle: ORACLE,
        bound: "no wrong hit or miss",
        run: |trial| among_boxes(trial, through_corners),
        ..Case::TRIANGLES
    },
];

/// Number of boxes along each axis.
const COUNT: usize = 4;

/// Returns unit boxes on a lattice with every third left out, so that faces lie on integer coordinates.
fn boxes() -> Mesh {
    let (mut corners, mut faces) = (Vec::new(), Vec::new());
    for number in (0..COUNT * COUNT * COUNT).filter(|number| number % 3 != 2) {
        let low = [number % COUNT, number / COUNT % COUNT, number / COUNT / COUNT];
        let low = DVec3::from_array(low.map(|place| place as f64));
        let (own_corners, own_faces) = box_of([low, low + DVec3::ONE], corners.len() as u32);
        corners.extend(own_corners);
        faces.extend(own_faces);
    }
    mesh(&corners, faces)
}

/// Returns a coordinate of the lattice, from one before it to one behind.
fn whole(random: &mut SplitMix64) -> f32 {
    random.below(COUNT + 3) as f32 - 1.0
}

fn on_planes(random: &mut SplitMix64) -> Ray {
    let mut component = || random.choose(&[0.0, -0.0, 1e-45, -1e-45, 1e-38, 1.0, -1.0, 0.5, -0.25]);
    let mut direction = Vec3::new(component(), component(), component());
    // Give one component unit size, so that the ray crosses the lattice
    let axis = random.below(3);
    direction[axis] = random.choose(&[1.0, -1.0]);
    let mut origin = Vec3::ZERO;
    // Put most coordinates of the origin into split planes
    for axis in 0..3 {
        origin[axis] = match random.below(3) {
            0 => random.within(-1.0, COUNT as f64 + 1.0) as f32,
            _ => whole(random),
        };
    }
    Ray::new(origin, direction)
}

fn through_corners(random: &mut SplitMix64) -> Ray {
    let mut target = Vec3::new(whole(random), whole(random), whole(random));
    if random.below(2) == 0 {
        // Move the target along a lattice line, off the lattice point
        target[random.below(3)] += random.unit() as f32;
    }
    let mut away = random.direction();
    if random.below(2) == 0 {
        // Choose an integer direction, which passes through many lattice points
        let mut step = || random.below(5) as f64 - 2.0;
        away = DVec3::new(step(), step(), step());
        if away == DVec3::ZERO {
            away = DVec3::ONE;
        }
    }
    let origin = (target.as_dvec3() - random.choose(&[1.0, 2.0, 3.0, 7.5]) * away).as_vec3();
    Ray::new(origin, (target.as_dvec3() - origin.as_dvec3()).as_vec3())
}

fn among_boxes(
    trial: &CaseRunner,
    ray: impl Fn(&mut SplitMix64) -> Ray + Sync,
) -> Result<Counts, AccelError> {
    let scene = scene(vec![Geometry::Mesh(boxes())]);
    let engine = trial.engine(&scene)?;
    let reference = Reference::new(&scene);
    // Judge against culled brute force
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        judge_against(&scene, ray, reference.nearest(ray), hit)
    }))
}
