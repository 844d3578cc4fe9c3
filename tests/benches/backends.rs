//! Embree against the BSP on a closed, displaced sphere: `cargo bench --bench backends -- [RINGS] [FILM]`.
//!
//! RINGS (default 707) makes about 4 RINGS² triangles, 2 million by default; FILM (default 1024) is the picture's
//! width. Tracing takes one thread; the contestants take turns, and medians of five turns are printed.

#[path = "../common/scenes.rs"]
mod scenes;

use std::time::Instant;

use whit::accel::{Accel, AccelOptions, Backend, Kernel, LANES, RayOrder, build};
use whit::numeric::Ray;

const TURNS: usize = 5;
/// Packets a call, as a tile of the renderer would have.
const BATCH: usize = 64;

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let rings = numbers.first().copied().unwrap_or(707);
    let film = numbers.get(1).copied().unwrap_or(1024);
    let scene = scenes::baked(scenes::bumpy_sphere(rings as u32));
    println!(
        "{} triangles, {film} x {film} camera rays",
        scene.triangle_count()
    );

    let mut contestants: Vec<(String, Box<dyn Accel + '_>)> = Vec::new();
    for backend in [Backend::Embree, Backend::Bsp] {
        for kernel in [Kernel::Single, Kernel::Packet] {
            let options = AccelOptions {
                kernel,
                ..AccelOptions::default()
            };
            let start = Instant::now();
            let Ok(accel) = build(&scene, backend, &options) else {
                println!("no {backend}");
                continue;
            };
            let seconds = start.elapsed().as_secs_f64();
            let report = accel.report();
            println!(
                "{backend} {kernel:?}: built in {seconds:.3} s, {:.1} bytes a triangle, peak {:.1}; {}",
                report.bytes as f64 / scene.triangle_count() as f64,
                report.peak_bytes as f64 / scene.triangle_count() as f64,
                report.summary
            );
            contestants.push((format!("{backend} {kernel:?}"), accel));
        }
    }

    let camera = scenes::camera_rays(&scene, film);
    let mut packets = scenes::packets(&camera);
    if let Some((_, accel)) = contestants.last() {
        accel.intersect(&mut packets, RayOrder::Coherent);
    }
    let hits: Vec<Option<f32>> = (0..camera.len())
        .map(|i| packets[i / LANES].hit(i % LANES).map(|h| h.t))
        .collect();
    let shadow = scenes::shadow_rays(&scene, &camera, &hits);
    let bounce = bounce_rays(&camera, &hits);
    let random = scenes::random_rays(&scene, camera.len() / 4, 7);
    race(
        "camera",
        &contestants,
        &camera,
        RayOrder::Coherent,
        Question::Nearest,
    );
    race("shadow", &contestants, &shadow, RayOrder::Coherent, Question::Any);
    race(
        "bounce",
        &contestants,
        &bounce,
        RayOrder::Incoherent,
        Question::Nearest,
    );
    race(
        "random",
        &contestants,
        &random,
        RayOrder::Incoherent,
        Question::Nearest,
    );
}

#[derive(Clone, Copy, PartialEq)]
enum Question {
    Nearest,
    Any,
}

/// Rays in random directions away from the sphere, from a little above where the camera rays hit.
fn bounce_rays(camera: &[Ray], hits: &[Option<f32>]) -> Vec<Ray> {
    let mut random = scenes::Random(13);
    let from = |(ray, t): (&Ray, &Option<f32>)| {
        let origin = ray.at(f64::from((*t)?) * 0.9999);
        let direction = random.on_sphere() + origin.normalize();
        Some(Ray::new(origin.as_vec3(), direction.as_vec3()))
    };
    camera.iter().zip(hits).filter_map(from).collect()
}

fn race(
    kind: &str,
    contestants: &[(String, Box<dyn Accel + '_>)],
    rays: &[Ray],
    order: RayOrder,
    question: Question,
) {
    let fresh = scenes::packets(rays);
    let mut rates = vec![Vec::new(); contestants.len()];
    let mut answers = vec![0usize; contestants.len()];
    for _ in 0..TURNS {
        for (i, (_, accel)) in contestants.iter().enumerate() {
            let mut packets = fresh.clone();
            let start = Instant::now();
            for batch in packets.chunks_mut(BATCH) {
                match question {
                    Question::Nearest => accel.intersect(batch, order),
                    Question::Any => accel.occluded(batch, order),
                }
            }
            rates[i].push(rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6);
            let lanes = packets.iter().flat_map(|p| (0..LANES).map(move |lane| (p, lane)));
            answers[i] = lanes
                .filter(|(p, lane)| p.is_blocked(*lane) || p.hit(*lane).is_some())
                .count();
        }
    }
    let medians: Vec<f64> = rates
        .iter_mut()
        .map(|r| {
            r.sort_by(f64::total_cmp);
            r[TURNS / 2]
        })
        .collect();
    for (i, (name, _)) in contestants.iter().enumerate() {
        let ratio = medians.get(i % 2).map_or(f64::NAN, |embree| medians[i] / embree);
        let (low, high) = (rates[i][0], rates[i][TURNS - 1]);
        println!(
            "{kind:7} {name:14} {:7.2} Mrays/s ({low:.2}-{high:.2}), {ratio:.2} of the first of its kind, {} hits",
            medians[i], answers[i]
        );
    }
}
