//! All backends and all kernels return the same results: nothing wrong, ties counted.
//!
//! The large versions, with their counts: `tests/ci/slow agreement`.

use std::time::Instant;

use crate::support::scenes::{self, SplitMix64, packets};
use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;
use whit::accel::brute::BruteAccel;
use whit::accel::bsp::BspAccel;
use whit::accel::hit_compare::{HitComparison, compare_occlusion_with_instancing, compare_with_instancing};
use whit::accel::native::NativeAccel;
use whit::accel::{Accel, AccelOptions, Coherence, Hit, Instancing, Kernel, LANES, RayEnd, RayPacket};
use whit::numeric::Ray;
use whit::scene::{Geometry, Scene};
use whit::shape::{Implicit, Shape};

/// Rays a scene: a square of pixels, their shadows, random rays, rays along the axes.
const FILM: usize = 240;
const RANDOM_COUNT: usize = 40_000;

/// Packets whose lanes point every way, with some lanes off.
fn shuffled(rays: &[Ray], seed: u64) -> Vec<Ray> {
    let mut random = SplitMix64(seed);
    let mut rays = rays.to_vec();
    for i in (1..rays.len()).rev() {
        rays.swap(i, random.below(i + 1));
    }
    rays
}

pub(super) fn nearest(accel: &dyn Accel, rays: &[Ray], order: Coherence) -> Vec<Option<Hit>> {
    let mut packets = packets(rays);
    packets
        .par_chunks_mut(64)
        .for_each(|chunk| accel.intersect(chunk, order));
    (0..rays.len())
        .map(|i| packets[i / LANES].hit(i % LANES))
        .collect()
}

pub(super) fn blocked(accel: &dyn Accel, rays: &[Ray], order: Coherence) -> Vec<bool> {
    blocked_by((rays, 64), &|chunk| accel.occluded(chunk, order))
}

/// Traces rays in batches of some packets by `occluded`.
fn blocked_by((rays, batch): (&[Ray], usize), occluded: &(dyn Fn(&mut [RayPacket]) + Sync)) -> Vec<bool> {
    let mut packets = packets(rays);
    packets.par_chunks_mut(batch).for_each(occluded);
    (0..rays.len())
        .map(|i| packets[i / LANES].is_blocked(i % LANES))
        .collect()
}

pub(super) fn backends<'s>(scene: &'s Scene) -> Vec<(&'static str, Box<dyn Accel + 's>)> {
    let single = AccelOptions {
        kernel: Kernel::Single,
        ..AccelOptions::default()
    };
    let packet = AccelOptions::default();
    let bsp: Vec<(&'static str, Box<dyn Accel + 's>)> = vec![
        (
            "bsp reference",
            Box::new(BspAccel::build_reference(scene, &packet).unwrap()),
        ),
        ("bsp single", Box::new(BspAccel::build(scene, &single).unwrap())),
        ("bsp packet", Box::new(BspAccel::build(scene, &packet).unwrap())),
        (
            "native single",
            Box::new(NativeAccel::build(scene, &single).unwrap()),
        ),
        ("native", Box::new(NativeAccel::build(scene, &packet).unwrap())),
    ];
    bsp.into_iter()
        .chain(embree_backends(scene, [single, packet]))
        .collect()
}

#[cfg(feature = "embree")]
fn embree_backends<'s>(
    scene: &'s Scene,
    [single, packet]: [AccelOptions<'static>; 2],
) -> Vec<(&'static str, Box<dyn Accel + 's>)> {
    use whit::accel::embree::EmbreeAccel;
    use whit::accel::{RayForecast, auto};
    let native = |options: &AccelOptions<'static>| AccelOptions {
        instancing: Instancing::Native,
        ..options.clone()
    };
    let build = |options: &AccelOptions| -> Box<dyn Accel + 's> {
        Box::new(EmbreeAccel::build(scene, options).unwrap())
    };
    let watertight = AccelOptions {
        precision: whit::accel::Precision::Watertight,
        ..packet.clone()
    };
    // So many coherent rays without a common end that they get Embree's structure beside the native tree
    let both = AccelOptions {
        rays: RayForecast {
            coherent: 1e12,
            ..RayForecast::default()
        },
        ..packet.clone()
    };
    vec![
        ("auto", auto::build(scene, &both).unwrap()),
        ("embree watertight", build(&watertight)),
        ("embree single", build(&single)),
        ("embree packet", build(&packet)),
        ("embree native single", build(&native(&single))),
        ("embree native packet", build(&native(&packet))),
    ]
}

