//! Errors that `whit cost` estimates, against images of known error. The ignored test is the same with more
//! repeats: `tests/ci/slow statistics`.

use std::fs;

use crate::support::sampling_scenes::first_light;
use crate::support::{images, scene_folder};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::cost::{DisplayImage, ImageSums, Interval, SplitReference, slope};
use whit::image::{LinearImage, ToneMap};
use whit::render::{Pattern, RenderSettings};
use whit::scene::Scene;

const TONE: ToneMap = ToneMap { exposure_ev: 0.0 };

/// A bright triangle before black, seen along parallel rays through a window of two by two.
const TRIANGLE: &str = "
[camera]
from = [0, 0, 5]
at = [0, 0, 0]
height = 2

[material.emitter]
base_color = '#000000'
emission = 1

[[object]]
shape = { mesh = { vertices = [[-0.83, -0.71, 0], [0.92, -0.37, 0], [-0.13, 0.89, 0]], faces = [[0, 1, 2]] } }
material = 'emitter'
";
const CORNERS: [[f64; 2]; 3] = [[-0.83, -0.71], [0.92, -0.37], [-0.13, 0.89]];
const SIDE: u32 = 48;

/// The part of a polygon for which `a x + b y <= c`.
fn cut(polygon: &[[f64; 2]], [a, b, c]: [f64; 3]) -> Vec<[f64; 2]> {
    let beyond = |p: [f64; 2]| a * p[0] + b * p[1] - c;
    let mut left = Vec::new();
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let (of_p, of_q) = (beyond(p), beyond(q));
        if of_p <= 0.0 {
            left.push(p);
        }
        if (of_p <= 0.0) != (of_q <= 0.0) {
            let part = of_p / (of_p - of_q);
            left.push([0, 1].map(|k| p[k] + part * (q[k] - p[k])));
        }
    }
    left
}

fn area(polygon: &[[f64; 2]]) -> f64 {
    let next = |i: usize| polygon[(i + 1) % polygon.len()];
    let cross = |i: usize| polygon[i][0] * next(i)[1] - polygon[i][1] * next(i)[0];
    0.5 * (0..polygon.len()).map(cross).sum::<f64>().abs()
}

/// The picture of the triangle by the areas of its parts in the pixels.
fn exact() -> LinearImage {
    let size = 2.0 / f64::from(SIDE);
    let covered = |pixel: u32| {
        let (x, y) = (pixel % SIDE, pixel / SIDE);
        let left = -1.0 + size * f64::from(x);
        let top = 1.0 - size * f64::from(y);
        let sides = [
            [-1.0, 0.0, -left],
            [1.0, 0.0, left + size],
            [0.0, 1.0, top],
            [0.0, -1.0, size - top],
        ];
        let part = sides
            .into_iter()
            .fold(CORNERS.to_vec(), |part, side| cut(&part, side));
        if part.is_empty() {
            0.0
        } else {
            area(&part) / (size * size)
        }
    };
    LinearImage {
        width: SIDE,
        height: SIDE,
        pixels: (0..SIDE * SIDE).map(|pixel| [covered(pixel) as f32; 3]).collect(),
    }
}

fn triangle() -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("triangle.toml");
    fs::write(&file, TRIANGLE).unwrap();
    scene_folder::load(&file).scene
}

