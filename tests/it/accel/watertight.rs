//! Embree's watertight triangles: no ray at a corner or an edge of a closed mesh is lost, and every answer is the one of
//! brute force.
//!
//! With `WHIT_WATERTIGHT_RAYS` that many rays are aimed at the corners and as many at the edges of each mesh, by each
//! instruction set: `WHIT_WATERTIGHT_RAYS=100000000 tests/ci/slow watertight`.
//! `WHIT_ISAS=sse2,avx2` tests these alone.

use crate::support::scenes::{
    SplitMix64, all_small, baked, bumpy_sphere, camera_rays, lattice_rays, mesh, packets, random_rays,
};
use glam::{DAffine3, DQuat, DVec3, Vec3};
use rayon::prelude::*;
use whit::accel::brute::BruteAccel;
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelError, AccelOptions, Coherence, Kernel, LANES, Precision, RayPacket};
use whit::mesh::Mesh;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};

const ALL_ISAS: [&str; 5] = ["sse2", "sse4.2", "avx", "avx2", "avx512"];
/// Rays of a default run at the corners of each mesh, and as many at its edges, by each variant.
const DEFAULT_RAYS: usize = 2048;
/// Rays that are traced at once.
const BATCH: usize = 1 << 12;

/// None where the processor lacks the instruction set.
fn build<'s>(
    scene: &'s Scene,
    precision: Precision,
    (isa, kernel): (&str, Kernel),
) -> Option<EmbreeAccel<'s>> {
    let options = AccelOptions {
        precision,
        kernel,
        isa: Some(isa.to_owned()),
        ..AccelOptions::default()
    };
    match EmbreeAccel::build(scene, &options) {
        Err(AccelError::Embree { message, .. }) if message.contains("this processor has no") => None,
        built => Some(built.unwrap()),
    }
}

fn mapped(mesh_in: &Mesh, map: impl Fn(DVec3) -> DVec3) -> Mesh {
    let moved = |p: &[f32; 3]| map(Vec3::from(*p).as_dvec3()).as_vec3().to_array();
    mesh(
        mesh_in.positions.iter().map(moved).collect(),
        mesh_in.triangles.to_vec(),
    )
}

/// A closed mesh, and a point from which all of its surface is seen.
struct Closed {
    name: &'static str,
    scene: Scene,
    middle: DVec3,
    /// Largest distance from there at which rays start.
    radius: f64,
}

/// The corners of a baked mesh, or of one that stands elsewhere, at the time of the ray.
fn corners_of(scene: &Scene, primitive: usize, time: f32) -> [DVec3; 3] {
    let instance = &scene.instances[0];
    let Geometry::Mesh(mesh) = &scene.geometries[instance.geometry as usize] else {
        unreachable!("the scene is of a mesh")
    };
    let map = instance.pose(time).world_from_object();
    mesh.corners_f64(primitive as u32)
        .map(|p| map.transform_point3(p))
}

/// A ball, one far from the origin, one drawn out to slivers, and one whose corners have whole coordinates.
fn closed_meshes() -> Vec<Closed> {
    let ball = bumpy_sphere(40);
    let far = DVec3::new(100.0, 37.0, -55.0);
    let stretch = DVec3::new(1.0, 0.004, 30.0);
    let baked_at = |name, mesh, middle, radius| Closed {
        name,
        scene: baked(mesh),
        middle,
        radius,
    };
    vec![
        baked_at("ball", mapped(&ball, |p| p), DVec3::ZERO, 0.1),
        baked_at("far ball", mapped(&ball, |p| p + far), far, 0.1),
        baked_at("slivers", mapped(&ball, |p| p * stretch), DVec3::ZERO, 0.0004),
        baked_at(
            "whole coordinates",
            mapped(&bumpy_sphere(24), |p| (64.0 * p.normalize()).round()),
            DVec3::ZERO,
            1.0,
        ),
    ]
}

/// The ball turned, stretched and far off, and the same moving.
fn placed_meshes() -> Vec<Closed> {
    let place = |turn: f64, x: f64| {
        let turn = DQuat::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), turn);
        let scale = DVec3::new(3.0, 2.0, -2.5);
        DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(x, 20.0, -30.0))
    };
    let of = |name, instance, middle| Closed {
        name,
        scene: Scene {
            geometries: vec![Geometry::Mesh(bumpy_sphere(40))],
            instances: vec![instance],
            ..Scene::default()
        },
        middle,
        radius: 0.2,
    };
    vec![
        of(
            "placed",
            Instance::new("", 0, 0, place(0.7, 50.0)).unwrap(),
            DVec3::new(50.0, 20.0, -30.0),
        ),
        of(
            "moving",
            Instance::moving("", 0, 0, [place(0.7, 50.0), place(2.3, 50.5)]).unwrap(),
            DVec3::new(50.25, 20.0, -30.0),
        ),
    ]
}

