//! Incoherent rays through spheres one by one and in packets of sixteen, by the number of spheres.
//!
//! The bare calls `rtcIntersect1` and `rtcIntersect16`: `EmbreeAccel` itself takes one or the other by the number of
//! objects, which is chosen after this measurement.

use whit::accel::AccelOptions;
use whit::accel::Coherence;
use whit::accel::embree::EmbreeAccel;

use crate::batches::Traced;
use crate::limits::Limits;
use crate::quartiles::Quartiles;
use crate::unit_cube;

const ROUNDS: usize = 5;

/// Compares single rays with packets on few and many spheres.
pub(crate) fn run(_: &mut Limits) {
    let packets = unit_cube::random_rays();
    for count in [16, 64, 256, 1024, 4096] {
        let scene = unit_cube::spheres(count);
        let accel = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
        let rates = Quartiles::compute((0..ROUNDS).map(|_| {
            let sixteen = Traced::measure(&packets, &|batch| {
                accel.baseline_intersect16(batch, Coherence::Incoherent);
            });
            let one = Traced::measure(&packets, &|batch| accel.baseline_intersect1(batch));
            sixteen.seconds / one.seconds
        }));
        println!("{count} spheres: single rays at {rates:.2} of the rate of packets");
    }
}