#[cfg(not(feature = "embree"))]
fn embree_backends(_: &Scene, _: [AccelOptions; 2]) -> Vec<(&'static str, Box<dyn Accel>)> {
    Vec::new()
}

#[derive(Default)]
struct Tally {
    same: usize,
    tie: usize,
    wrong: Vec<String>,
}

impl Tally {
    fn add(&mut self, agreement: HitComparison, describe: impl FnOnce() -> String) {
        match agreement {
            HitComparison::Same => self.same += 1,
            HitComparison::Tie => self.tie += 1,
            HitComparison::Wrong => self.wrong.push(describe()),
        }
    }

    fn merge(&mut self, other: Tally, kind: &str) {
        self.same += other.same;
        self.tie += other.tie;
        self.wrong
            .extend(other.wrong.iter().map(|w| format!("{kind}: {w}")));
    }
}

/// Traces nearest-hit and any-hit queries through both structures and counts the differences.
fn judge(
    scene: &Scene,
    truth: (&[Option<Hit>], &[bool]),
    (name, accel): (&str, &dyn Accel),
    rays: &[Ray],
    order: Coherence,
) -> Tally {
    let instancing = if name.starts_with("embree native") {
        Instancing::Native
    } else {
        Instancing::Callback
    };
    let mut tally = Tally::default();
    for ((ray, &a), b) in rays.iter().zip(truth.0).zip(nearest(accel, rays, order)) {
        tally.add(compare_with_instancing(scene, ray, [a, b], instancing), || {
            format!("{ray:?}: {a:?} but {b:?}")
        });
    }
    for ((ray, &a), b) in rays.iter().zip(truth.1).zip(blocked(accel, rays, order)) {
        tally.add(
            compare_occlusion_with_instancing(scene, ray, [a, b], instancing),
            || format!("{ray:?}: blocked {a} but {b}"),
        );
    }
    tally
}

/// Traces shadow rays that have their end in common, and counts the differences.
fn judge_towards(scene: &Scene, truth: &[bool], accel: &dyn Accel, rays: &[Ray]) -> Tally {
    let mut tally = Tally::default();
    let Some(first) = rays.first() else { return tally };
    let end = match first.t_far {
        f32::INFINITY => RayEnd::Direction(first.direction),
        _ => RayEnd::Point(first.at(1.0).as_vec3()),
    };
    // A group must not see what a larger one has left behind.
    for batch in [64, 8, 1] {
        let found = blocked_by((rays, batch), &|chunk| accel.occluded_towards(chunk, end));
        for ((ray, &a), b) in rays.iter().zip(truth).zip(found) {
            // Traced in the frame of its group, a ray is rounded elsewhere, as between native instances.
            let compared = compare_occlusion_with_instancing(scene, ray, [a, b], Instancing::Native);
            tally.add(compared, || format!("{ray:?}: blocked {a} but {b}"));
        }
    }
    tally
}

/// Rays of all kinds: a square film's and their shadows, and `count` of each other kind.
fn batches(
    scene: &Scene,
    brute: &BruteAccel,
    film: usize,
    count: usize,
) -> Vec<(&'static str, Coherence, Vec<Ray>)> {
    let camera = scenes::camera_rays(scene, film);
    let hits: Vec<_> = nearest(brute, &camera, Coherence::Coherent)
        .iter()
        .map(|hit| hit.map(|h| h.t))
        .collect();
    let shadow = scenes::shadow_rays(scene, &camera, &hits);
    let along_axis = scenes::parallel_shadow_rays(&camera, &hits, DVec3::Y);
    let along_direction = scenes::parallel_shadow_rays(&camera, &hits, DVec3::new(0.3, 0.8, -0.52));
    let random = scenes::random_rays(scene, count, 17);
    let lattice = scenes::lattice_rays(scene, count, 23);
    let mixed = shuffled(&[&camera[..film], &random[..film], &lattice[..film]].concat(), 29);
    vec![
        ("camera", Coherence::Coherent, camera),
        ("shadow", Coherence::Coherent, shadow),
        ("shadow along an axis", Coherence::Coherent, along_axis),
        ("shadow along a direction", Coherence::Coherent, along_direction),
        ("random", Coherence::Incoherent, random),
        ("lattice", Coherence::Incoherent, lattice),
        ("by octant", Coherence::Coherent, by_octant(&mixed)),
        ("mixed", Coherence::Coherent, mixed),
    ]
}

/// The rays sorted by the signs of their directions, so that packets hold unlike rays of one octant.
fn by_octant(rays: &[Ray]) -> Vec<Ray> {
    let mut sorted = rays.to_vec();
    sorted.sort_by_key(|ray| ray.direction.to_array().map(f32::is_sign_negative));
    sorted
}

