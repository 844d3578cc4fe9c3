//! Subsurface scattering by the hierarchy of irradiance samples against a sum over all of them.

use std::f64::consts::PI;
use std::hint::black_box;
use std::time::Instant;

use glam::DVec3;
use whit::numeric::LANES;
use whit::optics::subsurface::{
    DEFAULT_SOLID_ANGLE, Dipole, IrradianceSample, IrradianceTree, SubsurfacePreset,
};

use crate::limits::Limits;
use crate::quartiles::Quartiles;

const SAMPLE_COUNT: usize = 100_000;
/// Points whose exitance is computed.
const POINT_COUNT: usize = 200;
const ROUNDS: usize = 9;
/// Number of times that the hierarchy computes all points in a round, so that an interruption does not decide.
const REPEATS: usize = 50;
/// The most of the time of brute force that the hierarchy may take.
const MAX_TIME: f64 = 0.1;

/// Compares the two on a marble sphere.
pub(crate) fn run(limits: &mut Limits) {
    let dipole = Dipole::new(&SubsurfacePreset::named("marble").unwrap().scattering).unwrap();
    // As densely sampled as the dipole requires.
    let radius = dipole.sample_spacing() * (SAMPLE_COUNT as f64 / (4.0 * PI)).sqrt();
    let samples = lit_sphere(radius);
    let start = Instant::now();
    let tree = IrradianceTree::build(&samples, &dipole, DEFAULT_SOLID_ANGLE);
    println!("built in {:.1?}, {} bytes", start.elapsed(), tree.byte_count());
    let brute_force = IrradianceTree::build(&samples, &dipole, 0.0);
    let points: Vec<DVec3> = sphere_points(POINT_COUNT).map(|n| radius * n).collect();
    let rounds: Vec<[f64; 2]> = (0..ROUNDS)
        .map(|_| {
            [
                microseconds(&tree, &points, REPEATS),
                microseconds(&brute_force, &points, 1),
            ]
        })
        .collect();
    let ratios = Quartiles::compute(rounds.iter().map(|[tree, brute_force]| tree / brute_force));
    println!(
        "{:.1} us a point of {:.0} us by brute force: {ratios:.4} of its time, {}",
        Quartiles::compute(rounds.iter().map(|round| round[0])),
        Quartiles::compute(rounds.iter().map(|round| round[1])),
        limits.at_most(ratios.median, MAX_TIME)
    );
}

/// Returns the microseconds that the exitance at a point takes, for packets of neighbours as those of a pixel.
fn microseconds(tree: &IrradianceTree, points: &[DVec3], repeats: usize) -> f64 {
    /// Distance of neighbours over the radius of the sphere.
    const STEP: f64 = 1e-3;
    let count = repeats * points.len();
    let start = Instant::now();
    for p in points.iter().cycle().take(count) {
        let along = p.any_orthogonal_vector();
        let lanes = [0, 1, 2].map(|axis| std::array::from_fn(|l| p[axis] + STEP * l as f64 * along[axis]));
        black_box(tree.radiant_exitances(&lanes, &[true; LANES]));
    }
    1e6 * start.elapsed().as_secs_f64() / (count * LANES) as f64
}

/// Returns points of a sphere of radius 1, evenly spread (a spiral of the golden angle).
fn sphere_points(count: usize) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / count as f64;
        let (sin, cos) = (i as f64 * 2.399_963_229_728_653).sin_cos();
        let r = ((1.0 - z) * (1.0 + z)).sqrt();
        DVec3::new(r * cos, r * sin, z)
    })
}

/// Returns the irradiance of a sphere at the origin under a distant light, with the shadow of a bar across it.
fn lit_sphere(radius: f64) -> Vec<IrradianceSample> {
    let wi = DVec3::new(2.0, 1.0, 2.0) / 3.0;
    let cos = |n: DVec3| if n.x.abs() < 0.1 { 0.0 } else { n.dot(wi).max(0.0) };
    sphere_points(SAMPLE_COUNT)
        .map(|n| IrradianceSample {
            position: radius * n,
            area: 4.0 * PI * radius * radius / SAMPLE_COUNT as f64,
            irradiance: [cos(n) as f32; 3],
        })
        .collect()
}
