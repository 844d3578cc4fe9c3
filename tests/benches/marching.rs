//! Times marches through volumes, with skipping of empty space and without: `cargo bench --bench marching -- [SIZE]
//! [FILM]`.
//!
//! **Renders.** Three scenes are rendered on two threads, the film FILM (1024) pixels wide and high with one sample per
//! pixel: a cube of thin haze of SIZE³ (256³) samples in light from all around, for which no shadow ray is traced; a cube
//! of thick haze in the sun, with a shadow ray from every sample; neither has an empty block; and `scenes/smoke.toml`.
//! The rate is samples over the seconds of the whole render, with surfaces and film.
//!
//! **Marches alone.** FILM x FILM rays are marched through two volumes of SIZE³ samples, with no scene around them: haze
//! without an empty block, and smoke. For the radiance of volumes that are lit by 1 everywhere, whose rate is that of the
//! march itself; and, with skipping, for the transmittance alone, as shadow rays do.
//!
//! The ways take turns; medians of the turns are printed, and whether all results are the same to the last bit. A
//! *sample* is one that was interpolated, along a camera ray or a shadow ray. What was skipped is not a sample: its
//! number is printed as the difference of the two counts. Times and ratios are by wall clock and, where Linux reports it,
//! by processor time, to which other programs add less.

use std::error::Error;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use whit::accel::{self, Accel, AccelOptions, Backend};
use whit::measure::Stopwatch;
use whit::render::{Cancelled, Category, Monitor, RenderSettings, Rendering, render};
use whit::scene::{Camera, Light, LightKind, Scene};
use whit::volume::cloud::{Cloud, CloudShape};
use whit::volume::{
    March, Marched, RaySegment, SkipEmpty, Thickness, Transfer, TransferNode, Volume, VolumeDescription,
};

const TURNS: usize = 5;
const THREADS: usize = 2;
/// Rows of rays that a thread marches at a time.
const ROWS: usize = 16;
/// Position of every camera: before the cube, to the right and above.
const EYE: DVec3 = DVec3::new(2.0, 1.5, 4.0);

/// A cloud without an empty block.
const HAZE: Cloud = Cloud {
    shape: CloudShape::Layer,
    threshold: 0.0,
    ..Cloud::SMOKE
};

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let size = numbers.first().copied().unwrap_or(256);
    let film = numbers.get(1).copied().unwrap_or(1024);
    rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build_global()?;
    let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/smoke.toml");
    let smoke = whit::scene_file::load(smoke.as_ref(), &Default::default())?.scene;
    time_renders(&format!("thin haze of {size}^3"), &haze(size, 1.0)?, film)?;
    let sunny = Scene {
        ambient: [0.1; 3],
        lights: vec![sun()],
        ..haze(size, 60.0)?
    };
    time_renders(&format!("thick haze of {size}^3 in the sun"), &sunny, film)?;
    time_renders("scenes/smoke.toml", &smoke, film)?;
    let nodes = [node(0.0, 0.0, 0.9), node(0.4, 1.5, 0.7), node(1.0, 4.0, 0.3)];
    for (name, cloud) in [("haze", HAZE), ("smoke", Cloud::SMOKE)] {
        let volume = volume(&cloud, size, &nodes)?;
        time_marches(&format!("marches alone, {name} of {size}^3"), volume, film);
    }
    Ok(())
}

fn sun() -> Light {
    Light {
        name: "sun".into(),
        intensity: [3.0; 3],
        kind: LightKind::Directional {
            to_light: DVec3::new(1.0, 2.0, 0.5).normalize(),
        },
    }
}

/// Returns a cube of haze of about this `extinction` before a camera.
fn haze(size: usize, extinction: f64) -> Result<Scene, Box<dyn Error>> {
    let nodes = [node(0.0, 0.5 * extinction, 0.9), node(1.0, 1.5 * extinction, 0.3)];
    let away = EYE.normalize();
    let right = DVec3::Y.cross(away).normalize();
    let camera = Camera {
        world_from_camera: DAffine3::from_mat3_translation(
            DMat3::from_cols(right, away.cross(right), away),
            EYE,
        ),
        ..Camera::default()
    };
    Ok(Scene {
        volumes: vec![volume(&HAZE, size, &nodes)?],
        cameras: vec![camera],
        ambient: [1.0; 3],
        ..Scene::default()
    })
}

