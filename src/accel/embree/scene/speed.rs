//! Our spheres, in f64 through callbacks, against Embree's own, in f32, on the same rays.
//!
//! `cargo test --release --lib embree::scene::speed -- --ignored --nocapture`

use std::time::Instant;

use glam::{DAffine3, DVec3, Vec3};

use super::super::EmbreeAccel;
use super::super::call::Question;
use super::super::progress::Progress;
use super::super::trace::{self, Width};
use super::super::trace::{intersect_packet, new_query, occluded_packet};
use super::*;
use crate::accel::{Accel, LANES, RayOrder, RayPacket};
use crate::numeric::Ray;
use crate::scene::Geometry;
use crate::shape::{Shape, Sphere};

const SPHERE_COUNT: usize = 100_000;
const RADIUS: f64 = 0.012;
/// Rays a side of the film.
const SIDE: usize = 512;
const ROUNDS: usize = 11;
/// The least part of Embree's own rate.
const LEAST_RATE: f64 = 0.5;

/// Numbers in [0, 1) (Weyl's sequence on the plastic number's powers).
fn in_cube(i: usize) -> DVec3 {
    let fraction = |step: f64| (i as f64 * step).fract();
    DVec3::new(
        fraction(0.819_172_513_396_164_4),
        fraction(0.671_043_606_703_789_2),
        fraction(0.549_700_477_901_970_2),
    )
}

/// Spheres that fill the unit cube as densely, however many they are.
fn spheres(count: usize) -> Scene {
    let radius = RADIUS * (SPHERE_COUNT as f64 / count as f64).cbrt();
    let place = |i: usize| {
        let scale = DVec3::splat(radius * (0.5 + (i as f64 * 0.618_034).fract()));
        let map = DAffine3::from_scale_rotation_translation(scale, glam::DQuat::IDENTITY, in_cube(i));
        Instance::new("", 0, 0, map).unwrap()
    };
    Scene {
        geometries: vec![Geometry::Shape(Shape::Sphere(Sphere::UNIT))],
        instances: (0..count).map(place).collect(),
        ..Scene::default()
    }
}

/// The same spheres as Embree's own primitives.
fn native<'s>(device: &Device, points: &'s Slab<[f32; 4]>) -> EmbreeScene<'s> {
    let robust = AccelOptions {
        precision: Precision::Robust,
        ..AccelOptions::default()
    };
    let scene = EmbreeScene::new(device, &robust).unwrap();
    let geometry = NewGeometry::of_kind(device, sys::RTC_GEOMETRY_TYPE_SPHERE_POINT).unwrap();
    geometry.set_array(points, sys::RTC_BUFFER_TYPE_VERTEX, sys::RTC_FORMAT_FLOAT4);
    geometry.attach(&scene, 0);
    let mut progress = Progress::new(None, 0);
    scene.commit(device, &progress.stage(0)).unwrap();
    scene
}

/// Rays of a film in packets of 4 x 4, or as many from anywhere to anywhere.
fn packets(order: RayOrder) -> Vec<RayPacket> {
    let blocks = SIDE / 4;
    let film = |block: usize, lane: usize| {
        let (x, y) = (block % blocks * 4 + lane % 4, block / blocks * 4 + lane / 4);
        let at = |pixel: usize| (pixel as f32 + 0.5) / SIDE as f32;
        let eye = Vec3::new(0.5, 0.5, 2.0);
        Ray::new(eye, Vec3::new(at(x), at(y), 1.0) - eye)
    };
    let anywhere = |block: usize, lane: usize| {
        let i = 1 + block * LANES + lane;
        let (from, to) = (in_cube(i * 3).as_vec3(), in_cube(i * 7 + 1).as_vec3());
        Ray::new(from, to - from)
    };
    let packet = |block: usize| {
        let mut packet = RayPacket::EMPTY;
        for lane in 0..LANES {
            let ray = match order {
                RayOrder::Coherent => film(block, lane),
                RayOrder::Incoherent => anywhere(block, lane),
            };
            packet.set(lane, &ray);
        }
        packet
    };
    (0..blocks * blocks).map(packet).collect()
}

