//! Every backend hits a moving object where it is at the time of the ray; brute force, without boxes, is the reference.

use crate::support::scenes::{self, SplitMix64, packets};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use whit::accel::brute::BruteAccel;
use whit::accel::bsp::BspAccel;
use whit::accel::extents::{BoundingVolumeKind, ListAccel};
use whit::accel::hit_compare::{HitComparison, compare_occlusion_with_instancing, compare_with_instancing};
use whit::accel::{Accel, AccelOptions, Coherence, Hit, Instancing, Kernel, LANES};
use whit::numeric::{Bounds, Ray};
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Shape, Sphere};

/// Rays a scene.
const RAYS: usize = 25_000;

/// A map anywhere near, of about unit size, that stretches and at times mirrors.
fn place(r: &mut SplitMix64, mirror: f64) -> DAffine3 {
    let size = DVec3::new(mirror, 0.4 + r.next(), 0.7) * (0.5 + r.next());
    DAffine3::from_translation(4.0 * r.in_cube())
        * DAffine3::from_axis_angle(r.on_sphere(), 6.0 * r.next())
        * DAffine3::from_scale(size)
}

/// Meshes and shapes, most of which move: along lines, about themselves, and everything at once.
fn scene(with_plane: bool) -> Scene {
    let mut geometries = vec![
        Geometry::Mesh(scenes::bumpy_sphere(5)),
        Geometry::Mesh(scenes::box_mesh(Vec3::splat(-1.0), Vec3::ONE)),
        Geometry::Shape(Shape::Sphere(Sphere::UNIT)),
        Geometry::Shape(Shape::Plane),
        // Beside what they turn about, so that they go along arcs.
        Geometry::Mesh(scenes::box_mesh(
            Vec3::new(2.0, -0.3, -0.2),
            Vec3::new(3.0, 0.3, 0.2),
        )),
        Geometry::Shape(Shape::Sphere(Sphere {
            center: DVec3::new(0.0, 2.5, 0.0),
            radius: 0.5,
        })),
    ];
    geometries.extend(
        scenes::all_shapes()
            .into_iter()
            .map(|(_, shape)| Geometry::Shape(shape)),
    );
    let bounded: Vec<u32> = (0..geometries.len() as u32)
        .filter(|&g| !geometries[g as usize].is_unbounded())
        .collect();
    let mut r = SplitMix64(7);
    let mut instances = Vec::new();
    for number in 0..40 {
        let geometry = bounded[number % bounded.len()];
        let mirror = [1.0, -1.0][number % 2];
        let start = place(&mut r, mirror);
        let end = match number % 5 {
            _ if matches!(geometry, 4 | 5) => start * DAffine3::from_axis_angle(r.on_sphere(), 2.9),
            0 => start,
            1 => DAffine3::from_translation(2.0 * r.in_cube()) * start,
            2 | 3 => start * DAffine3::from_axis_angle(r.on_sphere(), 3.0 * r.next()),
            _ => place(&mut r, mirror),
        };
        instances.push(Instance::moving(format!("{number}"), geometry, 0, [start, end]).unwrap());
    }
    if with_plane {
        let floor = |z: f64, turn: f64| {
            DAffine3::from_translation(DVec3::new(0.0, 0.0, z)) * DAffine3::from_rotation_x(turn)
        };
        for ends in [
            [floor(-5.0, 0.0), floor(-4.0, 0.2)],
            [floor(-4.5, 0.3), floor(-4.5, 0.3)],
        ] {
            instances.push(Instance::moving("plane", 3, 0, ends).unwrap());
        }
    }
    Scene {
        geometries,
        instances,
        ..Scene::default()
    }
}

/// Rays at what is where at the time of each; now and then at the very first or last.
fn rays(scene: &Scene, seed: u64, count: usize) -> Vec<Ray> {
    let mut r = SplitMix64(seed);
    let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
    (0..count)
        .map(|number| {
            let time = match number % 50 {
                0 => 0.0,
                1 => 1.0,
                _ => r.next() as f32,
            };
            let instance = &scene.instances[r.below(scene.instances.len())];
            let object = &bounds[instance.geometry as usize];
            let target = if object.magnitude().is_finite() {
                let inside = object.center() + 0.5 * object.extent() * r.in_cube();
                instance.pose(time).world_from_object().transform_point3(inside)
            } else {
                5.0 * r.in_cube()
            };
            let origin = 7.0 * r.in_cube();
            Ray {
                time,
                ..Ray::new(origin.as_vec3(), (target - origin).as_vec3())
            }
        })
        .collect()
}

fn query_results(accel: &dyn Accel, rays: &[Ray], order: Coherence) -> Vec<(Option<Hit>, bool)> {
    let [mut nearest, mut any] = [packets(rays), packets(rays)];
    nearest
        .par_chunks_mut(64)
        .for_each(|chunk| accel.intersect(chunk, order));
    any.par_chunks_mut(64)
        .for_each(|chunk| accel.occluded(chunk, order));
    (0..rays.len())
        .map(|i| {
            (
                nearest[i / LANES].hit(i % LANES),
                any[i / LANES].is_blocked(i % LANES),
            )
        })
        .collect()
}

