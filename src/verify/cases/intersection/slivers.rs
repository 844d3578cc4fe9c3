//! Degenerate triangles: slivers seen edge-on, and triangles of arbitrary bits.
//!
//! Embree's robust test occasionally reports slivers at parameters far beyond its own error bounds; only a variant with
//! a different test is required to do better.

use glam::DVec3;

use crate::accel::AccelError;
use crate::accel::brute::BruteAccel;
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Scene};
use crate::verify::harness::test_meshes::{mesh, scene, soup};
use crate::verify::harness::{
    Case, CaseRunner, Correctness, Counts, Watertightness, exact_nearest, judge_against, towards,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H15",
        title: "slivers",
        construction: "triangles 10^3 to 10^9 times as long as high, and rays at down to 0.01 degrees to their planes",
        oracle: "exact signs of the edges, the parameter to 100 bits",
        bound: "no wrong hit or miss beyond the derived f32 bounds, which grow as triangles turn edge-on",
        unit: "ulp of t",
        required: Watertightness::Vertices,
        run: slivers,
        ..Case::TRIANGLES
    },
    Case {
        id: "H17",
        title: "random-bit meshes",
        construction: "meshes whose corners are random bits, uniform over exponents, that pass scene validation",
        oracle: "brute force, and on a difference the exact intersections; within the derived f32 bounds a tie",
        bound: "no wrong hit or miss, no parameter that is NaN",
        required: Watertightness::Vertices,
        run: random_meshes,
        ..Case::TRIANGLES
    },
];

/// Number of slivers in a scene.
const SLIVERS: usize = 128;

/// Returns a sliver near the cube [-1, 1]³.
fn sliver(random: &mut SplitMix64) -> [DVec3; 3] {
    let a = random.in_cube();
    let along = random.within(0.3, 1.0) * random.direction();
    let across = along.cross(random.direction()).normalize_or_zero();
    let height = along.length() * 10f64.powf(random.within(-9.0, -3.0));
    let third = a + random.unit() * along + height * across;
    [a, a + along, third].map(|p| p.as_vec3().as_dvec3())
}

/// Returns a ray at one of the triangles, at a small angle to its plane.
fn grazing(triangles: &[[DVec3; 3]], random: &mut SplitMix64) -> Ray {
    let [a, b, c] = random.choose(triangles);
    // Choose a target within the triangle or slightly beside it
    let (u, v) = (random.within(-0.1, 1.1), random.within(-0.1, 1.1));
    let (u, v) = if u + v > 1.1 { (1.0 - u, 1.0 - v) } else { (u, v) };
    let target = a + u * (b - a) + v * (c - a);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let in_plane = normal.cross(random.direction()).normalize_or_zero();
    // Choose an angle from 0.01 degrees (1.7e-4) up
    let slope = 10f64.powf(random.within(-3.76, 0.0)) * random.choose(&[1.0, -1.0]);
    let way = in_plane + slope * normal;
    towards(target - random.within(0.5, 3.0) * way, target)
}

fn slivers(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Build a scene of slivers with bounding needles
    let mut random = SplitMix64::new(0x5117, 0);
    let triangles: Vec<[DVec3; 3]> = (0..SLIVERS).map(|_| sliver(&mut random)).collect();
    let scene = scene(vec![Geometry::Mesh(soup(&triangles))]);
    let engine = trial.engine(&scene)?;
    let needles: Vec<Needle> = triangles.iter().map(Needle::of).collect();
    Ok(trial.nearest(
        &engine,
        &|random| grazing(&triangles, random),
        &|ray, hit, tally| {
            let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
            // Find the exact hit among the slivers that the ray may hit
            let exact = exact_nearest(&triangles, ray, |number| !needles[number].is_missed(o, d));
            // Record the error of t
            if let (Some((first, t)), Some(hit)) = (&exact, hit)
                && first.primitive == hit.primitive
            {
                let ulp = f64::from(first.t.next_up()) - f64::from(first.t);
                tally.record_error((f64::from(hit.t) - t).abs() / ulp);
            }
            judge_against(&scene, ray, exact.map(|(first, _)| first), hit)
        },
    ))
}

/// Sliver bounded by the line along its first edge and a distance from that line.
struct Needle {
    a: DVec3,
    along: DVec3,
    /// Largest distance of the sliver from the line.
    height: f64,
}

impl Needle {
    fn of([a, b, c]: &[DVec3; 3]) -> Needle {
        let (along, up) = (b - a, c - a);
        let height = up.cross(along).length() / along.length();
        Needle {
            a: *a,
            along,
            // Include the rounding errors of the cross product
            height: height + NEEDLE_ERROR * up.length(),
        }
    }

