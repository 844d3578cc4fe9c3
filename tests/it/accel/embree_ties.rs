//! Of triangles that coincide Embree finds the one of the lowest instance and primitive, as everybody does.

use glam::{DAffine3, DVec3, Vec3};
use whit::accel::brute::BruteAccel;
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelError, AccelOptions, Coherence, Kernel, LANES, Precision, RayPacket};
use whit::buffer::Buffer;
use whit::mesh::Mesh;
use whit::numeric::Ray;
use whit::scene::{Geometry, Instance, Scene};

/// A square of side 1 in the plane z = 1, with `zero` for 0.
fn square(zero: f32, triangles: Vec<[u32; 3]>) -> Geometry {
    let corners = vec![
        [zero, zero, 1.0],
        [1.0, zero, 1.0],
        [1.0, 1.0, 1.0],
        [zero, 1.0, 1.0],
    ];
    Geometry::Mesh(Mesh {
        positions: Buffer::from(corners),
        triangles: Buffer::from(triangles),
        ..Mesh::default()
    })
}

/// Both halves of the square in all orders of their corners, the given one first.
fn all_orders() -> Vec<[u32; 3]> {
    let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let halves = [[0, 1, 2], [0, 2, 3]];
    let turned = |order: [usize; 3]| halves.map(|half: [u32; 3]| order.map(|corner| half[corner]));
    orders.into_iter().flat_map(turned).collect()
}

fn scene(geometries: Vec<Geometry>, placed: &[(u32, DAffine3)]) -> Scene {
    let instances = placed
        .iter()
        .map(|&(geometry, map)| Instance::new("", geometry, 0, map).unwrap());
    Scene {
        geometries,
        instances: instances.collect(),
        ..Scene::default()
    }
}

/// Straight down on 16 x 16 points of the square at `x`, none on its diagonal; all numbers are exact in binary.
fn rays(x: f32) -> Vec<Ray> {
    let at = |i: u32, offset: f32| (i as f32 + offset) / 16.0;
    let point = |i: u32| Vec3::new(x + at(i % 16, 0.25), at(i / 16, 0.5), 4.0);
    (0..256).map(|i| Ray::new(point(i), Vec3::NEG_Z)).collect()
}

/// Checks that every instruction set, kernel and precision of Embree finds the hits of brute force.
fn check(scene: &Scene, rays: &[Ray]) {
    let brute = BruteAccel::new(scene);
    let id = |hit: whit::accel::Hit| (hit.instance, hit.primitive);
    let expected: Vec<_> = rays.iter().map(|ray| brute.nearest(ray).map(id)).collect();
    assert!(
        expected
            .iter()
            .all(|found| found.is_some_and(|(_, primitive)| primitive < 2))
    );
    for isa in ["sse2", "sse4.2", "avx", "avx2", "avx512"] {
        for (kernel, precision) in [
            (Kernel::Packet, Precision::Robust),
            (Kernel::Single, Precision::Robust),
            (Kernel::Packet, Precision::Fast),
            (Kernel::Single, Precision::Fast),
            (Kernel::Packet, Precision::Watertight),
            (Kernel::Single, Precision::Watertight),
        ] {
            let options = AccelOptions {
                isa: Some(isa.to_owned()),
                kernel,
                precision,
                ..AccelOptions::default()
            };
            // A processor without the instruction set has nothing to compare.
            let accel = match EmbreeAccel::build(scene, &options) {
                Err(AccelError::Embree { message, .. }) if message.contains("this processor has no") => {
                    continue;
                }
                built => built.unwrap(),
            };
            for order in [Coherence::Coherent, Coherence::Incoherent] {
                let mut packets = vec![RayPacket::EMPTY; rays.len().div_ceil(LANES)];
                for (i, ray) in rays.iter().enumerate() {
                    packets[i / LANES].set(i % LANES, ray);
                }
                accel.intersect(&mut packets, order);
                let found: Vec<_> = (0..rays.len())
                    .map(|i| packets[i / LANES].hit(i % LANES).map(id))
                    .collect();
                assert!(
                    found == expected,
                    "{isa} {kernel:?} {precision} {order:?}: {found:?}"
                );
            }
        }
    }
}

#[test]
fn within_one_mesh_the_lowest_of_coincident_primitives_is_hit() {
    check(
        &scene(vec![square(0.0, all_orders())], &[(0, DAffine3::IDENTITY)]),
        &rays(0.0),
    );
}

#[test]
fn lowest_of_coincident_meshes_is_hit() {
    let mut reversed = all_orders();
    reversed.reverse();
    let meshes = vec![square(-0.0, reversed), square(0.0, all_orders())];
    let both = [
        (1, DAffine3::IDENTITY),
        (0, DAffine3::IDENTITY),
        (1, DAffine3::IDENTITY),
    ];
    check(&scene(meshes, &both), &rays(0.0));
}

#[test]
fn within_an_instance_the_lowest_of_coincident_primitives_is_hit() {
    let aside = DAffine3::from_translation(DVec3::X * 4.0);
    check(&scene(vec![square(0.0, all_orders())], &[(0, aside)]), &rays(4.0));
}

#[test]
fn lowest_of_coincident_instances_is_hit() {
    let aside = DAffine3::from_translation(DVec3::X * 4.0);
    check(
        &scene(
            vec![square(0.0, all_orders())],
            &[(0, aside), (0, aside), (0, aside)],
        ),
        &rays(4.0),
    );
}

/// Of triangles that are Embree's own.
fn native() -> AccelOptions<'static> {
    AccelOptions {
        precision: Precision::Robust,
        ..AccelOptions::default()
    }
}

#[test]
fn a_hundred_thousand_coincident_triangles_are_built_and_only_the_first_is_hit() {
    let all_alike = [vec![[0, 2, 3]], vec![[0, 1, 2]; 100_000]].concat();
    let scene = scene(vec![square(0.0, all_alike)], &[(0, DAffine3::IDENTITY)]);
    let accel = EmbreeAccel::build(&scene, &native()).unwrap();
    let summary = accel.report().summary;
    assert!(
        summary.contains("99999 duplicate triangles left out"),
        "{summary}"
    );
    let mut packet = RayPacket::EMPTY;
    packet.set(0, &Ray::new(Vec3::new(0.75, 0.25, 4.0), Vec3::NEG_Z));
    let mut traced = [packet];
    accel.intersect(&mut traced, Coherence::Coherent);
    assert_eq!(traced[0].hit(0).map(|hit| hit.primitive), Some(1));
}

#[test]
fn only_a_mesh_with_coincident_triangles_costs_a_copy_of_its_indices() {
    let bytes = |triangles: Vec<[u32; 3]>| {
        let scene = scene(vec![square(0.0, triangles)], &[(0, DAffine3::IDENTITY)]);
        let report = EmbreeAccel::build(&scene, &native()).unwrap().report();
        (
            report.bytes,
            report.summary.contains("duplicate triangles left out"),
        )
    };
    let (shared, held_back) = bytes(vec![[0, 1, 2], [0, 2, 3]]);
    assert!(!held_back);
    let (copied, held_back) = bytes(vec![[0, 1, 2], [0, 1, 2]]);
    assert!(held_back);
    // Two rows of three words.
    assert!(copied >= shared + 24, "{copied} {shared}");
}