/// Features that rays are aimed at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    Corner,
    Edge,
}

/// Rays from near the middle, sixteen in a row at neighbouring triangles.
fn aimed(closed: &Closed, target: Target, (count, seed): (usize, u64)) -> Vec<Ray> {
    let mut random = SplitMix64(seed);
    let Geometry::Mesh(mesh) = &closed.scene.geometries[0] else {
        unreachable!("the scene is of a mesh")
    };
    let triangle_count = mesh.triangles.len();
    let mut first = 0;
    let ray = |i: usize| {
        if i.is_multiple_of(LANES) {
            first = random.below(triangle_count);
        }
        let time = random.next() as f32;
        let [a, b, _] = corners_of(&closed.scene, (first + i % LANES) % triangle_count, time);
        let origin = (closed.middle + closed.radius * random.in_cube()).as_vec3();
        let at = match target {
            Target::Corner => a,
            Target::Edge => a.lerp(b, random.next()),
        };
        let direction = (at - origin.as_dvec3()) * 2f64.powi((i / LANES % 5) as i32 - 2);
        Ray {
            time,
            ..Ray::new(origin, direction.as_vec3())
        }
    };
    (0..count).map(ray).collect()
}

/// Rays that miss, and those that are not occluded, traced in both orders.
fn leaks(accel: &EmbreeAccel, rays: &[Ray]) -> usize {
    let untraced = packets(rays);
    let mut leaks = 0;
    for order in [Coherence::Coherent, Coherence::Incoherent] {
        let (mut nearest, mut any) = (untraced.clone(), untraced.clone());
        accel.intersect(&mut nearest, order);
        accel.occluded(&mut any, order);
        let lost = |is_hit: &dyn Fn(&RayPacket, usize) -> bool, packets: &[RayPacket]| {
            let lanes = (0..rays.len()).filter(|&i| !is_hit(&packets[i / LANES], i % LANES));
            lanes.count()
        };
        leaks += lost(&|packet, lane| packet.hit(lane).is_some(), &nearest);
        leaks += lost(&|packet, lane| packet.is_blocked(lane), &any);
    }
    leaks
}

fn count_leaks(closed: &Closed, target: Target, accel: &EmbreeAccel, ray_count: usize) -> usize {
    let batches = (0..ray_count.div_ceil(BATCH) as u64).into_par_iter();
    batches
        .map(|batch| {
            let count = BATCH.min(ray_count - batch as usize * BATCH);
            leaks(accel, &aimed(closed, target, (count, 0x5eed + batch)))
        })
        .sum()
}

fn assert_tight(meshes: &[Closed], ray_count: usize, kernels: &[Kernel]) {
    let wish = std::env::var("WHIT_ISAS").ok();
    let is_wished = |isa: &str| {
        wish.as_deref()
            .is_none_or(|all| all.split(',').any(|one| one == isa))
    };
    for closed in meshes {
        for isa in ALL_ISAS.into_iter().filter(|isa| is_wished(isa)) {
            for &kernel in kernels {
                let Some(accel) = build(&closed.scene, Precision::Watertight, (isa, kernel)) else {
                    continue;
                };
                for target in [Target::Corner, Target::Edge] {
                    let leaks = count_leaks(closed, target, &accel, ray_count);
                    if ray_count > DEFAULT_RAYS {
                        println!(
                            "{}, {isa}, {kernel:?}: {leaks} of {ray_count} at each {target:?}",
                            closed.name
                        );
                    }
                    assert_eq!(leaks, 0, "{}, {isa}, {kernel:?}, {target:?}", closed.name);
                }
            }
        }
    }
}

#[test]
fn closed_meshes_are_watertight_for_every_instruction_set() {
    assert_tight(&closed_meshes(), DEFAULT_RAYS, &[Kernel::Packet, Kernel::Single]);
}

#[test]
fn instanced_and_moving_meshes_are_watertight() {
    assert_tight(&placed_meshes(), DEFAULT_RAYS, &[Kernel::Packet, Kernel::Single]);
}