/// Returns a node of a transfer function, of this extinction per metre and colour.
fn node(value: f64, extinction: f64, grey: f64) -> TransferNode {
    TransferNode {
        value,
        thickness: extinction,
        color: [grey; 3],
        emission: [0.0; 3],
    }
}

/// Returns a cube from -1 to 1 of `size`³ samples.
fn volume(cloud: &Cloud, size: usize, nodes: &[TransferNode]) -> Result<Volume, Box<dyn Error>> {
    Ok(Volume::new(VolumeDescription {
        density: Arc::new(cloud.bake([size; 3])?),
        color: None,
        transfer: Transfer::new(nodes, Thickness::Extinction)?,
        world_from_cube: DAffine3::IDENTITY,
        // One step per voxel.
        step: Some(2.0 / size as f64),
    })?)
}

/// Renders a scene with skipping and without in turns, and prints the comparison.
fn time_renders(name: &str, scene: &Scene, film: usize) -> Result<(), Box<dyn Error>> {
    let accel = accel::build(
        scene.validate().unwrap(),
        Backend::default(),
        &AccelOptions::default(),
    )?;
    let mut turns = [Vec::new(), Vec::new()];
    for _ in 0..TURNS {
        for (turns, skip) in turns.iter_mut().zip([SkipEmpty::Never, SkipEmpty::Leap]) {
            let (rendering, seconds) = timed(|| rendering(scene, &*accel, film, skip));
            turns.push((rendering?, seconds));
        }
    }
    let empty = 100.0 * scene.volumes[0].empty_space().share();
    println!("{name}, {film} x {film} pixels, {THREADS} threads; {empty:.0} % of the blocks are empty");
    let seconds = turns
        .each_ref()
        .map(|turns| turns.iter().map(|turn| turn.1).collect::<Vec<_>>());
    let sample_counts = turns.each_ref().map(|turns| turns[0].0.ledger.volume_samples);
    print_comparison(sample_counts, &seconds);
    // In the ledger's account of volumes, shadow rays left out.
    let [all, skipping] = turns.each_ref().map(|turns| {
        let marching = |turn: &(Rendering, Seconds)| turn.0.ledger.of(Category::Volume).seconds;
        Spread::of(turns.iter().map(marching)).median
    });
    let expected = pixel_bits(&turns[0][0].0);
    let same = turns.iter().flatten().all(|turn| pixel_bits(&turn.0) == expected);
    println!(
        "  marches of camera rays within the render: {:.2} times as fast; same bits: {same}",
        all / skipping
    );
    Ok(())
}

/// Renders a scene.
fn rendering(
    scene: &Scene,
    accel: &dyn Accel,
    film: usize,
    skip_empty: SkipEmpty,
) -> Result<Rendering, Cancelled> {
    let settings = RenderSettings {
        width: film as u32,
        height: film as u32,
        skip_empty,
        ledger: true,
        ..RenderSettings::default()
    };
    let monitor = Monitor::default();
    render(
        scene.validate().unwrap(),
        &scene.cameras[0],
        accel,
        &settings,
        &monitor,
    )
}

fn pixel_bits(rendering: &Rendering) -> Vec<u32> {
    let values = rendering.image.pixels.as_flattened().iter();
    values.map(|value| value.to_bits()).collect()
}

/// Marches rays through a volume in three ways in turns, and prints the comparison.
fn time_marches(name: &str, volume: Volume, film: usize) {
    let empty = 100.0 * volume.empty_space().share();
    println!("{name}, {film} x {film} rays, {THREADS} threads; {empty:.0} % of the blocks are empty");
    let volumes = [volume];
    let expected = march_radiance(&volumes, film, SkipEmpty::Never);
    let (mut sample_counts, mut seconds) = ([0; 2], [Vec::new(), Vec::new()]);
    let (mut shadow_seconds, mut darkened_count) = (Vec::new(), 0);
    let mut same = true;
    for _ in 0..TURNS {
        for (way, skip) in [SkipEmpty::Never, SkipEmpty::Leap].into_iter().enumerate() {
            let (marched, time) = timed(|| march_radiance(&volumes, film, skip));
            seconds[way].push(time);
            sample_counts[way] = marched.iter().map(|marched| marched.sample_count).sum();
            same &= marched
                .iter()
                .zip(&expected)
                .all(|(a, b)| marched_bits(a) == marched_bits(b));
        }
        let (count, time) = timed(|| count_darkened(&volumes, film));
        shadow_seconds.push(time);
        darkened_count = count;
    }
    print_comparison(sample_counts, &seconds);
    println!("  same bits: {same}");
    let wall = Spread::of(shadow_seconds.iter().map(|seconds| seconds.wall));
    let processor = Spread::of(shadow_seconds.iter().map(|seconds| seconds.processor));
    println!(
        "  transmittance alone, with skipping: {wall}; {:.2} s of processor time; {darkened_count} rays are darkened",
        processor.median
    );
}

