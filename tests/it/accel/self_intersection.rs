//! Rays that the renderer spawns on an analytic shape do not hit it at their origin, in any backend.
//!
//! The large version, with its counts: `tests/ci/slow self_intersection`.

use std::time::Instant;

use crate::support::scenes::{self, SplitMix64};
use glam::{DAffine3, DVec3};
use whit::accel::brute::BruteAccel;
use whit::accel::bsp::BspAccel;
use whit::accel::{Accel, AccelOptions, Coherence, Hit, LANES, RayPacket};
use whit::numeric::{Ray, spawn_point};
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Implicit, Shape};

/// Seed of the random numbers.
const SEED: u64 = 41;
/// A crossing at a smaller sine than this touches, and may count as entry or as exit.
const TOUCH: f64 = 1e-6;

/// A ray that starts on a side of a shape's surface: 1 outside, -1 inside.
struct Start {
    ray: Ray,
    side: f64,
}

fn traced(accel: &dyn Accel, starts: &[Start]) -> Vec<Option<Hit>> {
    let mut hits = Vec::new();
    for chunk in starts.chunks(LANES) {
        let mut packets = [RayPacket::EMPTY];
        for (lane, start) in chunk.iter().enumerate() {
            packets[0].set(lane, &start.ray);
        }
        accel.intersect(&mut packets, Coherence::Incoherent);
        hits.extend((0..chunk.len()).map(|lane| packets[0].hit(lane)));
    }
    hits
}

/// The object-space point, normal and direction of a hit.
fn hit_point(instance: &Instance, shape: &Shape, ray: &Ray, hit: &Hit) -> (whit::shape::ShapePoint, DVec3) {
    let inverse = instance.object_from_world();
    let p = inverse.transform_point3(ray.at(hit.t.into()));
    let direction = inverse.transform_vector3(ray.direction.as_dvec3());
    (shape.point(p, hit.primitive), direction.normalize())
}

/// Rays that leave to both sides of the hits of random rays on the shape, many of them along the surface.
fn starts(scene: &Scene, shape: &Shape, count: usize) -> Vec<Start> {
    let mut random = SplitMix64(SEED);
    let instance = &scene.instances[0];
    let (map, inverse) = (instance.world_from_object(), instance.object_from_world());
    let brute = BruteAccel::new(scene);
    let mut all = Vec::new();
    while all.len() < count {
        let target = map.transform_point3(1.2 * random.in_cube());
        let from = map.transform_point3(3.0 * random.on_sphere());
        let ray = Ray::new(from.as_vec3(), (target - from).as_vec3());
        let Some(hit) = brute.nearest(&ray) else { continue };
        let (point, _) = hit_point(instance, shape, &ray, &hit);
        let p = map.transform_point3(point.p);
        let n = whit::numeric::transform_normal(&map.matrix3, point.n);
        let error = point.error.transformed(&map, &inverse, p).along(n);
        for side in [1.0, -1.0] {
            let tangent = random.on_sphere().cross(n);
            let rise = 10f64.powf(-5.0 * random.next());
            let direction = (tangent + rise * side * n).as_vec3();
            // Rounding may turn a grazing direction to the other side.
            if direction.as_dvec3().dot(n) * side > 0.0 {
                let origin = spawn_point(p, side * n, error);
                all.push(Start {
                    ray: Ray::new(origin, direction),
                    side,
                });
            }
        }
    }
    all
}

/// Returns whether the result can be correct: from outside the next crossing of a closed surface enters, from inside it leaves,
/// and there is one.
fn is_sound(instance: &Instance, shape: &Shape, start: &Start, hit: Option<Hit>) -> bool {
    let origin = instance
        .object_from_world()
        .transform_point3(start.ray.origin.as_dvec3());
    if start.side < 0.0 && shape.is_solid() && !shape.contains(origin) {
        // At a sharp edge the inner side of one face may be beyond the other.
        return true;
    }
    let Some(hit) = hit else {
        return start.side > 0.0 || !shape.is_solid();
    };
    let (point, direction) = hit_point(instance, shape, &start.ray, &hit);
    point.n.dot(direction) * start.side <= TOUCH
}

fn backends<'s>(scene: &'s Scene) -> Vec<(&'static str, Box<dyn Accel + 's>)> {
    let options = AccelOptions::default();
    vec![
        ("brute", Box::new(BruteAccel::new(scene))),
        (
            "bsp reference",
            Box::new(BspAccel::build_reference(scene, &options).unwrap()),
        ),
        ("bsp", Box::new(BspAccel::build(scene, &options).unwrap())),
        #[cfg(feature = "embree")]
        (
            "embree",
            Box::new(whit::accel::embree::EmbreeAccel::build(scene, &options).unwrap()),
        ),
    ]
}

fn assert_no_self_intersection(count: usize) {
    let mut wrong = Vec::new();
    for (name, shape) in scenes::all_shapes() {
        let start = Instant::now();
        let (mut ray_count, mut false_count) = (0, 0);
        for (number, map) in scenes::all_placements().into_iter().enumerate() {
            let far = DAffine3::from_translation(DVec3::new(40.0, -30.0, 20.0));
            for map in [map, far * map] {
                let scene = scenes::scene(vec![Geometry::Shape(shape.clone())], vec![(0, map)]);
                let starts = starts(&scene, &shape, count);
                ray_count += starts.len();
                for (backend, accel) in backends(&scene) {
                    let hits = traced(accel.as_ref(), &starts);
                    let bad = starts
                        .iter()
                        .zip(&hits)
                        .filter(|(start, hit)| !is_sound(&scene.instances[0], &shape, start, **hit));
                    let bad: Vec<_> = bad
                        .map(|(start, hit)| format!("{:?} {hit:?}", start.ray))
                        .collect();
                    false_count += bad.len();
                    if let Some(first) = bad.first() {
                        wrong.push(format!(
                            "{name} {number} {backend}: {} such as {first}",
                            bad.len()
                        ));
                    }
                }
            }
        }
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "{name}: {ray_count} rays leave it, {false_count} false hits of all backends, {seconds:.1} s"
        );
    }
    assert!(wrong.is_empty(), "seed {SEED}\n{}", wrong.join("\n"));
}

#[test]
fn spawned_rays_do_not_hit_their_own_surface() {
    assert_no_self_intersection(2_000);
}

#[test]
#[ignore = "slow: a million rays per shape"]
fn a_million_spawned_rays_do_not_hit_their_own_surface() {
    assert_no_self_intersection(100_000);
}