/// Traces all batches through all backends and prints the counts; returns how many rays there were, and what was wrong.
pub(super) fn compare_all(name: &str, scene: &Scene, film: usize, count: usize) -> (usize, Vec<String>) {
    let (mut ray_count, mut wrong) = (0, Vec::new());
    let brute = BruteAccel::new(scene);
    let backends = backends(scene);
    let mut sums: Vec<Tally> = backends.iter().map(|_| Tally::default()).collect();
    for (kind, order, rays) in batches(scene, &brute, film, count) {
        ray_count += rays.len();
        let hits = nearest(&brute, &rays, order);
        // Brute force is occluded by what it hits; tracing it again would double the time.
        let shadows: Vec<bool> = hits.iter().map(Option::is_some).collect();
        for ((name, accel), sum) in backends.iter().zip(&mut sums) {
            sum.merge(
                judge(scene, (&hits, &shadows), (name, accel.as_ref()), &rays, order),
                kind,
            );
            if kind.starts_with("shadow") {
                let towards = judge_towards(scene, &shadows, accel.as_ref(), &rays);
                sum.merge(towards, &format!("{kind}, towards"));
            }
        }
    }
    for ((backend, _), sum) in backends.iter().zip(sums) {
        let Tally {
            same,
            tie,
            wrong: bad,
        } = sum;
        println!("{name}, {backend}: {same} same, {tie} ties, {} wrong", bad.len());
        wrong.extend(bad.iter().take(3).map(|w| format!("{name}, {backend}, {w}")));
    }
    (ray_count, wrong)
}

/// Compares all backends on camera and random rays through seven scenes, and returns the number of rays.
fn compare_scenes(film: usize, random_count: usize) -> usize {
    let mut ray_count = 0;
    let mut wrong = Vec::new();
    for (name, scene) in scenes::all_small() {
        let (count, bad) = compare_all(name, &scene, film, random_count);
        ray_count += count;
        wrong.extend(bad);
    }
    println!("{ray_count} rays");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    ray_count
}

#[test]
fn all_backends_agree_over_seven_scenes() {
    assert!(compare_scenes(FILM / 3, RANDOM_COUNT / 8) >= 100_000);
}

#[test]
#[ignore = "slow: a million rays"]
fn all_backends_agree_on_a_million_rays_over_seven_scenes() {
    assert!(compare_scenes(FILM, RANDOM_COUNT) >= 1_000_000);
}

/// Meshes mirrored, turned, stretched and sheared at random, some far more in one direction than in another, near and
/// far from the origin.
fn placed_at_random(seed: u64) -> Scene {
    let mut random = SplitMix64(seed);
    let meshes = [
        scenes::bumpy_sphere(5),
        scenes::box_lattice(2),
        scenes::thin_soup(40),
    ];
    let places = (0..40).map(|i| {
        let turn = |random: &mut SplitMix64| DQuat::from_axis_angle(random.on_sphere(), 6.0 * random.next());
        // Up to a factor of 64 between two axes: both sides of what Embree is left to place.
        let mut stretch = DVec3::from_array([0, 1, 2].map(|_| 0.2 * 64f64.powf(random.next() - 0.5)));
        if i % 3 == 0 {
            stretch.x = -stretch.x;
        }
        let at = DVec3::splat(10.0 * (seed % 3) as f64) + 3.0 * random.in_cube();
        let placed = DAffine3::from_scale_rotation_translation(stretch, turn(&mut random), at);
        (i % 3, placed * DAffine3::from_quat(turn(&mut random)))
    });
    scenes::scene(meshes.map(Geometry::Mesh).into(), places.collect())
}