/// Marches for radiance in light of 1 everywhere.
fn march_radiance(volumes: &[Volume], film: usize, skip: SkipEmpty) -> Vec<Marched> {
    let mut pixels = vec![None; film * film];
    pixels
        .par_chunks_mut(ROWS * film)
        .enumerate()
        .for_each(|(band, pixels)| {
            let mut march = March::new(volumes, None).with_skip(skip);
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let (x, y) = (i % film, band * ROWS + i / film);
                *pixel = Some(march.radiance(&camera_ray(x, y, film), None));
            }
        });
    pixels.into_iter().flatten().collect()
}

/// Marches for transmittance alone and returns how many rays lose light.
fn count_darkened(volumes: &[Volume], film: usize) -> usize {
    let row = |y| {
        let mut march = March::new(volumes, None);
        let transmittances = (0..film).map(|x| march.transmittance(&camera_ray(x, y, film)));
        transmittances
            .filter(|&transmittance| transmittance < 1.0)
            .count()
    };
    (0..film).into_par_iter().map(row).sum()
}

/// Returns a ray of a camera that sees the whole cube.
fn camera_ray(x: usize, y: usize, film: usize) -> RaySegment {
    /// Tangent of half the angle of view.
    const HALF_WIDTH: f64 = 0.36;
    let forward = -EYE.normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let up = right.cross(forward);
    let [u, v] = [x, y].map(|i| (2.0 * (i as f64 + 0.5) / film as f64 - 1.0) * HALF_WIDTH);
    RaySegment {
        origin: EYE,
        direction: (forward + u * right - v * up).normalize(),
        t_near: 0.0,
        t_far: f64::INFINITY,
    }
}

fn marched_bits(marched: &Marched) -> [u64; 4] {
    let [r, g, b] = marched.radiance;
    [r, g, b, marched.transmittance].map(f64::to_bits)
}

/// Time that a turn took.
#[derive(Clone, Copy)]
struct Seconds {
    wall: f64,
    /// Of all threads together.
    processor: f64,
}

/// Returns what `work` returns, and the time that it took.
fn timed<T>(work: impl FnOnce() -> T) -> (T, Seconds) {
    let watch = Stopwatch::start();
    let result = work();
    let time = watch.time();
    let seconds = Seconds {
        wall: time.elapsed,
        processor: time.processor,
    };
    (result, seconds)
}

/// Median and extremes of the turns in seconds.
struct Spread {
    median: f64,
    min: f64,
    max: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Spread {
        let mut all: Vec<f64> = values.collect();
        all.sort_by(f64::total_cmp);
        Spread {
            median: all[all.len() / 2],
            min: all[0],
            max: all[all.len() - 1],
        }
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.3} s ({:.3}-{:.3})", self.median, self.min, self.max)
    }
}

/// Prints samples, times and rates of the turns without skipping and with it, and their ratios.
fn print_comparison(sample_counts: [u64; 2], seconds: &[Vec<Seconds>; 2]) {
    let medians = [0, 1].map(|way| {
        let wall = Spread::of(seconds[way].iter().map(|seconds| seconds.wall));
        let processor = Spread::of(seconds[way].iter().map(|seconds| seconds.processor)).median;
        let millions = sample_counts[way] as f64 / 1e6;
        println!(
            "  {}: {millions:.1} M samples in {wall}, {:.1} M/s; {processor:.2} s of processor time, {:.1} M/s if the threads were alone on the machine",
            ["all samples", "with skipping"][way],
            millions / wall.median,
            THREADS as f64 * millions / processor
        );
        (wall.median, processor)
    });
    let [all, skipping] = medians;
    println!(
        "  {} samples skipped; {:.2} times as fast by wall clock, {:.2} by processor time",
        sample_counts[0] - sample_counts[1],
        all.0 / skipping.0,
        all.1 / skipping.1
    );
}
