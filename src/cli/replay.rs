//! Recorded rays and their replay: each backend gets copies of the same packets.

use std::hint::black_box;
use std::time::Instant;

use glam::DVec3;
use rayon::ThreadPool;

use whit::accel::hit_compare::{self, HitComparison};
use whit::accel::{Accel, Coherence, Hit, LANES, RayPacket};
use whit::numeric::{Bounds, Ray, SplitMix64};
use whit::parallel;
use whit::report::bench::{Mode, RayKind};
use whit::scene::Scene;

/// Number of packets copied and traced at once: 11 KB, so that they stay in the first-level cache.
const CHUNK_PACKETS: usize = 8;
/// Number of packets of a batch: those of a tile of 32x32 pixels.
const BATCH_PACKETS: usize = 64;
/// Smallest number of parts per thread that the packets are divided into, if the parts are no smaller than a batch.
const SHARES: usize = 16;
/// Largest number of packets of a kind; 16 times this many rays suffice for a stable result.
const MAX_PACKETS: usize = 1 << 16;

/// Recorded rays of one kind.
pub(super) struct RayWorkload {
    pub(super) kind: RayKind,
    packets: Vec<RayPacket>,
    /// Number of active lanes of all packets.
    pub(super) ray_count: u64,
}

impl RayWorkload {
    /// Returns a set of the packets with at least one traceable ray; of too many an even selection.
    pub(super) fn new(kind: RayKind, mut packets: Vec<RayPacket>) -> RayWorkload {
        // The raw calls do not check rays, so untraceable ones are removed here.
        packets.iter_mut().for_each(|packet| {
            packet.drop_untraceable();
            empty_idle_lanes(packet);
        });
        packets.retain(RayPacket::any_active);
        let packets = select_evenly(packets, MAX_PACKETS);
        let active = |packet: &RayPacket| (0..LANES).filter(|&lane| packet.is_active(lane)).count() as u64;
        RayWorkload {
            kind,
            ray_count: packets.iter().map(active).sum(),
            packets,
        }
    }

    /// Returns about `count` rays with origins uniform in `bounds` and directions uniform on the sphere, from a fixed
    /// seed.
    pub(super) fn random(bounds: &Bounds, count: usize) -> RayWorkload {
        let mut packets = Vec::new();
        // An empty scene has no bounds to start rays in
        if !bounds.is_empty() {
            let mut random = SplitMix64::new(0x5eed, 0);
            packets.resize_with(count.min(MAX_PACKETS * LANES).div_ceil(LANES), || {
                let mut packet = RayPacket::EMPTY;
                for lane in 0..LANES {
                    packet.set(lane, &random_ray(bounds, &mut random));
                }
                packet
            });
        }
        RayWorkload::new(RayKind::Random, packets)
    }

    /// Returns at most `most` packets, evenly spread over the set.
    pub(super) fn at_most(&self, most: usize) -> RayWorkload {
        let count = self.packets.len();
        let kept = most.clamp(1, count.max(1)).min(count);
        // Take every (count / kept)-th packet
        let packets = (0..kept)
            .map(|i| self.packets[i * count / kept].clone())
            .collect();
        RayWorkload::new(self.kind, packets)
    }

    /// Returns the set without the lanes from `count` on.
    pub(super) fn first_lanes(&self, count: usize) -> RayWorkload {
        let mut packets = self.packets.clone();
        for packet in &mut packets {
            packet.active[count.min(LANES)..].fill(0);
        }
        RayWorkload::new(self.kind, packets)
    }

    /// Returns the packets of the set.
    pub(super) fn packets(&self) -> &[RayPacket] {
        &self.packets
    }

    /// Returns whether rays in neighbouring lanes are coherent.
    pub(super) fn order(&self) -> Coherence {
        match self.kind {
            RayKind::Camera | RayKind::Shadow => Coherence::Coherent,
            RayKind::Reflection | RayKind::Random => Coherence::Incoherent,
        }
    }
}

/// Gives inactive lanes an empty interval: on a processor with packets of at most eight lanes, Embree decides by the
/// intervals alone which lanes of a packet of sixteen to trace, and the other values of these lanes are undefined.
fn empty_idle_lanes(packet: &mut RayPacket) {
    for lane in 0..LANES {
        if !packet.is_active(lane) {
            packet.t_far[lane] = f32::NEG_INFINITY;
        }
    }
}

