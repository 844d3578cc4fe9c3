//! Replay of recorded rays: each engine gets copies of the same packets.

use std::fmt;
use std::hint::black_box;
use std::time::Instant;

use rayon::ThreadPool;
use serde::Serialize;

use super::ray_workload::{BATCH_PACKETS, RayKind, RayWorkload};
#[cfg(feature = "embree")]
use crate::accel::embree::EmbreeAccel;
use crate::accel::hit_compare::{self, HitComparison};
use crate::accel::{Accel, LANES, RayPacket};
use crate::measure::{Stopwatch, TurnTime};
use crate::parallel;
use crate::scene::Scene;
use crate::verify::compare_shadow;

/// Number of packets copied and traced at once: 11 KB, so that they stay in the first-level cache.
const CHUNK_PACKETS: usize = 8;
/// Smallest number of parts per thread that the packets are divided into, if the parts are no smaller than a batch.
const SHARES: usize = 16;
/// Number of parts that a replay is divided into.
pub(super) const PARTS: usize = 16;

/// Grouping in which rays are passed to the backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Bare library calls with 16 rays each.
    Raw,
    /// Bare library calls with one ray each.
    #[serde(rename = "raw-single")]
    RawSingle,
    /// One ray per call of whit's interface.
    Single,
    /// Packets of 16 rays per call.
    Packet,
    /// Many packets per call, for a backend that interleaves them.
    Batch,
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            Mode::Raw => "raw",
            Mode::RawSingle => "raw-single",
            Mode::Single => "single",
            Mode::Packet => "packet",
            Mode::Batch => "batch",
        })
    }
}

/// Implementation that traces the rays.
#[derive(Clone, Copy)]
pub(super) enum Engine<'a> {
    /// Embree's packet calls without the code of the backend.
    #[cfg(feature = "embree")]
    Raw(&'a EmbreeAccel<'a>),
    /// Embree's single-ray calls without the code of the backend.
    #[cfg(feature = "embree")]
    RawSingle(&'a EmbreeAccel<'a>),
    /// Ray tracing backend with packets.
    Accel(&'a dyn Accel),
}

impl Engine<'_> {
    fn trace(&self, packets: &mut [RayPacket], set: &RayWorkload) {
        #[cfg(feature = "embree")]
        let order = set.order();
        match (self, set.kind) {
            #[cfg(feature = "embree")]
            (Engine::Raw(embree), RayKind::Shadow) => embree.baseline_occluded16(packets, order),
            #[cfg(feature = "embree")]
            (Engine::Raw(embree), _) => embree.baseline_intersect16(packets, order),
            #[cfg(feature = "embree")]
            (Engine::RawSingle(embree), RayKind::Shadow) => embree.baseline_occluded1(packets),
            #[cfg(feature = "embree")]
            (Engine::RawSingle(embree), _) => embree.baseline_intersect1(packets),
            (Engine::Accel(accel), _) => set.trace(*accel, packets),
        }
    }
}

/// Packets of a set that are replayed in one turn.
#[derive(Clone, Copy)]
pub(super) struct ReplayPart<'w> {
    set: &'w RayWorkload,
    packets: &'w [RayPacket],
    /// Factor of the time, by which the parts of a set add up to the time of the set.
    weight: f64,
}