#[test]
fn all_backends_agree_on_randomly_placed_meshes() {
    let mut wrong = Vec::new();
    for seed in 0..3 {
        let name = format!("placed at random, seed {seed}");
        wrong.extend(compare_all(&name, &placed_at_random(seed), 40, 1_500).1);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Every shape, in all placements, is found alike.
fn compare_shapes(film: usize, count: usize) {
    let mut wrong = Vec::new();
    for (name, shape) in scenes::all_shapes() {
        wrong.extend(compare_all(name, &scenes::placed_shape(shape), film, count).1);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn all_backends_agree_on_every_shape_with_any_transform() {
    compare_shapes(50, 2_000);
}

#[test]
#[ignore = "slow: a million rays per shape"]
fn all_backends_agree_on_a_million_rays_per_shape() {
    compare_shapes(400, 400_000);
}

/// A random ray that starts inside the placed shape, in the box around it where it has no inside.
fn ray_from_inside(random: &mut SplitMix64, map: &DAffine3, shape: &Shape) -> Ray {
    loop {
        let origin = map.transform_point3(random.in_cube()).as_vec3();
        let p_object = map.inverse().transform_point3(origin.as_dvec3());
        if !shape.is_solid() || shape.contains(p_object) {
            return Ray::new(origin, map.transform_vector3(random.on_sphere()).as_vec3());
        }
    }
}

/// A random ray that starts outside the placed shape and goes to or past it.
fn ray_from_outside(random: &mut SplitMix64, map: &DAffine3, shape: &Shape) -> Ray {
    loop {
        let reach = 10f64.powf(3.0 * random.next());
        let origin = map.transform_point3(reach * random.in_cube()).as_vec3();
        let p_object = map.inverse().transform_point3(origin.as_dvec3());
        if !shape.contains(p_object) {
            let target = map.transform_point3(1.2 * random.in_cube());
            return Ray::new(origin, (target - origin.as_dvec3()).as_vec3());
        }
    }
}

/// Every shape in every placement, alone: `count` rays from inside and as many from outside a placement.
fn compare_inside_and_outside(count: usize) {
    let mut wrong = Vec::new();
    for (name, shape) in scenes::all_shapes() {
        let start = Instant::now();
        let mut random = SplitMix64(43);
        let (mut ray_count, mut hit_count, mut bad) = (0, 0, 0);
        for map in scenes::all_placements() {
            let scene = scenes::scene(vec![Geometry::Shape(shape.clone())], vec![(0, map)]);
            let inside = (0..count).map(|_| ray_from_inside(&mut random, &map, &shape));
            let mut rays: Vec<Ray> = inside.collect();
            rays.extend((0..count).map(|_| ray_from_outside(&mut random, &map, &shape)));
            let hits = nearest(&BruteAccel::new(&scene), &rays, Coherence::Incoherent);
            let shadows: Vec<bool> = hits.iter().map(Option::is_some).collect();
            ray_count += rays.len();
            hit_count += shadows.iter().filter(|&&is_blocked| is_blocked).count();
            for (backend, accel) in backends(&scene) {
                let tally = judge(
                    &scene,
                    (&hits, &shadows),
                    (backend, accel.as_ref()),
                    &rays,
                    Coherence::Incoherent,
                );
                bad += tally.wrong.len() + tally.tie;
                wrong.extend(
                    tally
                        .wrong
                        .into_iter()
                        .take(3)
                        .map(|w| format!("{name}, {backend}: {w}")),
                );
            }
        }
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "{name}: {ray_count} rays, half from inside, {hit_count} hit it; {bad} wrong or tied, {seconds:.1} s"
        );
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn all_backends_agree_on_random_rays_at_every_shape() {
    compare_inside_and_outside(1_000);
}

#[test]
#[ignore = "slow: a million rays per shape"]
fn all_backends_agree_on_a_million_random_rays_at_every_shape() {
    compare_inside_and_outside(100_000);
}

#[test]
fn one_and_two_build_threads_give_the_same_bits() {
    let scene = scenes::baked(scenes::bumpy_sphere(60));
    let rays = scenes::random_rays(&scene, 20_000, 31);
    let by = |threads| {
        let options = AccelOptions {
            threads,
            ..AccelOptions::default()
        };
        nearest(
            &BspAccel::build(&scene, &options).unwrap(),
            &rays,
            Coherence::Incoherent,
        )
    };
    assert_eq!(by(1), by(2));
}

#[test]
fn invalid_rays_are_left_unchanged() {
    let scene = scenes::baked(scenes::bumpy_sphere(8));
    let mut all = backends(&scene);
    all.push(("brute", Box::new(BruteAccel::new(&scene))));
    let good = Ray::new(glam::Vec3::ZERO, glam::Vec3::X);
    let bad = [
        Ray {
            origin: glam::Vec3::NAN,
            ..good
        },
        Ray {
            direction: glam::Vec3::ZERO,
            ..good
        },
        Ray {
            direction: glam::Vec3::splat(f32::INFINITY),
            ..good
        },
        Ray { t_far: -1.0, ..good },
    ];
    for (backend, accel) in all {
        assert_eq!(
            nearest(accel.as_ref(), &bad, Coherence::Coherent),
            [None; 4],
            "{backend}"
        );
        assert_eq!(
            blocked(accel.as_ref(), &bad, Coherence::Incoherent),
            [false; 4],
            "{backend}"
        );
        assert!(
            nearest(accel.as_ref(), &[good], Coherence::Coherent)[0].is_some(),
            "{backend}"
        );
    }
}
