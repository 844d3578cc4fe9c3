//! Coincident surfaces, and surfaces so close to each other that rounding may swap them.

use glam::{DAffine3, DVec3};

use super::meshes::{mesh, scene};
use super::slivers::{compared, exact_nearest};
use super::trial::{Answer, Tally, Trial};
use super::{Asks, Case, Closes};
use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Instance};
use crate::shape::Shape;

pub(super) const CASES: &[Case] = &[
    Case {
        id: "H30",
        title: "coincident sheets",
        construction: "eight squares at one place, as meshes and as shapes, seen from both sides",
        oracle: "the first of those that coincide is hit",
        bound: "no other is hit",
        unit: "",
        asks: Asks::Triangles,
        required: Closes::Faces,
        run: coincident,
    },
    Case {
        id: "H31",
        title: "sheets in order",
        construction: "pairs of slanted sheets 1 to 64 ulp of their coordinates apart, seen from both sides",
        oracle: "parameters of both to 100 bits",
        bound: "the first is hit, where the other is farther off than the bounds on both errors",
        unit: "",
        asks: Asks::Triangles,
        required: Closes::Faces,
        run: in_order,
    },
];

/// Number of coincident squares of each kind.
const SHEETS: u32 = 8;

fn coincident(trial: &Trial) -> Result<Tally, AccelError> {
    // Stack meshes, and shapes beside them
    let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
    let sheet = || Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]));
    let mut scene = scene((0..SHEETS).map(|_| sheet()).collect());
    scene.geometries.push(Geometry::Shape(Shape::Quad));
    let beside = DAffine3::from_translation(3.0 * DVec3::X);
    let shapes = (0..SHEETS).filter_map(|_| Instance::new("", SHEETS, 0, beside).ok());
    scene.instances.extend(shapes);
    let engine = trial.engine(&scene)?;
    // Aim at either stack from both sides
    let ray = |random: &mut SplitMix64| {
        let is_shape = random.below(2) == 0;
        let shift = if is_shape { 3.0 } else { 0.0 };
        let target = DVec3::new(shift + random.within(-0.9, 0.9), random.within(-0.9, 0.9), 0.0);
        let aside = DVec3::new(
            random.within(-1.0, 1.0),
            random.within(-1.0, 1.0),
            random.pick(&[1.0, -1.0]),
        );
        let origin = (target + random.within(0.5, 10.0) * aside).as_vec3();
        Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    };
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        // The first instance of the stack must win
        let first = if ray.at(1.0).x > 1.5 { SHEETS } else { 0 };
        Answer::wrong_if(hit.is_none_or(|hit| hit.instance != first))
    }))
}

/// Gaps between the triangles of a pair, in ulps.
const GAPS: [u32; 8] = [1, 2, 3, 5, 8, 16, 32, 64];

/// Returns a pair of slanted triangles, `gap` ulps apart in every vertex, at position `place` of a row.
fn pair(place: usize, gap: u32) -> [[DVec3; 3]; 2] {
    let x = 4.0 * place as f64;
    let corner = |x: f64, y: f64, z: f32| DVec3::new(x, y, f64::from(z));
    let sheet = |gap: u32| {
        let up = |z: f32| f32::from_bits(z.to_bits() + gap);
        [
            corner(x - 1.5, -1.5, up(1.0)),
            corner(x + 1.5, -1.25, up(1.25)),
            corner(x, 1.5, up(1.75)),
        ]
    };
    [sheet(0), sheet(gap)]
}

fn in_order(trial: &Trial) -> Result<Tally, AccelError> {
    let pairs: Vec<[[DVec3; 3]; 2]> = GAPS
        .iter()
        .enumerate()
        .map(|(place, &gap)| pair(place, gap))
        .collect();
    // Merge all pairs into one mesh
    let corners: Vec<DVec3> = pairs.iter().flatten().flatten().copied().collect();
    let faces = (0..corners.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
    let scene = scene(vec![Geometry::Mesh(mesh(&corners, faces.collect()))]);
    let engine = trial.engine(&scene)?;
    // Aim at a random point of the first triangle of a pair
    let ray = |random: &mut SplitMix64| {
        let [first, _] = pairs[random.below(pairs.len())];
        let (u, v) = (random.unit(), random.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let target = first[0] + u * (first[1] - first[0]) + v * (first[2] - first[0]);
        let aside = DVec3::new(
            random.within(-1.0, 1.0),
            random.within(-1.0, 1.0),
            random.pick(&[1.0, -1.0]),
        );
        let origin = (target + random.within(0.5, 4.0) * aside).as_vec3();
        Ray::new(origin, (target - origin.as_dvec3()).as_vec3())
    };
    // Judge against the exact nearest triangle
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        let exact = exact_nearest(pairs.as_flattened(), ray, |_| true).map(|(first, _)| first);
        compared(&scene, ray, exact, hit)
    }))
}