/// Returns at most `most` packets in runs of one batch each, evenly spread over all.
fn select_evenly(packets: Vec<RayPacket>, most: usize) -> Vec<RayPacket> {
    if packets.len() <= most {
        return packets;
    }
    let runs = most / BATCH_PACKETS;
    // Keep whole batches together, as coherence within a batch affects its speed
    (0..runs)
        .flat_map(|run| {
            let start = run * (packets.len() - BATCH_PACKETS) / runs;
            packets[start..start + BATCH_PACKETS].iter().cloned()
        })
        .collect()
}

fn random_ray(bounds: &Bounds, random: &mut SplitMix64) -> Ray {
    let position = DVec3::new(random.unit(), random.unit(), random.unit());
    Ray {
        origin: (bounds.min + position * bounds.extent()).as_vec3(),
        direction: random.direction().as_vec3(),
        t_near: 0.0,
        t_far: f32::INFINITY,
        time: random.unit() as f32,
    }
}

/// Implementation that traces the rays.
#[derive(Clone, Copy)]
pub(super) enum Engine<'a> {
    /// Embree's packet calls without the code of the backend.
    #[cfg(feature = "embree")]
    Raw(&'a whit::accel::embree::EmbreeAccel<'a>),
    /// Embree's single-ray calls without the code of the backend.
    #[cfg(feature = "embree")]
    RawSingle(&'a whit::accel::embree::EmbreeAccel<'a>),
    /// Ray tracing backend with packets.
    Accel(&'a dyn Accel),
}

impl Engine<'_> {
    fn trace(&self, packets: &mut [RayPacket], kind: RayKind, order: Coherence) {
        match (self, kind) {
            #[cfg(feature = "embree")]
            (Engine::Raw(embree), RayKind::Shadow) => embree.baseline_occluded16(packets, order),
            #[cfg(feature = "embree")]
            (Engine::Raw(embree), _) => embree.baseline_intersect16(packets, order),
            #[cfg(feature = "embree")]
            (Engine::RawSingle(embree), RayKind::Shadow) => embree.baseline_occluded1(packets),
            #[cfg(feature = "embree")]
            (Engine::RawSingle(embree), _) => embree.baseline_intersect1(packets),
            (Engine::Accel(accel), RayKind::Shadow) => accel.occluded(packets, order),
            (Engine::Accel(accel), _) => accel.intersect(packets, order),
        }
    }
}

/// Returns the seconds that `engine` takes for all rays of `set` on this thread, copying of the packets included.
pub(super) fn replay_seconds(engine: Engine, set: &RayWorkload, mode: Mode) -> f64 {
    let mut scratch = scratch(mode);
    let start = Instant::now();
    replay(engine, set, &set.packets, &mut scratch);
    start.elapsed().as_secs_f64()
}

/// Returns the seconds for all rays of `set`, shared among the threads of `pool`; see [`replay_seconds`].
pub(super) fn shared_replay_seconds(pool: &ThreadPool, engine: Engine, set: &RayWorkload, mode: Mode) -> f64 {
    // Parts are small enough that every thread takes several, even if the threads differ in speed.
    let share = (set.packets.len() / (SHARES * pool.current_num_threads())).max(BATCH_PACKETS);
    let shares: Vec<&[RayPacket]> = set.packets.chunks(share).collect();
    parallel::install(pool, || {
        let start = Instant::now();
        parallel::for_each(shares.len(), &|index| {
            replay(engine, set, shares[index], &mut scratch(mode));
        });
        start.elapsed().as_secs_f64()
    })
}

/// Returns a buffer for the packets that are traced at once.
fn scratch(mode: Mode) -> Vec<RayPacket> {
    let chunk = if mode == Mode::Batch {
        BATCH_PACKETS
    } else {
        CHUNK_PACKETS
    };
    vec![RayPacket::EMPTY; chunk]
}

fn replay(engine: Engine, set: &RayWorkload, packets: &[RayPacket], scratch: &mut [RayPacket]) {
    for packets in packets.chunks(scratch.len()) {
        let scratch = &mut scratch[..packets.len()];
        scratch.clone_from_slice(packets);
        engine.trace(scratch, set.kind, set.order());
        black_box(scratch);
    }
}

/// Number of rays for which two engines differ.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Differences {
    /// Rays whose results differ by more than rounding.
    pub(super) wrong: u64,
    /// Rays whose results differ within the documented rounding.
    pub(super) ties: u64,
}