impl<'w> ReplayPart<'w> {
    /// Returns the whole of `set` as one part.
    pub(super) fn whole(set: &'w RayWorkload) -> ReplayPart<'w> {
        ReplayPart {
            set,
            packets: &set.packets,
            weight: 1.0,
        }
    }

    /// Returns part `index` of [`PARTS`]. Each part of a small set is the whole set: times of a few microseconds vary.
    pub(super) fn of(set: &'w RayWorkload, index: usize) -> ReplayPart<'w> {
        let count = set.packets.len();
        let whole = ReplayPart::whole(set);
        if count < PARTS * BATCH_PACKETS {
            return ReplayPart {
                weight: 1.0 / PARTS as f64,
                ..whole
            };
        }
        // Divide it between queries
        let start = |index| match index {
            PARTS => count,
            _ => index * count / PARTS / BATCH_PACKETS * BATCH_PACKETS,
        };
        ReplayPart {
            packets: &set.packets[start(index)..start(index + 1)],
            ..whole
        }
    }
}

/// Returns the time that `engine` takes for `part` on this thread, without the copying of the packets.
pub(super) fn replay_time(engine: Engine, part: ReplayPart, mode: Mode) -> TurnTime {
    let mut scratch = scratch(mode);
    let watch = Stopwatch::start();
    let copying = replay(engine, part.set, part.packets, &mut scratch);
    watch.time().without(copying) * part.weight
}

/// Returns the time for `part`, shared among the threads of `pool`; see [`replay_time`].
pub(super) fn shared_replay_time(
    pool: &ThreadPool,
    engine: Engine,
    part: ReplayPart,
    mode: Mode,
) -> TurnTime {
    let ReplayPart { set, packets, weight } = part;
    // Parts are small enough that every thread takes several, even if the threads differ in speed.
    let share = packets.len() / (SHARES * pool.current_num_threads());
    let share = share.max(1).next_multiple_of(BATCH_PACKETS);
    let shares: Vec<&[RayPacket]> = packets.chunks(share).collect();
    parallel::install(pool, || {
        let watch = Stopwatch::start();
        let copying = parallel::map(shares.len(), &|index| {
            replay(engine, set, shares[index], &mut scratch(mode))
        });
        // The threads copy side by side
        let threads = pool.current_num_threads() as f64;
        watch.time().without(copying.iter().sum::<f64>() / threads) * weight
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

/// Traces copies of the packets; returns the seconds by the clock that copying took.
fn replay(engine: Engine, set: &RayWorkload, packets: &[RayPacket], scratch: &mut [RayPacket]) -> f64 {
    let mut copying = 0.0;
    for packets in packets.chunks(scratch.len()) {
        // Copy them to the cache, where a renderer's packets are when it traces them
        let start = Instant::now();
        let mut count = 0;
        for packet in packets.iter().filter(|packet| packet.any_active()) {
            scratch[count].clone_from(packet);
            count += 1;
        }
        let scratch = black_box(&mut scratch[..count]);
        copying += start.elapsed().as_secs_f64();
        if count > 0 {
            engine.trace(scratch, set);
        }
        black_box(scratch);
    }
    copying
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
    for batch in set.packets.chunks(BATCH_PACKETS) {
        // Trace copies of the packets with both engines
        let filled = batch.iter().filter(|packet| packet.any_active());
        let batch: Vec<RayPacket> = filled.cloned().collect();
        let [mut results, mut other_results] = [batch.clone(), batch.clone()];
        reference.trace(&mut results, set);
        other.trace(&mut other_results, set);
        // Classify the difference in each active lane
        for ((original, a), b) in batch.iter().zip(&results).zip(&other_results) {
            for lane in (0..LANES).filter(|&lane| original.is_active(lane)) {
                let ray = original.ray(lane);
                let agreement = match (set.kind, reference, other) {
                    #[cfg(feature = "embree")]
                    (_, _, Engine::Raw(_) | Engine::RawSingle(_)) => same_distance(a, b, lane),
                    (RayKind::Shadow, Engine::Accel(first), Engine::Accel(second)) => {
                        let distance = set.end.map(|end| end.distance(&ray, &batch));
                        let blocked = [a.is_blocked(lane), b.is_blocked(lane)];
                        compare_shadow(scene, &ray, distance, [first, second], blocked).0
                    }
                    _ => hit_compare::compare(scene, &ray, a.hit(lane), b.hit(lane)),
                };
                match agreement {
                    HitComparison::Same => {}
                    HitComparison::Tie => differences.ties += 1,
                    HitComparison::Wrong => differences.wrong += 1,
                }
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
