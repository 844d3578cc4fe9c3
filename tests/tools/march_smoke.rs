//! Measures marching: a 256³ volume before 1024 x 1024 camera rays, with and without leaping over empty space.
//!
//! `cargo run --release --example march-smoke [-- SIZE RAYS]` prints millions of samples a second, the seconds with all
//! samples and with leaps, and whether the pictures are the same to the last bit. Rates are by the clock on the wall
//! and, where Linux tells it, by processor time, which other programs disturb less.

use std::sync::Arc;
use std::time::Instant;

use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use whit::volume::cloud::{Cloud, CloudShape};
use whit::volume::{
    March, Marched, SkipEmpty, Stretch, Thickness, Transfer, TransferNode, Volume, VolumeDescription,
};

/// Rows of rays that a thread marches at a time.
const ROWS: usize = 16;
/// Times each measurement is repeated; the fastest counts, as others use the machine too.
const REPEATS: usize = 3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).map(|word| word.parse::<usize>());
    let size = arguments.next().transpose()?.unwrap_or(256);
    let rays = arguments.next().transpose()?.unwrap_or(1024);
    let fog_bank = Cloud {
        shape: CloudShape::Layer,
        threshold: 0.0,
        ..Cloud::SMOKE
    };
    println!(
        "{size}^3 samples, {rays} x {rays} rays, {} threads",
        rayon::current_num_threads()
    );
    for (name, cloud) in [("full", fog_bank), ("smoke", Cloud::SMOKE)] {
        let volume = volume(&cloud, size)?;
        let empty = 100.0 * volume.empty_space().share();
        println!("{name}: {empty:.0} % of the blocks are empty");
        let volumes = [volume];
        let (all, all_time) = measure(|| picture(&volumes, rays, SkipEmpty::Never));
        let (leapt, leapt_time) = measure(|| picture(&volumes, rays, SkipEmpty::Leap));
        for (how, picture, time) in [("all samples", &all, all_time), ("leaping", &leapt, leapt_time)] {
            let samples: u64 = picture.iter().map(|marched| marched.sample_count).sum();
            println!("  {how}: {samples} samples in {}", time.told(samples));
        }
        let same = all.iter().zip(&leapt).all(|(a, b)| bits(a) == bits(b));
        let faster = all_time.wall / leapt_time.wall;
        println!("  leaping is {faster:.2} times as fast; same bits: {same}");
        let (darkened, time) = measure(|| shadows(&volumes, rays));
        let seconds = time.wall;
        println!("  transmittances alone, leaping: {seconds:.3} s; {darkened} rays are darkened");
    }
    Ok(())
}

fn volume(cloud: &Cloud, size: usize) -> Result<Volume, Box<dyn std::error::Error>> {
    let node = |value, thickness, grey| TransferNode {
        value,
        thickness,
        color: [grey; 3],
        emission: [0.0; 3],
    };
    let nodes = [node(0.0, 0.0, 0.9), node(0.4, 1.5, 0.7), node(1.0, 4.0, 0.3)];
    Ok(Volume::new(VolumeDescription {
        density: Arc::new(cloud.bake([size; 3])?),
        color: None,
        transfer: Transfer::new(&nodes, Thickness::Extinction)?,
        world_from_cube: DAffine3::IDENTITY,
        // A voxel a step.
        step: Some(2.0 / size as f64),
    })?)
}

/// Seconds that a run took.
#[derive(Clone, Copy)]
struct Time {
    wall: f64,
    /// Of all threads together.
    processor: Option<f64>,
}

impl Time {
    fn told(self, samples: u64) -> String {
        let millions = samples as f64 / 1e6;
        let wall = format!("{:.3} s, {:.1} M/s", self.wall, millions / self.wall);
        let threads = rayon::current_num_threads() as f64;
        match self.processor {
            Some(seconds) if seconds > 0.0 => {
                let alone = threads * millions / seconds;
                format!("{wall} ({alone:.1} M/s were the threads alone on the machine)")
            }
            _ => wall,
        }
    }
}

/// Processor seconds of this process so far: fields 14 and 15 of its `stat`, in hundredths.
fn processor_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let (_, after_name) = stat.rsplit_once(')')?;
    let fields = after_name.split_whitespace().skip(11).take(2);
    Some(fields.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0)
}

/// The fastest of several runs.
fn measure<T>(run: impl Fn() -> T) -> (T, Time) {
    let timed = || {
        let before = processor_seconds();
        let start = Instant::now();
        let result = run();
        let wall = start.elapsed().as_secs_f64();
        let processor = processor_seconds()
            .zip(before)
            .map(|(after, before)| after - before);
        (result, Time { wall, processor })
    };
    let mut best = timed();
    for _ in 1..REPEATS {
        let next = timed();
        best = if next.1.wall < best.1.wall { next } else { best };
    }
    best
}

/// A camera that sees the whole cube, from the front, right and above.
fn stretch(x: usize, y: usize, rays: usize) -> Stretch {
    let origin = DVec3::new(2.0, 1.5, 4.0);
    let forward = -origin.normalize();
    let right = forward.cross(DVec3::Y).normalize();
    let up = right.cross(forward);
    let [u, v] = [x, y].map(|i| (2.0 * (i as f64 + 0.5) / rays as f64 - 1.0) * 0.36);
    Stretch {
        origin,
        direction: (forward + u * right - v * up).normalize(),
        t_near: 0.0,
        t_far: f64::INFINITY,
    }
}

fn picture(volumes: &[Volume], rays: usize, skip: SkipEmpty) -> Vec<Marched> {
    let mut pixels = vec![None; rays * rays];
    pixels
        .par_chunks_mut(ROWS * rays)
        .enumerate()
        .for_each(|(band, pixels)| {
            let mut march = March::new(volumes, None).with_skip(skip);
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let (x, y) = (i % rays, band * ROWS + i / rays);
                *pixel = Some(march.radiance(&stretch(x, y, rays), None));
            }
        });
    pixels.into_iter().flatten().collect()
}

/// Marches for transmittance alone; how many rays lose light.
fn shadows(volumes: &[Volume], rays: usize) -> u64 {
    let row = |y| {
        let mut march = March::new(volumes, None);
        let seen = (0..rays).map(|x| march.transmittance(&stretch(x, y, rays)));
        seen.filter(|&transmittance| transmittance < 1.0).count() as u64
    };
    (0..rays).into_par_iter().map(row).sum()
}

fn bits(marched: &Marched) -> [u64; 4] {
    let [r, g, b] = marched.radiance;
    [r, g, b, marched.transmittance].map(f64::to_bits)
}
