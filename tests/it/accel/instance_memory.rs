//! Memory of instances, Embree's own share included.

use crate::support::scenes::{self, SplitMix64};
use glam::{DAffine3, DQuat, DVec3};
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelOptions, Instancing};
use whit::scene::{Geometry, Instance, Scene};
use whit::shape::{Shape, Sphere};

/// Bytes that the renderer holds for an instance, as a unit test checks.
const RENDERER_BYTES: f64 = 24.0;
/// Bytes of Embree's own instance of a mesh, and all that is held beside it: Embree 4 keeps about 220 bytes
/// more of a geometry than Embree 3.
const NATIVE_BYTES: f64 = if embree_sys::RTC_VERSION_MAJOR >= 4 {
    900.0
} else {
    650.0
};
/// Bytes that an allocator adds to a block on the heap.
const HEAP_BYTES: usize = 16;

fn bytes_of(scene: &Scene, instancing: Instancing) -> f64 {
    let instance = |i: &Instance| {
        let heap = i.heap_byte_count();
        size_of::<Instance>() + heap + if heap > 0 { HEAP_BYTES } else { 0 }
    };
    let instances: usize = scene.instances.iter().map(instance).sum();
    let options = AccelOptions {
        instancing,
        ..AccelOptions::default()
    };
    let accel = EmbreeAccel::build(scene, &options).unwrap();
    (instances as u64 + accel.report().bytes) as f64 + RENDERER_BYTES * scene.instances.len() as f64
}

fn many(geometry: Geometry, count: usize, place: impl Fn(DVec3, &mut SplitMix64) -> DAffine3) -> Scene {
    let mut random = SplitMix64(3);
    let instance = |_| {
        let p = 100.0 * random.in_cube();
        Instance::new("", 0, 0, place(p, &mut random)).unwrap()
    };
    Scene {
        instances: (0..count).map(instance).collect(),
        geometries: vec![geometry],
        ..Scene::default()
    }
}

fn sphere_bytes(count: usize) -> f64 {
    let place = |p: DVec3, random: &mut SplitMix64| {
        DAffine3::from_scale_rotation_translation(DVec3::splat(0.1 + random.next()), DQuat::IDENTITY, p)
    };
    let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
    let bytes = bytes_of(&many(sphere, count, place), Instancing::Callback) / count as f64;
    println!("{count} spheres: {bytes:.1} bytes each");
    bytes
}

/// Bytes an instance of one mesh with about 4 n² triangles, those of the mesh not counted.
fn mesh_instance_bytes(n: u32, count: usize, instancing: Instancing) -> f64 {
    let place = |p: DVec3, random: &mut SplitMix64| {
        let turn = DQuat::from_axis_angle(random.on_sphere(), random.next());
        DAffine3::from_scale_rotation_translation(DVec3::splat(0.1 + random.next()), turn, p)
    };
    let mesh = || Geometry::Mesh(scenes::bumpy_sphere(n));
    let alone = bytes_of(&many(mesh(), 1, place), instancing);
    let bytes = (bytes_of(&many(mesh(), count, place), instancing) - alone) / (count - 1) as f64;
    println!("{count} {instancing} instances of a mesh: {bytes:.1} bytes each, {alone} for the first");
    bytes
}

#[test]
fn a_sphere_takes_at_most_200_bytes() {
    assert!(sphere_bytes(100_000) <= 200.0);
}

#[test]
fn another_instance_of_a_mesh_takes_at_most_400_bytes() {
    assert!(mesh_instance_bytes(20, 20_000, Instancing::Callback) <= 400.0);
}

#[test]
#[ignore = "slow: half a gigabyte"]
fn a_million_spheres_take_at_most_200_bytes_each() {
    assert!(sphere_bytes(1_000_000) <= 200.0);
}

#[test]
#[ignore = "slow: half a gigabyte"]
fn a_hundred_thousand_instances_take_at_most_400_bytes_each() {
    assert!(mesh_instance_bytes(160, 100_000, Instancing::Callback) <= 400.0);
}

#[test]
fn native_instance_takes_the_known_bytes_of_this_embree() {
    assert!(mesh_instance_bytes(5, 100_000, Instancing::Native) <= NATIVE_BYTES);
}