fn backends(scene: &Scene) -> Vec<(&'static str, Box<dyn Accel + '_>)> {
    let packet = AccelOptions::default();
    let single = AccelOptions {
        kernel: Kernel::Single,
        ..AccelOptions::default()
    };
    let bsp: Vec<(&'static str, Box<dyn Accel + '_>)> = vec![
        ("bsp", Box::new(BspAccel::build(scene, &packet).unwrap())),
        ("bsp single", Box::new(BspAccel::build(scene, &single).unwrap())),
        (
            "bsp reference",
            Box::new(BspAccel::build_reference(scene, &packet).unwrap()),
        ),
        (
            "list of boxes",
            Box::new(ListAccel::new(scene, BoundingVolumeKind::Box)),
        ),
    ];
    bsp.into_iter()
        .chain(embree_backends(scene, [packet, single]))
        .collect()
}

#[cfg(feature = "embree")]
fn embree_backends<'s>(
    scene: &'s Scene,
    [packet, single]: [AccelOptions<'static>; 2],
) -> Vec<(&'static str, Box<dyn Accel + 's>)> {
    use whit::accel::embree::EmbreeAccel;
    let native = AccelOptions {
        instancing: Instancing::Native,
        ..packet.clone()
    };
    let build = |options: AccelOptions| -> Box<dyn Accel + 's> {
        Box::new(EmbreeAccel::build(scene, &options).unwrap())
    };
    vec![
        ("embree", build(packet)),
        ("embree single", build(single)),
        ("embree native", build(native)),
    ]
}

#[cfg(not(feature = "embree"))]
fn embree_backends(_: &Scene, _: [AccelOptions; 2]) -> Vec<(&'static str, Box<dyn Accel>)> {
    Vec::new()
}

#[test]
fn every_backend_hits_moving_objects_like_brute_force() {
    compare_with_brute_force(RAYS);
}

#[test]
#[ignore = "slow: a hundred thousand rays"]
fn every_backend_hits_moving_objects_like_brute_force_for_many_rays() {
    compare_with_brute_force(100_000);
}

fn compare_with_brute_force(ray_count: usize) {
    for (with_plane, count) in [(false, ray_count / 5), (true, ray_count)] {
        let scene = scene(with_plane);
        scene_is_worth_it(&scene);
        let rays = &rays(&scene, 3, count)[..];
        let brute = query_results(&BruteAccel::new(&scene), rays, Coherence::Incoherent);
        for (name, accel) in backends(&scene) {
            let instancing = if name == "embree native" {
                Instancing::Native
            } else {
                Instancing::Callback
            };
            for order in [Coherence::Coherent, Coherence::Incoherent] {
                let found = query_results(&*accel, rays, order);
                let mut counts = [0; 2];
                for ((ray, a), b) in rays.iter().zip(&brute).zip(&found) {
                    let hits = compare_with_instancing(&scene, ray, [a.0, b.0], instancing);
                    let shadows = compare_occlusion_with_instancing(&scene, ray, [a.1, b.1], instancing);
                    assert_ne!(
                        hits,
                        HitComparison::Wrong,
                        "{name} {order:?} {ray:?}: {a:?} {b:?}"
                    );
                    assert_ne!(
                        shadows,
                        HitComparison::Wrong,
                        "{name} {order:?} {ray:?}: {a:?} {b:?}"
                    );
                    counts[usize::from(hits == HitComparison::Tie)] += 1;
                }
                println!("{name} {order:?}: {counts:?} same and tied of {}", rays.len());
                assert!(counts[1] * 1000 < rays.len(), "{name}: {counts:?}");
            }
        }
    }
}

/// Many rays hit many moving objects, and the hits depend on the time.
fn scene_is_worth_it(scene: &Scene) {
    let brute = BruteAccel::new(scene);
    let rays = &rays(scene, 11, 5000);
    let at = |time: f32| -> Vec<Option<u32>> {
        let still = rays.iter().map(|ray| Ray { time, ..*ray });
        still
            .map(|ray| brute.nearest(&ray).map(|hit| hit.instance))
            .collect()
    };
    let (start, end) = (at(0.0), at(1.0));
    let changed = start.iter().zip(&end).filter(|(a, b)| a != b).count();
    let hit_count = start.iter().flatten().count();
    assert!(
        hit_count * 3 > rays.len() && changed * 5 > rays.len(),
        "{hit_count} hits, {changed} changed"
    );
}

#[test]
fn frozen_scene_equals_static_scene() {
    let moving = scene(true);
    let time = 0.375;
    let mut still = moving.clone();
    for instance in &mut still.instances {
        let map = instance.pose(time).world_from_object();
        instance.place(map).unwrap();
    }
    let rays: Vec<Ray> = rays(&moving, 13, 20_000)
        .iter()
        .map(|ray| Ray { time, ..*ray })
        .collect();
    let a = query_results(
        &BspAccel::build(&moving, &AccelOptions::default()).unwrap(),
        &rays,
        Coherence::Incoherent,
    );
    let b = query_results(
        &BspAccel::build(&still, &AccelOptions::default()).unwrap(),
        &rays,
        Coherence::Incoherent,
    );
    assert!(a.iter().flat_map(|(hit, _)| hit).count() > rays.len() / 3);
    assert_eq!(a, b);
}
