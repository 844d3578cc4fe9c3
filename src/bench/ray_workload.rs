//! Sets of rays to replay: those of a frame, and random ones.

use std::fmt;

use glam::DVec3;
use serde::Serialize;

use super::options::MeasuredScene;
use crate::accel::{Accel, Coherence, LANES, RayEnd, RayPacket};
use crate::numeric::{Bounds, Ray, SplitMix64};
use crate::render;

/// Number of packets of a batch: those of a tile of 32x32 pixels.
pub(super) const BATCH_PACKETS: usize = 64;
/// Number of packets in a row of a selection: those of a tile of 32x32 pixels with 16 samples. Shorter runs would find the
/// tree in slower caches than a frame does, whose tiles reuse what their neighbours have loaded.
const RUN_PACKETS: usize = 16 * BATCH_PACKETS;
/// Largest number of packets of a kind; 16 times this many rays suffice for a stable result.
const MAX_PACKETS: usize = 1 << 16;

/// Kind of rays in a benchmark set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RayKind {
    /// Camera rays of the recorded frame.
    Camera,
    /// Shadow rays from the frame's surfaces to its lights.
    Shadow,
    /// Reflection rays from the frame's mirrors.
    Reflection,
    /// Uniformly random rays within the scene's bounds.
    Random,
}

impl fmt::Display for RayKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            RayKind::Camera => "camera",
            RayKind::Shadow => "shadow",
            RayKind::Reflection => "reflection",
            RayKind::Random => "random",
        })
    }
}

/// Recorded rays of one kind.
pub(super) struct RayWorkload {
    pub(super) kind: RayKind,
    /// Packets of the rays. Each [`BATCH_PACKETS`] of them are those of one query; packets without rays fill up the rest.
    pub(super) packets: Vec<RayPacket>,
    /// Number of active lanes of all packets.
    pub(super) ray_count: u64,
    /// End of all shadow rays, if they have one light that is a point or a direction.
    pub(super) end: Option<RayEnd>,
}

impl RayWorkload {
    /// Returns the rays of a frame and random ones, one set per kind; kinds without rays are left out.
    pub(super) fn all(measured: &MeasuredScene, accel: &dyn Accel) -> Vec<RayWorkload> {
        let MeasuredScene {
            scene,
            camera,
            settings,
            ..
        } = measured;
        let recorded = render::record(*scene, camera, accel, settings);
        let pixel_count = settings.width as usize * settings.height as usize;
        let mut sets = vec![
            RayWorkload::new(RayKind::Camera, recorded.camera),
            RayWorkload::of_queries(RayKind::Shadow, recorded.shadow, &recorded.shadow_queries),
            RayWorkload::new(RayKind::Reflection, recorded.reflection),
            RayWorkload::random(&scene.bounds(), pixel_count),
        ];
        sets.retain(|set| set.ray_count > 0);
        sets
    }

    /// Returns a set of the packets with at least one traceable ray; of too many an even selection.
    fn new(kind: RayKind, mut packets: Vec<RayPacket>) -> RayWorkload {
        packets.iter_mut().for_each(drop_idle_lanes);
        packets.retain(RayPacket::any_active);
        RayWorkload::of_batches(kind, packets)
    }

    /// Returns the set as [`RayWorkload::new`] does, but starts a new batch with each query. `starts` are the indices of
    /// the first packet of each query, in ascending order.
    fn of_queries(kind: RayKind, packets: Vec<RayPacket>, starts: &[usize]) -> RayWorkload {
        let mut kept = Vec::with_capacity(packets.len());
        let mut starts = starts.iter().peekable();
        for (index, mut packet) in packets.into_iter().enumerate() {
            // Fill up the batch of the query before
            if starts.next_if(|&&start| start <= index).is_some() {
                kept.resize(kept.len().next_multiple_of(BATCH_PACKETS), RayPacket::EMPTY);
            }
            drop_idle_lanes(&mut packet);
            if packet.any_active() {
                kept.push(packet);
            }
        }
        RayWorkload::of_batches(kind, kept)
    }

    fn of_batches(kind: RayKind, packets: Vec<RayPacket>) -> RayWorkload {
        let packets = select_evenly(packets, MAX_PACKETS);
        let active = |packet: &RayPacket| (0..LANES).filter(|&lane| packet.is_active(lane)).count() as u64;
        RayWorkload {
            kind,
            ray_count: packets.iter().map(active).sum(),
            end: RayEnd::common(&packets).filter(|_| kind == RayKind::Shadow),
            packets,
        }
    }

