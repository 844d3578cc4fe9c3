//! Regression cases for false hits that users of Embree reported: on slivers at grazing angles, on huge boxes, and far
//! beside triangles.

use std::f64::consts::TAU;

use glam::{DQuat, DVec3, Vec3};

use crate::accel::{AccelError, Hit};
use crate::mesh::Mesh;
use crate::numeric::{Ray, SplitMix64};
use crate::scene::{Geometry, Scene};
use crate::verify::harness::test_meshes::{box_of, mesh, scene, soup};
use crate::verify::harness::{
    Case, CaseRunner, Correctness, Counts, Watertightness, exact_nearest, judge_against,
};

pub(in crate::verify::cases) const CASES: &[Case] = &[
    Case {
        id: "H48c",
        title: "sliver at a grazing angle",
        construction: "Embree #387: triangles of edges 11.15, 9.75 and 1.42, rays from up to 600 away at about half a degree",
        oracle: "exact signs of the edges, the parameter to 100 bits",
        bound: "no hit beyond the derived bounds on f32",
        required: Watertightness::Vertices,
        run: glancing,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48d",
        title: "huge boxes",
        construction: "Embree #416: boxes 1.2e5 high and 6e8 to 6e11 wide, as they are and normalised, rays straight down on them",
        oracle: "the top is 500 below, exactly",
        bound: "t to 8 ulp",
        unit: "ulp of t",
        run: huge_boxes,
        ..Case::TRIANGLES
    },
    Case {
        id: "H48e",
        title: "segments beside triangles",
        construction: "Embree #423: segments nearly in the plane of a triangle, two of its sizes beside it or ending \
            as far in front of it",
        oracle: "the bounding boxes are disjoint",
        bound: "0 hits",
        required: Watertightness::Vertices,
        run: beside,
        ..Case::TRIANGLES
    },
];

/// Returns the point with coordinates rounded to f32.
fn rounded(p: DVec3) -> DVec3 {
    p.as_vec3().as_dvec3()
}

/// Number of slivers in a scene.
const SLIVERS: usize = 16;
/// Edge lengths from the bug report: the first from the origin along x, then the distances of the third vertex from its
/// far and its near end.
const EDGES: [f64; 3] = [11.15, 9.75, 1.42];

/// Returns a triangle of these edge lengths, randomly rotated and translated.
fn sliver(random: &mut SplitMix64) -> [DVec3; 3] {
    // Construct the third vertex from its distances
    let [along, far, near] = EDGES;
    let x = (along * along + near * near - far * far) / (2.0 * along);
    let y = (near * near - x * x).sqrt();
    // Rotate, translate and round to f32
    let turn = DQuat::from_axis_angle(random.direction(), random.within(0.0, 3.0));
    let place = 300.0 * random.in_cube();
    [DVec3::ZERO, along * DVec3::X, DVec3::new(x, y, 0.0)].map(|p| rounded(place + turn * p))
}

/// Returns a ray at a sliver or beside it, at 0.1 to 2 degrees to its plane.
fn at_a_glance(triangles: &[[DVec3; 3]], random: &mut SplitMix64) -> Ray {
    let [a, b, c] = random.choose(triangles);
    let target = a + random.within(-0.2, 1.2) * (b - a) + random.within(-4.0, 4.0) * (c - a);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let in_plane = normal.cross(random.direction()).normalize_or_zero();
    // Choose the tangent of the angle, from 0.1 to 2 degrees
    let slope = 10f64.powf(random.within(-2.76, -1.46)) * random.choose(&[1.0, -1.0]);
    let way = in_plane + slope * normal;
    let origin = (target - random.within(50.0, 600.0) * way).as_vec3();
    // The direction has about unit length, as in the bug report.
    let distance = target.distance(origin.as_dvec3());
    Ray::new(origin, ((target - origin.as_dvec3()) / distance).as_vec3())
}

fn glancing(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mut random = SplitMix64::new(0x387, 0);
    let triangles: Vec<[DVec3; 3]> = (0..SLIVERS).map(|_| sliver(&mut random)).collect();
    let scene = scene(vec![Geometry::Mesh(soup(&triangles))]);
    let engine = trial.engine(&scene)?;
    Ok(trial.nearest(
        &engine,
        &|random| at_a_glance(&triangles, random),
        // Judge against the exact nearest triangle
        &|ray, hit, _| {
            let exact = exact_nearest(&triangles, ray, |_| true).map(|(first, _)| first);
            judge_against(&scene, ray, exact, hit)
        },
    ))
}

/// Widths of the boxes along x and y.
const WIDTHS: [f64; 4] = [5.890_75e8, 5.890_75e9, 5.890_75e10, 5.890_75e11];
/// Height of the boxes, and of the points where rays start.
const HEIGHT: f64 = 120_000.0;
const START: f64 = 120_500.0;

