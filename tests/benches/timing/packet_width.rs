//! Incoherent rays one by one and in packets of sixteen: from anywhere to anywhere by the number of spheres, and from
//! nearby points by their number and by how far their directions differ.
//!
//! The bare calls `rtcIntersect1` and `rtcIntersect16`: `EmbreeAccel` itself takes one or the other for each packet, by
//! rules that are chosen after this measurement.

use whit::accel::AccelOptions;
use whit::accel::embree::EmbreeAccel;
use whit::accel::{Coherence, LANES, RayPacket};

use crate::batches::Traced;
use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::unit_cube;

const ROUNDS: usize = 5;
/// Number of spheres through which nearby rays are traced.
const SPHERES: usize = 10_000;

/// Compares single rays with packets on few and many spheres.
pub(crate) fn run(_: &mut Limits) {
    let packets = unit_cube::random_rays();
    for count in [16, 64, 256, 1024, 4096] {
        let scene = unit_cube::spheres(count);
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        println!(
            "{count} spheres: single rays at {:.2} of the rate of packets",
            ratio(&accel, &packets)
        );
    }
    let scene = unit_cube::spheres(SPHERES);
    let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
    for spread in [0.01, 0.1, 0.5, 1.0] {
        for lanes in [2, 4, 8, 16] {
            let packets = unit_cube::nearby_rays(spread, lanes);
            println!(
                "{lanes} nearby rays, directions within {spread}: single rays at {:.2} of the rate of packets",
                ratio(&accel, &packets)
            );
        }
        let packets = unit_cube::nearby_rays(spread, LANES);
        let times = Quartiles::compute((0..ROUNDS).map(|_| {
            sixteen(&accel, &packets, Coherence::Coherent) / sixteen(&accel, &packets, Coherence::Incoherent)
        }));
        println!("directions within {spread}: packets take {times:.2} times as long if flagged as coherent");
    }
}

/// Returns the time of packets over that of single rays.
fn ratio(accel: &EmbreeAccel, packets: &[RayPacket]) -> Quartiles {
    Quartiles::compute((0..ROUNDS).map(|_| {
        let one = Traced::measure(packets, &|batch| accel.baseline_intersect1(batch));
        sixteen(accel, packets, Coherence::Incoherent) / one.seconds
    }))
}

/// Returns the seconds that packets of sixteen take.
fn sixteen(accel: &EmbreeAccel, packets: &[RayPacket], order: Coherence) -> f64 {
    Traced::measure(packets, &|batch| accel.baseline_intersect16(batch, order)).seconds
}
