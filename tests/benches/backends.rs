//! Embree against the BSP on a closed, displaced sphere: `cargo bench --bench backends -- [RINGS] [FILM]`.
//!
//! RINGS (default 707) makes about 4 RINGS² triangles, 2 million by default; FILM (default 1024) is the image's
//! width. Tracing takes one thread; the contestants take turns, and medians of five turns are printed.
//!
//! Beside them runs a BVH in Rust by others, the compressed wide one of the crate `obvhs` (Ylitie, Karras and Laine 2017,
//! built after Meister and Bittner 2018), with the same triangles and rays, one ray at a time as it takes them. Of hits
//! it gives distance and triangle; its test lets rays through at edges now and then, as `fast` does.

#[path = "../it/support/scenes.rs"]
mod scenes;

use std::time::{Duration, Instant};

use obvhs::BvhBuildParams;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::RayHit;
use obvhs::triangle::Triangle;
use whit::accel::{
    Accel, AccelOptions, AccelReport, Backend, Coherence, Hit, Kernel, LANES, RayPacket, build,
};
use whit::numeric::Ray;
use whit::scene::{Geometry, Scene};

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
            let Ok(accel) = build(scene.validate().unwrap(), backend, &options) else {
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

    let start = Instant::now();
    let others = OthersBvh::build(&scene);
    println!(
        "obvhs: built in {:.3} s, {:.1} bytes a triangle; {}",
        start.elapsed().as_secs_f64(),
        others.report().bytes as f64 / scene.triangle_count() as f64,
        others.report().summary
    );

    let camera = scenes::camera_rays(&scene, film);
    let mut packets = scenes::packets(&camera);
    if let Some((_, accel)) = contestants.last() {
        accel.intersect(&mut packets, Coherence::Coherent);
    }
    let hits: Vec<Option<f32>> = (0..camera.len())
        .map(|i| packets[i / LANES].hit(i % LANES).map(|h| h.t))
        .collect();
    let shadow = scenes::shadow_rays(&scene, &camera, &hits);
    let bounce = bounce_rays(&camera, &hits);
    contestants.push(("obvhs Single".into(), Box::new(others)));
    let random = scenes::random_rays(&scene, camera.len() / 4, 7);
    race(
        "camera",
        &contestants,
        &camera,
        Coherence::Coherent,
        Question::Nearest,
    );
    race(
        "shadow",
        &contestants,
        &shadow,
        Coherence::Coherent,
        Question::Any,
    );
    race(
        "bounce",
        &contestants,
        &bounce,
        Coherence::Incoherent,
        Question::Nearest,
    );
    race(
        "random",
        &contestants,
        &random,
        Coherence::Incoherent,
        Question::Nearest,
    );
}

/// The BVH by others over the one mesh of a scene.
struct OthersBvh {
    bvh: CwBvh,
    /// In the order of the leaves.
    triangles: Vec<Triangle>,
}

impl OthersBvh {
    /// As well as it can be built: builds of lower quality are faster, rays through them slower.
    fn build(scene: &Scene) -> OthersBvh {
        let meshes = scene.geometries.iter().filter_map(|geometry| match geometry {
            Geometry::Mesh(mesh) => Some(mesh),
            Geometry::Shape(_) | Geometry::Points(_) => None,
        });
        let of = |[v0, v1, v2]: [glam::Vec3; 3]| Triangle {
            v0: v0.into(),
            v1: v1.into(),
            v2: v2.into(),
        };
        let triangles: Vec<Triangle> = meshes
            .flat_map(|mesh| (0..mesh.triangles.len() as u32).map(move |number| of(mesh.corners(number))))
            .collect();
        let bvh = build_cwbvh_from_tris(
            &triangles,
            BvhBuildParams::very_slow_build(),
            &mut Duration::default(),
        );
        let ordered = bvh.primitive_indices.iter();
        let triangles = ordered.map(|&number| triangles[number as usize]).collect();
        OthersBvh { bvh, triangles }
    }

    /// Traces every active lane by itself.
    fn trace_each(
        &self,
        packets: &mut [RayPacket],
        mut record: impl FnMut(&mut RayPacket, usize, obvhs::ray::Ray),
    ) {
        for packet in packets {
            for lane in 0..LANES {
                if !packet.is_active(lane) {
                    continue;
                }
                let ray = packet.ray(lane);
                let [origin, direction] = [ray.origin, ray.direction].map(glam::Vec3A::from);
                let ray = obvhs::ray::Ray::new(origin, direction, ray.t_near, ray.t_far);
                record(packet, lane, ray);
            }
        }
    }
}

impl Accel for OthersBvh {
    fn intersect(&self, packets: &mut [RayPacket], _: Coherence) {
        self.trace_each(packets, |packet, lane, ray| {
            let mut found = RayHit::none();
            let triangle = |ray: &obvhs::ray::Ray, place: usize| self.triangles[place].intersect(ray);
            if self.bvh.ray_traverse(ray, &mut found, triangle) {
                let hit = Hit {
                    instance: 0,
                    primitive: self.bvh.primitive_indices[found.primitive_id as usize],
                    t: found.t,
                    u: 0.0,
                    v: 0.0,
                };
                packet.set_hit(lane, &hit);
            }
        });
    }

    fn occluded(&self, packets: &mut [RayPacket], _: Coherence) {
        self.trace_each(packets, |packet, lane, ray| {
            let triangle = |ray: &obvhs::ray::Ray, place: usize| self.triangles[place].intersect(ray);
            if !self.bvh.ray_traverse_miss(ray, triangle) {
                packet.set_blocked(lane);
            }
        });
    }

    fn report(&self) -> AccelReport {
        let bytes = size_of_val(&self.bvh.nodes[..])
            + size_of_val(&self.bvh.primitive_indices[..])
            + size_of_val(&self.triangles[..]);
        AccelReport {
            bytes: bytes as u64,
            summary: "8-wide compressed BVH of obvhs".into(),
            ..AccelReport::default()
        }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Question {
    Nearest,
    Any,
}

/// Rays in random directions away from the sphere, from a little above where the camera rays hit.
fn bounce_rays(camera: &[Ray], hits: &[Option<f32>]) -> Vec<Ray> {
    let mut random = scenes::SplitMix64(13);
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
    order: Coherence,
    question: Question,
) {
    let fresh = scenes::packets(rays);
    let mut rates = vec![Vec::new(); contestants.len()];
    let mut hit_counts = vec![0usize; contestants.len()];
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
            hit_counts[i] = lanes
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
            medians[i], hit_counts[i]
        );
    }
}