/// Returns a box with its lower corner at the origin.
fn huge_box(width: f64) -> Mesh {
    let (corners, faces) = box_of([DVec3::ZERO, DVec3::new(width, width, HEIGHT)], 0);
    mesh(&corners, faces)
}

fn huge_boxes(trial: &CaseRunner) -> Result<Counts, AccelError> {
    trial.over_parts(2 * WIDTHS.len(), &|number, trial| {
        // Test each width as it is and normalised
        let (width, is_normal) = (WIDTHS[number / 2], number % 2 == 1);
        let mut scene = scene(vec![Geometry::Mesh(huge_box(width))]);
        if is_normal {
            scene.normalise();
        }
        huge_box_of(&trial, &scene, width)
    })
}

fn huge_box_of(trial: &CaseRunner, scene: &Scene, width: f64) -> Result<Counts, AccelError> {
    let engine = trial.engine(scene)?;
    let normalisation = scene.normalisation;
    // Scaling by a power of two is exact.
    let expected = normalisation.scale * (START - HEIGHT);
    let ulp = f64::from((expected as f32).next_up()) - expected;
    // Aim straight down inside the rim
    let ray = |random: &mut SplitMix64| {
        let mut inside = || random.within(0.01, 0.99) * width;
        let origin = normalisation.point(DVec3::new(inside(), inside(), START));
        let mut zero = || random.choose(&[0.0, -0.0]);
        Ray::new(origin.as_vec3(), Vec3::new(zero(), zero(), -1.0))
    };
    Ok(trial.nearest(&engine, &ray, &|_, hit, tally| {
        let Some(hit) = hit else {
            return Correctness::Wrong;
        };
        // Compare with the exact distance, in ulps
        let off = (f64::from(hit.t) - expected).abs() / ulp;
        tally.record_error(off);
        Correctness::wrong_if(!(off <= 8.0))
    }))
}

/// Number of triangles of a scene, and their distance, which no segment reaches across.
const SMALL: usize = 64;
const APART: f64 = 128.0;
/// Size of a triangle, and unit of the segments' lengths and distances.
const SIZE: f64 = 1.0;

/// Returns a triangle of that size within its cell of a grid.
fn small(number: usize, random: &mut SplitMix64) -> [DVec3; 3] {
    let cell = DVec3::new((number % 4) as f64, (number / 4 % 4) as f64, (number / 16) as f64);
    // Place the triangle at the coordinates of the bug report, relative to its cell
    let place = APART * cell + DVec3::new(0.2287, 1.3526, 0.5);
    [0; 3].map(|_| rounded(place + 0.5 / 3f64.sqrt() * SIZE * random.in_cube()))
}

/// Returns a segment that misses its triangle: beside it, or ending half way to it.
fn segment(triangles: &[[DVec3; 3]], random: &mut SplitMix64) -> Ray {
    let [a, b, c] = random.choose(triangles);
    if random.below(4) == 0 {
        // Aim straight at the triangle, but end half way
        let target = (a + b + c) / 3.0;
        let origin = target + 6.0 * SIZE * random.direction();
        return Ray {
            t_far: 1.0,
            ..Ray::new(origin.as_vec3(), (0.5 * (target - origin)).as_vec3())
        };
    }
    // Build a frame in the plane of the triangle
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let x = (b - a).normalize_or_zero();
    let y = normal.cross(x);
    let mut in_plane = || {
        let (sin, cos) = (TAU * random.unit()).sin_cos();
        cos * x + sin * y
    };
    let (aside, along) = (in_plane(), in_plane());
    // Tilt the segment slightly out of the plane
    let mut off = || 10f64.powf(random.within(-8.0, -1.0)) * SIZE * normal;
    let (low, high) = (off(), off());
    // Place its midpoint three to forty sizes away; the segment is at most one size long.
    let middle = (a + b + c) / 3.0 + random.within(3.0, 40.0) * SIZE * aside;
    let half = random.within(0.1, 0.5) * SIZE * along;
    let origin = (middle - half + low).as_vec3();
    let end = middle + half + high;
    Ray {
        t_far: 1.0,
        ..Ray::new(origin, (end - origin.as_dvec3()).as_vec3())
    }
}

fn beside(trial: &CaseRunner) -> Result<Counts, AccelError> {
    let mut random = SplitMix64::new(0x423, 0);
    let triangles: Vec<[DVec3; 3]> = (0..SMALL).map(|number| small(number, &mut random)).collect();
    let scene = scene(vec![Geometry::Mesh(soup(&triangles))]);
    let engine = trial.engine(&scene)?;
    let judge = |_: &Ray, hit: Option<Hit>, _: &mut Counts| Correctness::wrong_if(hit.is_some());
    Ok(trial.nearest(&engine, &|random| segment(&triangles, random), &judge))
}
