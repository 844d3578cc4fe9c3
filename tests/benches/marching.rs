//! Marches through volumes by the clock: `cargo bench --bench marching -- [SIZE] [FILM]`.
//!
//! Three scenes are rendered on two threads, the film FILM (1024) pixels wide and high with a sample each: a cube of thin
//! haze of SIZE³ (256³) samples in light from all around, for which no feeler is sent; a cube of thick haze in the sun, with a
//! feeler from every sample; neither has an empty block; and `scenes/smoke.toml`. Each is rendered with leaps over empty
//! space and without, in turns; medians of the turns are printed, and whether all pictures are the same to the last bit.
//!
//! A *sample* is one that was interpolated, along a ray of the camera or a feeler. What was leapt over is no sample: it is
//! told apart, as the difference of the two counts. The rate is samples over the seconds that the whole picture took by
//! the clock on the wall, surfaces, film and all, and so is the ratio. Where Linux tells the processor time, which other
//! programs add less to, both are told by that too.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::{DAffine3, DMat3, DVec3};
use whit::accel::{self, AccelOptions, Backend};
use whit::render::{Account, Monitor, RenderSettings, Rendering, render};
use whit::scene::{Camera, Light, LightKind, Scene};
use whit::volume::cloud::{Cloud, CloudShape};
use whit::volume::{SkipEmpty, Thickness, Transfer, TransferNode, Volume, VolumeDescription};

const TURNS: usize = 5;
const THREADS: usize = 2;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let size = numbers.first().copied().unwrap_or(256);
    let film = numbers.get(1).copied().unwrap_or(1024) as u32;
    rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build_global()?;
    let smoke = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/smoke.toml");
    let smoke = whit::scene_file::load(smoke.as_ref(), &Default::default())?.scene;
    race(&format!("thin haze of {size}^3"), &haze(size, 1.0)?, film)?;
    let sunny = Scene {
        ambient: [0.1; 3],
        lights: vec![sun()],
        ..haze(size, 60.0)?
    };
    race(&format!("thick haze of {size}^3 in the sun"), &sunny, film)?;
    race("scenes/smoke.toml", &smoke, film)
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

/// A cube of haze of about this `extinction` before a camera.
fn haze(size: usize, extinction: f64) -> Result<Scene, Box<dyn std::error::Error>> {
    let cloud = Cloud {
        shape: CloudShape::Layer,
        threshold: 0.0,
        ..Cloud::SMOKE
    };
    let node = |value, thickness, grey| TransferNode {
        value,
        thickness,
        color: [grey; 3],
        emission: [0.0; 3],
    };
    let nodes = [node(0.0, 0.5 * extinction, 0.9), node(1.0, 1.5 * extinction, 0.3)];
    let volume = Volume::new(VolumeDescription {
        density: Arc::new(cloud.bake([size; 3])?),
        color: None,
        transfer: Transfer::new(&nodes, Thickness::Extinction)?,
        world_from_cube: DAffine3::IDENTITY,
        // A voxel a step.
        step: Some(2.0 / size as f64),
    })?;
    let eye = DVec3::new(2.0, 1.5, 4.0);
    let away = eye.normalize();
    let right = DVec3::Y.cross(away).normalize();
    let camera = Camera {
        world_from_camera: DAffine3::from_mat3_translation(
            DMat3::from_cols(right, away.cross(right), away),
            eye,
        ),
        ..Camera::default()
    };
    Ok(Scene {
        volumes: vec![volume],
        cameras: vec![camera],
        ambient: [1.0; 3],
        ..Scene::default()
    })
}

/// One picture, and the seconds that it took.
struct Turn {
    rendering: Rendering,
    /// By the clock on the wall.
    wall: f64,
    /// Of all threads together; 0 where it is not told.
    processor: f64,
}

fn race(name: &str, scene: &Scene, film: u32) -> Result<(), Box<dyn std::error::Error>> {
    let accel = accel::build(scene, Backend::default(), &AccelOptions::default())?;
    let turn = |skip_empty| -> Result<Turn, Box<dyn std::error::Error>> {
        let settings = RenderSettings {
            width: film,
            height: film,
            skip_empty,
            ledger: true,
            ..RenderSettings::default()
        };
        let monitor = Monitor {
            progress: &|_| {},
            cancel: &AtomicBool::new(false),
            tiles: None,
        };
        let (before, start) = (processor_seconds(), Instant::now());
        let rendering =
            render(scene, &scene.cameras[0], &*accel, &settings, &monitor).ok_or("nobody cancels")?;
        Ok(Turn {
            rendering,
            wall: start.elapsed().as_secs_f64(),
            processor: processor_seconds() - before,
        })
    };
    let mut turns = [Vec::new(), Vec::new()];
    for _ in 0..TURNS {
        turns[0].push(turn(SkipEmpty::Never)?);
        turns[1].push(turn(SkipEmpty::Leap)?);
    }
    let empty = 100.0 * scene.volumes[0].empty_space().share();
    println!("{name}, {film} x {film} pixels, {THREADS} threads; {empty:.0} % of the blocks are empty");
    let told = [("all samples", &turns[0]), ("with leaps", &turns[1])].map(|(how, turns)| tell(how, turns));
    let [all, leaping] = [&turns[0], &turns[1]].map(|turns| turns[0].rendering.ledger.volume_samples);
    let same = turns
        .iter()
        .flatten()
        .all(|turn| bits(turn) == bits(&turns[0][0]));
    println!(
        "  {} samples leapt over; {:.2} times as fast by the wall, {:.2} by processor time, {:.2} in marches alone; same bits: {same}",
        all - leaping,
        told[0].wall / told[1].wall,
        told[0].processor / told[1].processor,
        told[0].marching / told[1].marching
    );
    Ok(())
}

/// Medians of seconds.
struct Medians {
    wall: f64,
    processor: f64,
    /// In the ledger's account of volumes, shadow rays left out.
    marching: f64,
}

fn tell(how: &str, turns: &[Turn]) -> Medians {
    let median = |seconds: &dyn Fn(&Turn) -> f64| {
        let mut all: Vec<f64> = turns.iter().map(seconds).collect();
        all.sort_by(f64::total_cmp);
        (all[all.len() / 2], all[0], all[all.len() - 1])
    };
    let (wall, least, most) = median(&|turn| turn.wall);
    let (processor, ..) = median(&|turn| turn.processor);
    let (marching, ..) = median(&|turn| turn.rendering.ledger.of(Account::Volume).seconds);
    let millions = turns[0].rendering.ledger.volume_samples as f64 / 1e6;
    println!(
        "  {how}: {millions:.1} M samples in {wall:.3} s ({least:.3}-{most:.3}), {:.1} M/s; {processor:.2} s of processors, {:.1} M/s were the threads alone on the machine",
        millions / wall,
        THREADS as f64 * millions / processor
    );
    Medians {
        wall,
        processor,
        marching,
    }
}

fn bits(turn: &Turn) -> Vec<u32> {
    let values = turn.rendering.image.pixels.as_flattened().iter();
    values.map(|value| value.to_bits()).collect()
}

/// Processor seconds of this process so far: fields 14 and 15 of its `stat`, in hundredths; 0 where there is no such file.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let Some((_, after_name)) = stat.rsplit_once(')') else {
        return 0.0;
    };
    let fields = after_name.split_whitespace().skip(11).take(2);
    fields.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}