/// Compares the results of two engines for all rays of `set`.
pub(super) fn differences(scene: &Scene, set: &RayWorkload, reference: Engine, other: Engine) -> Differences {
    let mut differences = Differences::default();
    for original in &set.packets {
        // Trace copies of the packet with both engines
        let [mut a, mut b] = [original.clone(), original.clone()];
        reference.trace(std::slice::from_mut(&mut a), set.kind, set.order());
        other.trace(std::slice::from_mut(&mut b), set.kind, set.order());
        // Classify the difference in each active lane
        for lane in (0..LANES).filter(|&lane| original.is_active(lane)) {
            let agreement = match (set.kind, reference, other) {
                #[cfg(feature = "embree")]
                (_, _, Engine::Raw(_) | Engine::RawSingle(_)) => same_distance(&a, &b, lane),
                (RayKind::Shadow, Engine::Accel(first), Engine::Accel(second)) => {
                    let blocked = [a.is_blocked(lane), b.is_blocked(lane)];
                    shadow_agreement(scene, &original.ray(lane), [first, second], blocked)
                }
                _ => hit_compare::compare(scene, &original.ray(lane), a.hit(lane), b.hit(lane)),
            };
            match agreement {
                HitComparison::Same => {}
                HitComparison::Tie => differences.ties += 1,
                HitComparison::Wrong => differences.wrong += 1,
            }
        }
    }
    differences
}

/// Compares hit distances only, as raw results use the library's own numbering of geometries.
#[cfg(feature = "embree")]
fn same_distance(a: &RayPacket, b: &RayPacket, lane: usize) -> HitComparison {
    if a.t_far[lane].to_bits() == b.t_far[lane].to_bits() {
        HitComparison::Same
    } else {
        HitComparison::Wrong
    }
}

/// Classifies a difference in occlusion between two backends. Their nearest hits mostly decide; otherwise the whole
/// scene is tested, which is slow.
fn shadow_agreement(scene: &Scene, ray: &Ray, accels: [&dyn Accel; 2], blocked: [bool; 2]) -> HitComparison {
    if blocked[0] == blocked[1] {
        return HitComparison::Same;
    }
    // Trace the nearest hits of the shadow ray with both backends
    let [first, second] = accels.map(|accel| -> Option<Hit> {
        let mut packet = RayPacket::EMPTY;
        packet.set(0, ray);
        accel.intersect(std::slice::from_mut(&mut packet), Coherence::Incoherent);
        packet.hit(0)
    });
    // A tie of the nearest hits explains the difference
    match hit_compare::compare(scene, ray, first, second) {
        HitComparison::Tie => HitComparison::Tie,
        HitComparison::Same | HitComparison::Wrong => {
            hit_compare::compare_occlusion(scene, ray, blocked[0], blocked[1])
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn random_rays_start_within_the_bounds_and_are_reproducible() {
        let bounds = Bounds {
            min: DVec3::new(-1.0, 2.0, 5.0),
            max: DVec3::new(1.0, 3.0, 5.0),
        };
        let set = RayWorkload::random(&bounds, 1000);
        assert_eq!(set.ray_count, 1008);
        for packet in &set.packets {
            for lane in 0..LANES {
                let ray = packet.ray(lane);
                let origin = ray.origin.as_dvec3();
                assert!(origin.cmpge(bounds.min).all() && origin.cmple(bounds.max).all());
                // Three squares and each coordinate are rounded to f32, an error below 2^-22 in total.
                assert!((ray.direction.length_squared() - 1.0).abs() < 2f32.powi(-22));
            }
        }
        let again = RayWorkload::random(&bounds, 1000);
        assert_eq!(again.packets[7].origin, set.packets[7].origin);
        assert_eq!(RayWorkload::random(&Bounds::EMPTY, 1000).ray_count, 0);
    }

    #[test]
    fn selection_of_packets_keeps_evenly_spaced_runs() {
        let packets: Vec<RayPacket> = (0..1000)
            .map(|i| {
                let mut packet = RayPacket::EMPTY;
                packet.set(0, &Ray::new(Vec3::splat(i as f32), Vec3::X));
                packet
            })
            .collect();
        let kept = select_evenly(packets, 2 * BATCH_PACKETS);
        let starts: Vec<f32> = kept.iter().map(|p| p.origin[0][0]).collect();
        assert_eq!(kept.len(), 128);
        // The runs begin at 0 and at (1000 - 64) / 2.
        assert_eq!(
            (starts[0], starts[63], starts[64], starts[127]),
            (0.0, 63.0, 468.0, 531.0)
        );
    }

    #[test]
    fn lanes_and_packets_without_valid_rays_are_dropped() {
        let mut packet = RayPacket::EMPTY;
        packet.set(3, &Ray::new(Vec3::ZERO, Vec3::X));
        packet.set(4, &Ray::new(Vec3::NAN, Vec3::X));
        let set = RayWorkload::new(RayKind::Camera, vec![RayPacket::EMPTY, packet]);
        assert_eq!((set.packets.len(), set.ray_count), (1, 1));
    }
}
