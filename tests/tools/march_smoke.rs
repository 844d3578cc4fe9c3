//! Measures marching: a 256³ volume before 1024 x 1024 camera rays, with and without leaping over empty space.
//!
//! `cargo run --release --example march-smoke [-- SIZE RAYS]` prints millions of samples a second, the seconds with all
//! samples and with leaps, and whether the pictures are the same to the last bit.

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
        let (all, all_seconds) = measure(|| picture(&volumes, rays, SkipEmpty::Never));
        let (leapt, leapt_seconds) = measure(|| picture(&volumes, rays, SkipEmpty::Leap));
        for (how, picture, seconds) in [
            ("all samples", &all, all_seconds),
            ("leaping", &leapt, leapt_seconds),
        ] {
            let samples: u64 = picture.iter().map(|marched| marched.sample_count).sum();
            let rate = samples as f64 / seconds / 1e6;
            println!("  {how}: {samples} samples in {seconds:.3} s, {rate:.1} M/s");
        }
        let same = all.iter().zip(&leapt).all(|(a, b)| bits(a) == bits(b));
        println!(
            "  leaping is {:.2} times as fast; same bits: {same}",
            all_seconds / leapt_seconds
        );
        let ((), seconds) = measure(|| shadows(&volumes, rays));
        println!("  transmittances alone, leaping: {seconds:.3} s");
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

/// The fastest of several runs.
fn measure<T>(run: impl Fn() -> T) -> (T, f64) {
    let timed = || {
        let start = Instant::now();
        let result = run();
        (result, start.elapsed().as_secs_f64())
    };
    let mut best = timed();
    for _ in 1..REPEATS {
        let next = timed();
        best = if next.1 < best.1 { next } else { best };
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

fn shadows(volumes: &[Volume], rays: usize) {
    (0..rays).into_par_iter().for_each(|y| {
        let mut march = March::new(volumes, None);
        for x in 0..rays {
            std::hint::black_box(march.transmittance(&stretch(x, y, rays)));
        }
    });
}

fn bits(marched: &Marched) -> [u64; 4] {
    let [r, g, b] = marched.radiance;
    [r, g, b, marched.transmittance].map(f64::to_bits)
}