    /// Returns whether the line `o + t d` certainly misses the sliver: its distance from the needle's line exceeds
    /// `height`.
    fn is_missed(&self, o: DVec3, d: DVec3) -> bool {
        let w = self.a - o;
        let apart = d.dot(w.cross(self.along)).abs();
        let across = d.cross(self.along);
        // The largest of three coordinates is at least 1 / √3 of a vector's length.
        let size = 6.0 * w.abs().max_element() * self.along.abs().max_element() * d.abs().max_element();
        // Subtract the rounding error, so that the test is conservative
        let rest = apart - NEEDLE_ERROR * size;
        rest > 0.0 && rest * rest > self.height * self.height * across.length_squared() * (1.0 + NEEDLE_ERROR)
    }
}

/// Rounding error of a triple product relative to its size, in units of 2^-53: 3 differences, 3 products, 5 sums, and
/// as many for the other side of the comparison.
const NEEDLE_ERROR: f64 = 16.0 * f64::EPSILON;

/// Number of rays for each random mesh while there are few meshes.
const RAYS_A_MESH: u64 = 64;
/// Largest number of random meshes; beyond it, each mesh gets more rays.
const MAX_MESHES: u64 = 10_000;

fn random_meshes(trial: &CaseRunner) -> Result<Counts, AccelError> {
    // Distribute the rays among random meshes
    let mesh_count = trial.rays.div_ceil(RAYS_A_MESH).min(MAX_MESHES);
    trial.over_parts(mesh_count as usize, &|number, part| {
        let mut random = SplitMix64::new(0x6a7ba6e, number as u64);
        let mut scene = scene(vec![Geometry::Mesh(any_mesh(&mut random))]);
        if scene.validate().is_err() {
            // Validation reports such a mesh before anything is built.
            return Ok(Counts::default());
        }
        scene.normalise();
        random_mesh_hits(&part, &scene)
    })
}

/// Returns a number of any exponent and sign that scene validation accepts as a coordinate.
fn any_number(random: &mut SplitMix64) -> f32 {
    loop {
        let x = f32::from_bits(random.bits() as u32);
        if x.abs() < Ray::LIMIT {
            return x;
        }
    }
}

fn any_mesh(random: &mut SplitMix64) -> Mesh {
    let count = 1 + random.below(30) as u32;
    // Use one size for half of the meshes, random exponents for the others
    let size = any_number(random).abs();
    let is_even = random.below(2) == 0;
    let corners = (0..3 * count).map(|_| {
        let mut number = || {
            if is_even {
                f64::from(size) * random.within(-1.0, 1.0)
            } else {
                any_number(random).into()
            }
        };
        DVec3::new(number(), number(), number())
    });
    let corners: Vec<DVec3> = corners.collect();
    mesh(
        &corners,
        (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    )
}

/// Distance of a triangle below which the sums of a parameter lose digits: 2^-34, as a distance times an edge function
/// is of the order of its cube, and that times 2^-24 is just a normal number.
const SMALLEST: f32 = 1.0 / (1u64 << 34) as f32;

fn random_mesh_hits(trial: &CaseRunner, scene: &Scene) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let brute = BruteAccel::new(scene);
    let Geometry::Mesh(mesh) = &scene.geometries[0] else {
        return Ok(Counts::default());
    };
    // Aim at random points of the triangles
    let triangles: Vec<[DVec3; 3]> = (0..mesh.triangles.len() as u32)
        .map(|number| mesh.corners_f64(number))
        .collect();
    let ray = |random: &mut SplitMix64| {
        let [a, b, c] = random.choose(&triangles);
        let (u, v) = (0.5 * random.unit(), 0.5 * random.unit());
        let target = a + u * (b - a) + v * (c - a);
        let reach = (b - a).length().max((c - a).length());
        towards(target + reach * random.direction(), target)
    };
    // Judge against brute force, and against exact arithmetic where they differ
    Ok(trial.nearest(&engine, &ray, &|ray, hit, _| {
        if !ray.is_traceable() {
            return Correctness::wrong_if(hit.is_some());
        }
        match judge_against(scene, ray, brute.nearest(ray), hit) {
            // Products of such small numbers underflow in f32, which the error bounds do not cover.
            Correctness::Wrong if ray.direction.abs().max_element() < SMALLEST => Correctness::Tie,
            // Brute force rounds, too.
            Correctness::Wrong => {
                let exact = exact_nearest(&triangles, ray, |_| true);
                judge_against(scene, ray, exact.map(|(hit, _)| hit), hit)
            }
            correctness => correctness,
        }
    }))
}
