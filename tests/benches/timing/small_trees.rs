//! Rays through small meshes by the native backend, in packets and one by one: the number of triangles up to which
//! packets pay, and the number of active lanes from which on.

use glam::DAffine3;

use whit::accel::{self, Accel, AccelOptions, Backend, Coherence, Kernel, LANES, RayPacket};
use whit::mesh::bumpy_sphere;
use whit::scene::{Geometry, Instance, Material, Scene};

use crate::batches::Traced;
use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::unit_cube;

const ROUNDS: usize = 5;

/// Compares packets with single rays by the number of triangles, then by the number of lanes.
pub(crate) fn run(_: &mut Limits) {
    for triangles in [20, 40, 80, 160, 320, 480] {
        let ratio = ratio(triangles, &unit_cube::random_rays());
        println!("{triangles} triangles: packets take {ratio:.2} of the time of single rays");
    }
    for lanes in [2, 4, 8, LANES] {
        let ratio = ratio(40, &unit_cube::nearby_rays(1.0, lanes));
        println!("40 triangles, {lanes} rays a packet: packets take {ratio:.2} of the time of single rays");
    }
}

/// Returns the time of packets over that of single rays through a mesh of about that many triangles.
fn ratio(triangles: u64, packets: &[RayPacket]) -> Quartiles {
    let scene = Scene {
        geometries: vec![Geometry::Mesh(bumpy_sphere(triangles))],
        instances: vec![Instance::new("mesh", 0, 0, DAffine3::IDENTITY).unwrap()],
        materials: vec![Material::default()],
        ..Scene::default()
    };
    let scene = scene.validate().unwrap();
    let built = |kernel| {
        let options = AccelOptions {
            kernel,
            ..AccelOptions::default()
        };
        accel::build(scene, Backend::Native, &options).unwrap()
    };
    let (together, single) = (built(Kernel::Packet), built(Kernel::Single));
    let seconds = |accel: &dyn Accel| {
        Traced::measure(packets, &|batch| accel.intersect(batch, Coherence::Incoherent)).seconds
    };
    Quartiles::compute((0..ROUNDS).map(|_| seconds(&*together) / seconds(&*single)))
}
