//! Coincident surfaces, and surfaces so close to each other that rounding may swap them.

use glam::{DAffine3, DVec3};

use crate::accel::AccelError;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Instance};
use crate::shape::Shape;
use crate::verify::harness::test_meshes::{mesh, scene, soup};
use crate::verify::harness::{Case, CaseRunner, Correctness, Counts, exact_nearest, judge_against, towards};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H30",
        title: "coincident squares",
        construction: "eight coincident squares, as meshes and as shapes, seen from both sides",
        oracle: "the first of the coincident squares is hit",
        bound: "no other is hit",
        run: coincident,
        ..Case::TRIANGLES
    },
    Case {
        id: "H31",
        title: "order of close surfaces",
        construction: "pairs of slanted surfaces 1 to 64 ulp of their coordinates apart, seen from both sides",
        oracle: "parameters of both hits to 100 bits",
        bound: "the first is hit if the other is farther away than the bounds on both errors",
        run: in_order,
        ..Case::TRIANGLES
    },
];

/// Returns a ray at `target` from a random side of it, up to `farthest` along z.
fn from_either_side(target: DVec3, farthest: f64, random: &mut SplitMix64) -> Ray {
    let mut aside = || random.within(-1.0, 1.0);
    let (x, y) = (aside(), aside());
    let aside = DVec3::new(x, y, random.choose(&[1.0, -1.0]));
    towards(target + random.within(0.5, farthest) * aside, target)
}

/// Number of coincident squares of each kind.
const SQUARES: u32 = 8;

fn coincident(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Stack meshes, and shapes beside them
    let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
    let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
    let square = || Geometry::Mesh(mesh(&corners, vec![[0, 1, 2], [0, 2, 3]]));
    let mut scene = scene((0..SQUARES).map(|_| square()).collect());
    scene.geometries.push(Geometry::Shape(Shape::Quad));
    let beside = DAffine3::from_translation(3.0 * DVec3::X);
    let shapes = (0..SQUARES).filter_map(|_| Instance::new("", SQUARES, 0, beside).ok());
    scene.instances.extend(shapes);
    let engine = trial.engine(&scene)?;
    // Aim at either stack from both sides
    let ray = |random: &mut SplitMix64| {
        let is_shape = random.below(2) == 0;
        let shift = if is_shape { 3.0 } else { 0.0 };
        let target = DVec3::new(shift + random.within(-0.9, 0.9), random.within(-0.9, 0.9), 0.0);
        from_either_side(target, 10.0, random)
    };
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        // The first instance of the stack must win
        let first = if ray.at(1.0).x > 1.5 { SQUARES } else { 0 };
        Correctness::wrong_if(hit.is_none_or(|hit| hit.instance != first))
    }))
}

/// Gaps between the triangles of a pair, in ulps.
const GAPS: [u32; 8] = [1, 2, 3, 5, 8, 16, 32, 64];

/// Returns a pair of slanted triangles, `gap` ulps apart in every vertex, at position `feature` of a row.
fn pair(place: usize, gap: u32) -> [[DVec3; 3]; 2] {
    let x = 4.0 * place as f64;
    let corner = |x: f64, y: f64, z: f32| DVec3::new(x, y, f64::from(z));
    let square = |gap: u32| {
        let up = |z: f32| f32::from_bits(z.to_bits() + gap);
        [
            corner(x - 1.5, -1.5, up(1.0)),
            corner(x + 1.5, -1.25, up(1.25)),
            corner(x, 1.5, up(1.75)),
        ]
    };
    [square(0), square(gap)]
}

fn in_order(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let pairs: Vec<[[DVec3; 3]; 2]> = GAPS
        .iter()
        .enumerate()
        .map(|(place, &gap)| pair(place, gap))
        .collect();
    // Merge all pairs into one mesh
    let scene = scene(vec![Geometry::Mesh(soup(pairs.as_flattened()))]);
    let engine = trial.engine(&scene)?;
    // Aim at a random point of the first triangle of a pair
    let ray = |random: &mut SplitMix64| {
        let [first, _] = pairs[random.below(pairs.len())];
        let (u, v) = (random.unit(), random.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let target = first[0] + u * (first[1] - first[0]) + v * (first[2] - first[0]);
        from_either_side(target, 4.0, random)
    };
    // Judge against the exact nearest triangle
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        let exact = exact_nearest(pairs.as_flattened(), ray, |_| true).map(|(first, _)| first);
        judge_against(&scene, ray, exact, hit)
    }))
}
