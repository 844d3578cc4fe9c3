//! Our spheres, in f64 through callbacks, against Embree's own, in f32, on the same rays.

use whit::accel::embree::EmbreeAccel;
use whit::accel::{Accel, AccelOptions, Coherence, LANES, RayPacket};
use whit::scene::Scene;

use crate::batches::Traced;
use crate::limits::Limits;
use crate::native_spheres::NativeSpheres;
use crate::quartiles::Quartiles;
use crate::unit_cube::{self, SPHERE_COUNT};

const ROUNDS: usize = 11;
/// The least part of the rate of Embree's own spheres.
const MIN_RATE: f64 = 0.5;
/// The largest part of hits by which the two may differ: f32 and f64 part only where a ray grazes.
const MAX_HIT_DIFFERENCE: f64 = 1e-3;

type Trace<'a> = &'a dyn Fn(&mut [RayPacket]);

/// Compares the two on a hundred thousand spheres, by coherent and incoherent rays.
pub(crate) fn run(limits: &mut Limits) {
    let scene = unit_cube::spheres(SPHERE_COUNT);
    let ours = EmbreeAccel::build(&scene, &AccelOptions::default()).unwrap();
    let native = NativeSpheres::build(&centers_and_radii(&scene));
    for order in [Coherence::Coherent, Coherence::Incoherent] {
        let packets = match order {
            Coherence::Coherent => unit_cube::film_rays(2.0),
            Coherence::Incoherent => unit_cube::random_rays(),
        };
        compare(
            &format!("intersect {order:?}"),
            &packets,
            &|batch| ours.intersect(batch, order),
            &|batch| native.intersect(batch, order),
            limits,
        );
        compare(
            &format!("occluded {order:?}"),
            &packets,
            &|batch| ours.occluded(batch, order),
            &|batch| native.occluded(batch, order),
            limits,
        );
    }
}

/// Returns the spheres of a scene of placed unit spheres, each as its center and its radius.
fn centers_and_radii(scene: &Scene) -> Vec<[f32; 4]> {
    let sphere = |world_from_object: glam::DAffine3| {
        let radius = world_from_object.matrix3.x_axis.x as f32;
        world_from_object.translation.as_vec3().extend(radius).to_array()
    };
    let instances = scene.instances.iter();
    instances
        .map(|instance| sphere(instance.world_from_object()))
        .collect()
}

/// Prints how fast `ours` is beside `native`, by turns, and how many hits each finds.
fn compare(name: &str, packets: &[RayPacket], ours: Trace, native: Trace, limits: &mut Limits) {
    let rounds: Vec<[Traced; 2]> = (0..ROUNDS)
        .map(|_| [native, ours].map(|trace| Traced::measure(packets, trace)))
        .collect();
    let rates = Quartiles::compute(rounds.iter().map(|[native, ours]| native.seconds / ours.seconds));
    let million_rays = (packets.len() * LANES) as f64 / 1e6;
    let [native_best, our_best] = [0, 1].map(|who| {
        let rates = rounds.iter().map(|round| million_rays / round[who].seconds);
        rates.fold(0.0, f64::max)
    });
    println!(
        "{name}: {rates:.3} of the rate of Embree's own spheres, {}; {our_best:.2} and {native_best:.2} million rays a \
         second at best",
        limits.at_least(rates.median, MIN_RATE)
    );
    let [native_hits, our_hits] = [0, 1].map(|who| rounds[0][who].hit_count);
    let difference = our_hits.abs_diff(native_hits) as f64 / our_hits as f64;
    println!(
        "{name}: {our_hits} and {native_hits} hits, which differ by {difference:.1e}, {}",
        limits.at_most(difference, MAX_HIT_DIFFERENCE)
    );
}