fn rendered(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> DisplayImage {
    let rendering = images::rendered_with(scene, accel, settings);
    DisplayImage::new(&rendering.image, TONE)
}

#[test]
fn fit_contains_the_minus_three_quarters_rate_of_jittered_edges() {
    let scene = triangle();
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let truth = DisplayImage::new(&exact(), TONE);
    let halves = SplitReference {
        a: truth.clone(),
        b: truth,
    };
    let mut points = Vec::new();
    for side in [2, 4, 8, 16] {
        let mut all = ImageSums::new(&halves);
        for seed in 0..12 {
            let settings = RenderSettings {
                pattern: Pattern::Jittered,
                seed,
                ..images::settings(SIDE, side * side)
            };
            all.add(&halves, &rendered(&scene, &*accel, &settings));
        }
        points.push((Interval::exact(f64::from(side * side)), all.block_squares()));
    }
    // n strata, of which an edge crosses about √n, each with a variance of its own of 1 / n²: n^-3/2 in all.
    let points: Vec<(Interval, &[f64])> = points
        .iter()
        .map(|(time, squares)| (*time, &squares[..]))
        .collect();
    let found = slope(&points).unwrap();
    assert!(found.low <= -0.75 && -0.75 <= found.high, "{found:?}");
    assert!(found.value < -0.5, "steeper than without strata: {found:?}");
    assert!(found.high - found.low < 0.5, "{found:?} is narrow");
}

/// Settings, by samples a pixel, that are chosen among.
const OFFERED: [u32; 4] = [2, 4, 8, 16];

#[test]
fn certificates_of_chosen_settings_are_nearly_always_true() {
    assert!(certified_share(4, 256) >= 0.75);
}

#[test]
#[ignore = "slow: 200 repeats"]
fn certificates_of_chosen_settings_are_true_in_93_percent() {
    assert!(certified_share(200, 2048) >= 0.93);
}

/// In what part of so many repeats that chose settings what was told of them is true, beside two pictures of so many
/// samples a pixel.
fn certified_share(repeats: u32, best_spp: u32) -> f64 {
    let scene = first_light();
    let accel = accel::build(scene.validate().unwrap(), Backend::Bsp, &AccelOptions::default()).unwrap();
    let take = |spp: u32, seed: u32| {
        let settings = RenderSettings {
            width: 32,
            height: 24,
            seed,
            pattern: Pattern::Sobol,
            ..images::settings(32, spp)
        };
        rendered(&scene, &*accel, &settings)
    };
    let judged = |halves: &SplitReference, spp: u32, seeds: std::ops::Range<u32>| {
        let mut all = ImageSums::new(halves);
        seeds.for_each(|seed| all.add(halves, &take(spp, seed)));
        all
    };
    // As good as the truth beside what a repeat can tell.
    let best = SplitReference {
        a: take(best_spp, 1_000_001),
        b: take(best_spp, 2_000_001),
    };
    let seeds = 3_000_000..3_000_000 + 4 * repeats;
    let truths = OFFERED.map(|spp| judged(&best, spp, seeds.clone()).mean_square().sqrt());
    assert!(truths.is_sorted_by(|a, b| a > b), "{truths:?}");
    let (mut true_count, mut chosen_count) = (0, 0);
    for repeat in 0..repeats {
        let halves = SplitReference {
            a: take(96, 1_100_000 + repeat).as_fraction(1.0),
            b: take(96, 2_100_000 + repeat).as_fraction(1.0),
        };
        // Targets from the worst to the best, on and off what settings reach.
        let part = f64::from(repeat) / f64::from(repeats);
        let target = 1.2 * truths[0] * (truths[3] / truths[0]).powf(part);
        let first = 10_000 + 12 * repeat;
        let upper = |spp: u32, seeds| judged(&halves, spp, seeds).estimate(&halves, 1).rmse().high;
        // The cheapest that reaches it twice, the second time on pictures that had no part in the choice.
        let chosen = (0..OFFERED.len()).find_map(|place| {
            if upper(OFFERED[place], first..first + 6) > target {
                return None;
            }
            let certified = upper(OFFERED[place], first + 6..first + 12);
            (certified <= target).then_some((place, certified))
        });
        if let Some((place, certified)) = chosen {
            chosen_count += 1;
            true_count += u32::from(truths[place] <= certified && truths[place] <= target);
        }
    }
    assert!(
        chosen_count >= repeats / 2,
        "{chosen_count} of {repeats} were chosen for"
    );
    println!("{true_count} of {chosen_count} certificates are true");
    f64::from(true_count) / f64::from(chosen_count)
}
