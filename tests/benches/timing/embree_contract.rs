//! Cost of `EmbreeAccel` over the bare loop of Embree's calls: switching off lanes that Embree must not trace, planes,
//! and the choice of a width.

use glam::DAffine3;
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelOptions, Coherence, RayPacket};
use whit::buffer::Buffer;
use whit::mesh::Mesh;
use whit::scene::{Geometry, Instance, Scene};

use crate::batches::Traced;
use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::unit_cube;

const ROUNDS: usize = 41;
/// The least part of the bare loop's rate.
const MIN_RATE: f64 = 0.9;

/// Compares `EmbreeAccel` with the bare loop on a small and a large height field.
pub(crate) fn run(limits: &mut Limits) {
    type Trace<'a> = &'a dyn Fn(&mut [RayPacket]);
    let packets = unit_cube::film_rays(1.0);
    for cells in [16, 300] {
        let scene = height_field(cells);
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        let mut compare = |name: &str, bare: Trace, whole: Trace| {
            let seconds = |trace: Trace| Traced::measure(&packets, trace).seconds;
            let ratios = Quartiles::compute((0..ROUNDS).map(|_| seconds(bare) / seconds(whole)));
            println!(
                "{} triangles, {name}: {ratios:.3} of the bare rate, {}",
                cells * cells * 2,
                limits.at_least(ratios.median, MIN_RATE)
            );
        };
        for order in [Coherence::Coherent, Coherence::Incoherent] {
            compare(
                &format!("intersect {order:?}"),
                &|batch| accel.baseline_intersect16(batch, order),
                &|batch| accel.intersect(batch, order),
            );
            compare(
                &format!("occluded {order:?}"),
                &|batch| accel.baseline_occluded16(batch, order),
                &|batch| accel.occluded(batch, order),
            );
        }
    }
}

/// Returns a height field of `n`² cells over [0, 1]².
fn height_field(n: u32) -> Scene {
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
        positions: Buffer::from(positions),
        triangles: Buffer::from(triangles),
        ..Mesh::default()
    };
    Scene {
        geometries: vec![Geometry::Mesh(mesh)],
        instances: vec![Instance::new("field", 0, 0, DAffine3::IDENTITY).unwrap()],
        ..Scene::default()
    }
}
