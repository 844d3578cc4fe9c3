//! What `Accel` costs over the bare loop of Embree's calls.
//!
//! `cargo test --release --test embree_speed -- --ignored --nocapture`
#![cfg(feature = "embree")]

use std::time::{Duration, Instant};

use glam::{DAffine3, Vec3};
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelOptions, LANES, RayOrder, RayPacket};
use whit::mesh::{Mesh, Slab};
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};

/// A height field of `n`² cells over [0, 1]².
fn field(n: u32) -> Scene {
    let at = |i: u32| i as f32 / n as f32;
    let height = |x: f32, y: f32| 0.05 * (40.0 * x).sin() * (30.0 * y).cos();
    let positions: Vec<[f32; 3]> = (0..=n)
        .flat_map(|j| (0..=n).map(move |i| [at(i), at(j), height(at(i), at(j))]))
        .collect();
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|j| (0..n).map(move |i| j * (n + 1) + i))
        .flat_map(|v| [[v, v + 1, v + n + 2], [v, v + n + 2, v + n + 1]])
        .collect();
    let mesh = Mesh {
        positions: Slab::from(positions),
        triangles: Slab::from(triangles),
        ..Mesh::default()
    };
    Scene {
        geometries: vec![Geometry::Mesh(mesh)],
        instances: vec![Instance::new("field", 0, 0, DAffine3::IDENTITY).unwrap()],
        ..Scene::default()
    }
}

/// A view of `side`² rays in packets of 4x4, from above.
fn view(side: usize) -> Vec<RayPacket> {
    let at = |pixel: usize| (pixel as f32 + 0.5) / side as f32;
    let blocks = side / 4;
    (0..blocks * blocks)
        .map(|block| {
            let mut packet = RayPacket::EMPTY;
            for lane in 0..LANES {
                let (x, y) = (block % blocks * 4 + lane % 4, block / blocks * 4 + lane / 4);
                let eye = Vec3::new(0.5, 0.5, 1.0);
                packet.set(lane, &Ray::new(eye, Vec3::new(at(x), at(y), 0.0) - eye));
            }
            packet
        })
        .collect()
}

#[test]
#[ignore = "a measurement, of any use only in a release build on a quiet machine"]
fn the_contract_costs_at_most_a_tenth_over_the_bare_loop() {
    const ROUNDS: usize = 41;
    // Small batches, as the renderer's: a large array would measure memory.
    const BATCH: usize = 16;
    for cells in [16, 300] {
        let scene = field(cells);
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        let packets = view(512);
        type Trace<'a> = &'a dyn Fn(&mut [RayPacket]);
        let time = |trace: Trace| {
            let mut spent = Duration::ZERO;
            for batch in packets.chunks(BATCH) {
                let mut batch = batch.to_vec();
                let start = Instant::now();
                trace(&mut batch);
                spent += start.elapsed();
            }
            spent.as_secs_f64()
        };
        let compare = |name: &str, raw: Trace, whole: Trace| {
            let mut ratios: Vec<f64> = (0..ROUNDS).map(|_| time(raw) / time(whole)).collect();
            ratios.sort_by(f64::total_cmp);
            let [low, median, high] = [ROUNDS / 4, ROUNDS / 2, ROUNDS * 3 / 4].map(|i| ratios[i]);
            println!(
                "{} triangles, {name}: {median:.3} of the bare rate ({low:.3} to {high:.3})",
                cells * cells * 2
            );
            assert!(median >= 0.9, "{name}");
        };
        for order in [RayOrder::Coherent, RayOrder::Incoherent] {
            let name = |call: &str| format!("{call} {order:?}");
            compare(&name("intersect"), &|b| accel.raw_intersect(b, order), &|b| {
                accel.intersect(b, order)
            });
            compare(&name("occluded"), &|b| accel.raw_occluded(b, order), &|b| {
                accel.occluded(b, order)
            });
        }
    }
}
