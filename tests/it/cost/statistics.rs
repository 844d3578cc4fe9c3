//! What `whit cost` tells of errors, held against pictures whose errors are known. The ignored test is the same with more
//! repeats: `tests/ci/slow statistics`.

use std::fs;
use std::sync::atomic::AtomicBool;

use crate::support::sampling_scenes::first_light;
use crate::support::{pictures, scene_folder};
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::cost::{Displayed, Halves, Pictures, slope};
use whit::image::{LinearImage, ToneMap};
use whit::render::{Monitor, Pattern, RenderSettings, render};
use whit::scene::Scene;

const TONE: ToneMap = ToneMap { exposure_ev: 0.0 };

/// A bright triangle before black, seen along parallel rays through a window of two by two.
const TRIANGLE: &str = "
[camera]
from = [0, 0, 5]
at = [0, 0, 0]
height = 2

[material.lamp]
base_color = '#000000'
emission = 1

[[object]]
shape = { mesh = { vertices = [[-0.83, -0.71, 0], [0.92, -0.37, 0], [-0.13, 0.89, 0]], faces = [[0, 1, 2]] } }
material = 'lamp'
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

fn picture(scene: &Scene, accel: &dyn Accel, settings: &RenderSettings) -> Displayed {
    let monitor = Monitor {
        progress: &|_| {},
        cancel: &AtomicBool::new(false),
        tiles: None,
    };
    let rendering = render(scene, &scene.cameras[0], accel, settings, &monitor).unwrap();
    Displayed::new(&rendering.image, TONE)
}

#[test]
fn jittered_samples_of_edges_err_by_the_power_of_minus_three_quarters_and_the_fit_contains_it() {
    let scene = triangle();
    let accel = accel::build(&scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let truth = Displayed::new(&exact(), TONE);
    let halves = Halves {
        a: truth.clone(),
        b: truth,
    };
    let mut points = Vec::new();
    for side in [2, 4, 8, 16] {
        let mut all = Pictures::new(&halves);
        for seed in 0..12 {
            let settings = RenderSettings {
                pattern: Pattern::Jittered,
                seed,
                ..pictures::settings(SIDE, side * side)
            };
            all.add(&halves, &picture(&scene, &*accel, &settings));
        }
        points.push((f64::from(side * side), all.mean_square().sqrt()));
    }
    // n strata, of which an edge crosses about √n, each with a variance of its own of 1 / n²: n^-3/2 in all.
    let found = slope(&points).unwrap();
    assert!(
        found.low <= -0.75 && -0.75 <= found.high,
        "{found:?} of {points:?}"
    );
    assert!(found.value < -0.5, "steeper than without strata: {found:?}");
    assert!(found.high - found.low < 0.5, "{found:?} tells something");
}

/// Settings, by samples a pixel, that are chosen among.
const OFFERED: [u32; 4] = [2, 4, 8, 16];

#[test]
fn what_is_certified_of_chosen_settings_is_nearly_always_true() {
    assert!(certified_share(8, 512) >= 0.75);
}

#[test]
#[ignore = "slow: 200 repeats"]
fn what_is_certified_of_chosen_settings_is_true_in_at_least_ninety_three_of_a_hundred_repeats() {
    assert!(certified_share(200, 2048) >= 0.93);
}

/// In what part of so many repeats that chose settings what was told of them is true, beside two pictures of so many
/// samples a pixel.
fn certified_share(repeats: u32, best_spp: u32) -> f64 {
    let scene = first_light();
    let accel = accel::build(&scene, Backend::Bsp, &AccelOptions::default()).unwrap();
    let take = |spp: u32, seed: u32| {
        let settings = RenderSettings {
            width: 32,
            height: 24,
            seed,
            pattern: Pattern::Sobol,
            ..pictures::settings(32, spp)
        };
        picture(&scene, &*accel, &settings)
    };
    let judged = |halves: &Halves, spp: u32, seeds: std::ops::Range<u32>| {
        let mut all = Pictures::new(halves);
        seeds.for_each(|seed| all.add(halves, &take(spp, seed)));
        all
    };
    // As good as the truth beside what a repeat can tell.
    let best = Halves {
        a: take(best_spp, 1_000_001),
        b: take(best_spp, 2_000_001),
    };
    let seeds = 3_000_000..3_000_000 + 4 * repeats;
    let truths = OFFERED.map(|spp| judged(&best, spp, seeds.clone()).mean_square().sqrt());
    assert!(truths.is_sorted_by(|a, b| a > b), "{truths:?}");
    let (mut true_count, mut told) = (0, 0);
    for repeat in 0..repeats {
        let halves = Halves {
            a: take(96, 1_100_000 + repeat).as_share(1.0),
            b: take(96, 2_100_000 + repeat).as_share(1.0),
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
            told += 1;
            true_count += u32::from(truths[place] <= certified && truths[place] <= target);
        }
    }
    assert!(told >= repeats / 2, "{told} of {repeats} were chosen for");
    println!("{true_count} of {told} certificates are true");
    f64::from(true_count) / f64::from(told)
}