#[test]
#[ignore = "slow: as many rays as WHIT_WATERTIGHT_RAYS says"]
fn closed_meshes_are_watertight_for_many_rays() {
    let words = std::env::var("WHIT_WATERTIGHT_RAYS").unwrap_or_else(|_| "1000000".to_owned());
    let ray_count = words.parse().expect("WHIT_WATERTIGHT_RAYS is a number of rays");
    assert_tight(&closed_meshes(), ray_count, &[Kernel::Packet]);
    assert_tight(&placed_meshes(), ray_count, &[Kernel::Packet]);
}

#[test]
fn robust_triangles_leak_at_corners() {
    let closed = &closed_meshes()[0];
    let robust = build(&closed.scene, Precision::Robust, ("avx2", Kernel::Packet));
    // A processor without the instruction set has nothing to show.
    let Some(robust) = robust else { return };
    assert!(count_leaks(closed, Target::Corner, &robust, 32 * DEFAULT_RAYS) > 0);
}

/// The results for `rays` must be those of brute force to the bit, except for the sign of a zero parameter.
fn assert_equals_brute_force(name: &str, scene: &Scene, rays: &[Ray]) {
    let mut untraced = packets(rays);
    for packet in &mut untraced {
        packet.drop_untraceable();
    }
    let brute = BruteAccel::new(scene);
    let (mut nearest, mut any) = (untraced.clone(), untraced.clone());
    nearest
        .par_iter_mut()
        .for_each(|packet| brute.intersect(std::slice::from_mut(packet), Coherence::Incoherent));
    any.par_iter_mut()
        .for_each(|packet| brute.occluded(std::slice::from_mut(packet), Coherence::Incoherent));
    for (isa, kernel) in ALL_ISAS
        .into_iter()
        .flat_map(|isa| [(isa, Kernel::Packet), (isa, Kernel::Single)])
    {
        let Some(accel) = build(scene, Precision::Watertight, (isa, kernel)) else {
            continue;
        };
        for order in [Coherence::Coherent, Coherence::Incoherent] {
            let (mut found, mut blocked) = (untraced.clone(), untraced.clone());
            found
                .par_chunks_mut(64)
                .for_each(|chunk| accel.intersect(chunk, order));
            blocked
                .par_chunks_mut(64)
                .for_each(|chunk| accel.occluded(chunk, order));
            for (i, ray) in rays.iter().enumerate() {
                let (packet, lane) = (i / LANES, i % LANES);
                let context = || format!("{name}, {isa}, {kernel:?}, {order:?}: {ray:?}");
                let hits = [&found, &nearest].map(|packets| packets[packet].hit(lane));
                assert_eq!(hits[0], hits[1], "{}", context());
                let is_blocked = [&blocked, &any].map(|packets| packets[packet].is_blocked(lane));
                assert_eq!(is_blocked[0], is_blocked[1], "{}", context());
            }
        }
    }
}

fn rays_of_all_kinds(scene: &Scene) -> Vec<Ray> {
    [
        camera_rays(scene, 32),
        random_rays(scene, 512, 7),
        lattice_rays(scene, 512, 11),
    ]
    .concat()
}

#[test]
fn watertight_results_equal_brute_force() {
    for (name, scene) in all_small() {
        assert_equals_brute_force(name, &scene, &rays_of_all_kinds(&scene));
    }
}

#[test]
fn watertight_ties_equal_brute_force() {
    for closed in closed_meshes() {
        let mut rays = aimed(&closed, Target::Corner, (512, 3));
        rays.extend(aimed(&closed, Target::Edge, (512, 5)));
        assert_equals_brute_force(closed.name, &closed.scene, &rays);
    }
}

#[test]
fn watertight_moving_meshes_equal_brute_force() {
    let mut closed = placed_meshes().remove(1);
    let turned = closed.scene.instances[0].pose(0.5).world_from_object();
    closed
        .scene
        .instances
        .push(Instance::new("", 0, 0, turned).unwrap());
    closed
        .scene
        .instances
        .push(Instance::new("", 0, 0, DAffine3::IDENTITY).unwrap());
    let mut rays = aimed(&closed, Target::Corner, (512, 3));
    for (i, ray) in camera_rays(&closed.scene, 32).into_iter().enumerate() {
        rays.push(Ray {
            time: (i % 7) as f32 / 7.0,
            ..ray
        });
    }
    assert_equals_brute_force(closed.name, &closed.scene, &rays);
}