/// Seconds that `trace` takes over all packets, in batches as the renderer's, and how many lanes were hit.
fn time(packets: &[RayPacket], trace: &dyn Fn(&mut [RayPacket])) -> (f64, usize) {
    let mut packets = packets.to_vec();
    let start = Instant::now();
    packets.chunks_mut(16).for_each(trace);
    let seconds = start.elapsed().as_secs_f64();
    let is_hit = |packet: &RayPacket, lane: usize| packet.t_far[lane] < f32::INFINITY;
    let hits = packets
        .iter()
        .map(|packet| (0..LANES).filter(|&lane| is_hit(packet, lane)).count());
    (seconds, hits.sum())
}

/// A bare loop over Embree's calls.
fn bare(scene: &EmbreeScene, packets: &mut [RayPacket], order: RayOrder, question: Question) {
    let mut query = new_query(order);
    let query = &raw mut query;
    for packet in packets {
        match question {
            Question::Any => occluded_packet(scene.as_ref(), query, packet),
            Question::Nearest => intersect_packet(scene.as_ref(), query, packet),
        }
    }
}

fn whole(accel: &EmbreeAccel, packets: &mut [RayPacket], order: RayOrder, question: Question) {
    match question {
        Question::Any => accel.occluded(packets, order),
        Question::Nearest => accel.intersect(packets, order),
    }
}

#[test]
#[ignore = "a measurement, of any use only in a release build on a quiet machine"]
fn single_incoherent_rays_overtake_packets_as_the_spheres_get_more() {
    let packets = packets(RayOrder::Incoherent);
    for count in [16, 64, 256, 1024, 4096] {
        let scene = spheres(count);
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        let order = RayOrder::Incoherent;
        let by = |width| {
            let trace = |batch: &mut [RayPacket]| trace::intersect(&accel.world, width, batch, order);
            (0..3)
                .map(|_| time(&packets, &trace).0)
                .fold(f64::INFINITY, f64::min)
        };
        let ratio = by(Width::Sixteen) / by(Width::One);
        println!("{count} spheres: single rays at {ratio:.2} of the rate of packets");
    }
}

#[test]
#[ignore = "a measurement, of any use only in a release build on a quiet machine"]
fn a_hundred_thousand_spheres_are_found_at_half_the_rate_of_embrees_own_or_more() {
    let scene = spheres(SPHERE_COUNT);
    let ours = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
    let device = Device::new(&AccelOptions::default()).unwrap();
    let points: Vec<[f32; 4]> = scene
        .instances
        .iter()
        .map(|instance| {
            let map = instance.world_from_object();
            map.translation
                .as_vec3()
                .extend(map.matrix3.x_axis.x as f32)
                .to_array()
        })
        .collect();
    let points = Slab::from(points);
    let theirs = native(&device, &points);
    let mut worst = f64::INFINITY;
    for order in [RayOrder::Coherent, RayOrder::Incoherent] {
        let packets = packets(order);
        for (name, question) in [("intersect", Question::Nearest), ("occluded", Question::Any)] {
            let mut ratios = Vec::new();
            let mut counts = [0; 2];
            let mut fastest = [f64::INFINITY; 2];
            for _ in 0..ROUNDS {
                let (their_seconds, their_hits) = time(&packets, &|b| bare(&theirs, b, order, question));
                let (our_seconds, our_hits) = time(&packets, &|b| whole(&ours, b, order, question));
                fastest = [fastest[0].min(our_seconds), fastest[1].min(their_seconds)];
                ratios.push(their_seconds / our_seconds);
                counts = [our_hits, their_hits];
            }
            let rays = (packets.len() * LANES) as f64 / 1e6;
            println!(
                "{:.2} and {:.2} million rays a second at best",
                rays / fastest[0],
                rays / fastest[1]
            );
            ratios.sort_by(f64::total_cmp);
            let [low, median, high] = [ROUNDS / 4, ROUNDS / 2, ROUNDS * 3 / 4].map(|i| ratios[i]);
            let [our_hits, their_hits] = counts;
            println!(
                "{name} {order:?}: {median:.3} of the rate of Embree's own spheres ({low:.3} to {high:.3}), \
                 {our_hits} and {their_hits} hits"
            );
            // f32 and f64 part only where a ray grazes.
            assert!(
                our_hits.abs_diff(their_hits) * 1000 < our_hits,
                "{our_hits} {their_hits}"
            );
            worst = worst.min(median);
        }
    }
    assert!(worst >= LEAST_RATE, "{worst}");
}