    /// Returns about `count` rays with origins uniform in `bounds` and directions uniform on the sphere, from a fixed
    /// seed.
    fn random(bounds: &Bounds, count: usize) -> RayWorkload {
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
        let filled: Vec<&RayPacket> = self.packets.iter().filter(|packet| packet.any_active()).collect();
        let count = filled.len();
        let kept = most.clamp(1, count.max(1)).min(count);
        // Take every (count / kept)-th packet
        let packets = (0..kept).map(|i| filled[i * count / kept].clone()).collect();
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

    /// Traces packets of the set, or copies of them, as the renderer would.
    pub(super) fn trace(&self, accel: &dyn Accel, packets: &mut [RayPacket]) {
        match (self.kind, self.end) {
            (RayKind::Shadow, Some(end)) => accel.occluded_towards(packets, end),
            (RayKind::Shadow, None) => accel.occluded(packets, self.order()),
            _ => accel.intersect(packets, self.order()),
        }
    }

    /// Returns whether rays in neighbouring lanes are coherent.
    pub(super) fn order(&self) -> Coherence {
        match self.kind {
            RayKind::Camera | RayKind::Shadow => Coherence::Coherent,
            RayKind::Reflection | RayKind::Random => Coherence::Incoherent,
        }
    }
}

/// Deactivates lanes whose rays are not traceable, as raw calls do not check them, and gives inactive lanes an empty
/// interval: on a processor with packets of at most eight lanes, Embree decides by the intervals alone which lanes of a
/// packet of sixteen to trace, and the other values of these lanes are undefined.
fn drop_idle_lanes(packet: &mut RayPacket) {
    packet.drop_untraceable();
    for lane in 0..LANES {
        if !packet.is_active(lane) {
            packet.t_far[lane] = f32::NEG_INFINITY;
        }
    }
}

/// Returns at most `most` packets in runs of [`RUN_PACKETS`] each, evenly spread over all. Runs begin where a batch does, as
/// the rays of a batch are close together and those of two halves of batches need not be.
fn select_evenly(packets: Vec<RayPacket>, most: usize) -> Vec<RayPacket> {
    if packets.len() <= most {
        return packets;
    }
    let runs = most / RUN_PACKETS;
    (0..runs)
        .flat_map(|run| {
            let start = run * (packets.len() - RUN_PACKETS) / runs / BATCH_PACKETS * BATCH_PACKETS;
            packets[start..start + RUN_PACKETS].iter().cloned()
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
        let packets: Vec<RayPacket> = (0..16_000)
            .map(|i| {
                let mut packet = RayPacket::EMPTY;
                packet.set(0, &Ray::new(Vec3::splat(i as f32), Vec3::X));
                packet
            })
            .collect();
        let kept = select_evenly(packets, 2 * RUN_PACKETS);
        let starts: Vec<f32> = kept.iter().map(|p| p.origin[0][0]).collect();
        assert_eq!(kept.len(), 2048);
        // The runs begin at 0, and at the batch around (16,000 - 1024) / 2 = 7488 = 117 * 64.
        assert_eq!(
            (starts[0], starts[1023], starts[1024], starts[2047]),
            (0.0, 1023.0, 7488.0, 8511.0)
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

    #[test]
    fn each_query_begins_a_batch() {
        let mut filled = RayPacket::EMPTY;
        filled.set(3, &Ray::new(Vec3::ZERO, Vec3::X));
        let packets = vec![
            filled.clone(),
            RayPacket::EMPTY,
            filled.clone(),
            filled.clone(),
            filled,
        ];
        // The first query has two packets with rays, the second one, and the third one.
        let set = RayWorkload::of_queries(RayKind::Shadow, packets, &[0, 3, 4]);
        let is_filled: Vec<bool> = set.packets.iter().map(RayPacket::any_active).collect();
        let mut expected = vec![false; 2 * BATCH_PACKETS + 1];
        for index in [0, 1, BATCH_PACKETS, 2 * BATCH_PACKETS] {
            expected[index] = true;
        }
        assert_eq!((is_filled, set.ray_count), (expected, 4));
    }
}
