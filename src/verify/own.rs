//! A scene's own rays through two ways of finding hits: what differs, and why it may.
//!
//! Whether a difference is a tie or wrong says [`hit_compare`]; what kind of place it is at says the nearer of the two
//! hits, or the one that only one of them has found. What differs is kept ray by ray, to be drawn, written down and
//! asked again.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::place::{Place, place};
use super::trial::describe_ray;
use crate::accel::hit_compare::{self, HitComparison};
use crate::accel::{Accel, Hit, Instancing, LANES, RayOrder, RayPacket};
use crate::numeric::Ray;
use crate::parallel;
use crate::scene::Scene;

/// What a scene's rays are sent for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayKind {
    /// From the eye: what is hit first?
    Camera,
    /// From a surface to a light: is anything in the way?
    Shadow,
    /// From mirrors: what is hit first?
    Reflection,
}

impl RayKind {
    /// All of them.
    pub const ALL: [RayKind; 3] = [RayKind::Camera, RayKind::Shadow, RayKind::Reflection];

    /// As tables and files have it.
    pub fn word(self) -> &'static str {
        match self {
            RayKind::Camera => "camera",
            RayKind::Shadow => "shadow",
            RayKind::Reflection => "reflection",
        }
    }

    fn ask_all(self, accel: &dyn Accel, packets: &mut [RayPacket]) {
        match self {
            RayKind::Camera | RayKind::Reflection => accel.intersect(packets, RayOrder::Incoherent),
            RayKind::Shadow => accel.occluded(packets, RayOrder::Incoherent),
        }
    }

    /// What a packet that was asked holds for a lane.
    fn reply(self, packet: &RayPacket, lane: usize) -> Reply {
        match self {
            RayKind::Camera | RayKind::Reflection => Reply::of_hit(packet.hit(lane)),
            RayKind::Shadow if packet.is_blocked(lane) => Reply::Blocked,
            RayKind::Shadow => Reply::Free,
        }
    }
}

/// What was answered to one of these.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reply {
    /// This is hit first.
    Hit {
        /// Index into [`Scene::instances`].
        instance: u32,
        /// Triangle of the mesh or part of the shape.
        primitive: u32,
        /// Parameter along the ray.
        t: f32,
    },
    /// Nothing is hit.
    Nothing,
    /// Something is hit.
    Blocked,
    /// Nothing is in the way.
    Free,
}

impl Reply {
    /// What is said of the nearest hit.
    pub(super) fn of_hit(hit: Option<Hit>) -> Reply {
        hit.map_or(Reply::Nothing, |hit| Reply::Hit {
            instance: hit.instance,
            primitive: hit.primitive,
            t: hit.t,
        })
    }
}

impl fmt::Display for Reply {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Reply::Hit {
                instance,
                primitive,
                t,
            } => write!(f, "instance {instance} primitive {primitive} at {t:e}"),
            Reply::Nothing => f.write_str("nothing"),
            Reply::Blocked => f.write_str("blocked"),
            Reply::Free => f.write_str("not blocked"),
        }
    }
}

/// A ray to which two structures answer differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// What it was sent for.
    pub kind: RayKind,
    /// The ray.
    pub ray: Ray,
    /// What each answered.
    pub replies: [Reply; 2],
    /// Whether rounding does not explain it.
    pub is_wrong: bool,
    /// What kind of place it is at.
    pub place: Place,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [first, second] = &self.replies;
        write!(f, "{}: {first}, but {second}", describe_ray(&self.ray))
    }
}

/// Differences of each kind, ties and wrong ones, that are kept of a set of rays.
pub const MAX_DIFFERENCES: usize = 20_000;

/// How two answers to a set of rays compare.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Rays that were asked.
    pub rays: u64,
    /// Differences that rounding explains, by place.
    pub ties: BTreeMap<Place, u64>,
    /// Those that it does not.
    pub wrong: BTreeMap<Place, u64>,
    /// The first wrong one, to be asked again.
    pub example: Option<String>,
    /// The first [`MAX_DIFFERENCES`] ties and as many wrong ones, in the order of the rays.
    #[serde(skip)]
    pub differences: Vec<Difference>,
    /// How many ties and wrong ones those are.
    #[serde(skip)]
    kept: [usize; 2],
}

impl Comparison {
    /// How many are wrong.
    pub fn wrong_count(&self) -> u64 {
        self.wrong.values().sum()
    }

    /// How many are ties.
    pub fn tie_count(&self) -> u64 {
        self.ties.values().sum()
    }

    fn with(mut self, other: Comparison) -> Comparison {
        self.rays += other.rays;
        for (sums, counts) in [(&mut self.ties, other.ties), (&mut self.wrong, other.wrong)] {
            for (place, count) in counts {
                *sums.entry(place).or_default() += count;
            }
        }
        self.example = self.example.or(other.example);
        other
            .differences
            .iter()
            .for_each(|difference| self.keep(difference));
        self
    }

    fn count(&mut self, difference: &Difference) {
        let counts = if difference.is_wrong {
            self.example.get_or_insert_with(|| difference.to_string());
            &mut self.wrong
        } else {
            &mut self.ties
        };
        *counts.entry(difference.place).or_default() += 1;
        self.keep(difference);
    }

    fn keep(&mut self, difference: &Difference) {
        let count = &mut self.kept[usize::from(difference.is_wrong)];
        if *count < MAX_DIFFERENCES {
            *count += 1;
            self.differences.push(*difference);
        }
    }
}

/// Packets that go to a thread at once.
const CHUNK: usize = 256;

/// Compares what two structures over `scene` answer to all packets, which were sent for `kind`.
pub fn compare_all(
    scene: &Scene,
    accels: [&dyn Accel; 2],
    packets: &[RayPacket],
    kind: RayKind,
) -> Comparison {
    let chunks = parallel::map_chunks(packets, CHUNK, &|_, chunk| {
        compare_chunk(scene, accels, chunk, kind)
    });
    chunks.into_iter().fold(Comparison::default(), Comparison::with)
}

fn compare_chunk(scene: &Scene, accels: [&dyn Accel; 2], asked: &[RayPacket], kind: RayKind) -> Comparison {
    let answered = accels.map(|accel| {
        let mut packets = asked.to_vec();
        kind.ask_all(accel, &mut packets);
        packets
    });
    let mut comparison = Comparison::default();
    for (number, packet) in asked.iter().enumerate() {
        for lane in (0..LANES).filter(|&lane| packet.is_active(lane)) {
            comparison.rays += 1;
            let ray = packet.ray(lane);
            let [a, b] = [0, 1].map(|i: usize| &answered[i][number]);
            let (agreement, hits) = if kind == RayKind::Shadow {
                shadow(scene, &ray, accels, [a.is_blocked(lane), b.is_blocked(lane)])
            } else {
                let hits = [a.hit(lane), b.hit(lane)];
                (hit_compare::compare(scene, &ray, hits[0], hits[1]), hits)
            };
            if agreement != HitComparison::Same {
                comparison.count(&Difference {
                    kind,
                    ray,
                    replies: [a, b].map(|packet| kind.reply(packet, lane)),
                    is_wrong: agreement == HitComparison::Wrong,
                    place: place(scene, &ray, hits),
                });
            }
        }
    }
    comparison
}

/// What `accel` answers to a ray that was written down, and how that compares with what `reference` answers; meshes
/// reach `accel` by that kind of instancing.
pub fn ask_again(
    scene: &Scene,
    [reference, accel]: [&dyn Accel; 2],
    asked: &Difference,
    instancing: Instancing,
) -> (Reply, HitComparison) {
    let ray = &asked.ray;
    let packets = [reference, accel].map(|accel| {
        let mut packet = [RayPacket::EMPTY];
        packet[0].set(0, ray);
        asked.kind.ask_all(accel, &mut packet);
        packet[0].clone()
    });
    let agreement = if asked.kind == RayKind::Shadow {
        let blocked = packets.each_ref().map(|packet| packet.is_blocked(0));
        hit_compare::compare_occlusion_carried(scene, ray, blocked, instancing)
    } else {
        let hits = packets.each_ref().map(|packet| packet.hit(0));
        hit_compare::compare_carried(scene, ray, hits, instancing)
    };
    (asked.kind.reply(&packets[1], 0), agreement)
}

/// Whether a shadow ray may be blocked or not as two structures tell, with their nearest hits: mostly these settle it;
/// else the whole scene is asked, which takes long.
fn shadow(
    scene: &Scene,
    ray: &Ray,
    accels: [&dyn Accel; 2],
    blocked: [bool; 2],
) -> (HitComparison, [Option<Hit>; 2]) {
    if blocked[0] == blocked[1] {
        return (HitComparison::Same, [None; 2]);
    }
    let hits = accels.map(|accel| {
        let mut packet = [RayPacket::EMPTY];
        packet[0].set(0, ray);
        accel.intersect(&mut packet, RayOrder::Incoherent);
        packet[0].hit(0)
    });
    let agreement = match hit_compare::compare(scene, ray, hits[0], hits[1]) {
        HitComparison::Tie => HitComparison::Tie,
        _ => hit_compare::compare_occlusion(scene, ray, blocked[0], blocked[1]),
    };
    (agreement, hits)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::meshes::{icosphere, scene};
    use super::*;
    use crate::accel::brute::BruteAccel;
    use crate::scene::Geometry;

    /// Loses every hit on one triangle.
    struct Holed<'s>(BruteAccel<'s>, u32);

    impl Accel for Holed<'_> {
        fn intersect(&self, packets: &mut [RayPacket], order: RayOrder) {
            self.0.intersect(packets, order);
            for packet in packets {
                for lane in 0..LANES {
                    if packet.primitive[lane] == self.1 {
                        packet.forget_hit(lane);
                    }
                }
            }
        }

        fn occluded(&self, packets: &mut [RayPacket], order: RayOrder) {
            self.0.occluded(packets, order);
        }

        fn report(&self) -> crate::accel::AccelReport {
            self.0.report()
        }
    }

    #[test]
    fn a_lost_triangle_is_wrong_in_its_middle_and_told_to_be_elsewhere() {
        let scene = scene(vec![Geometry::Mesh(icosphere(1))]);
        let Geometry::Mesh(mesh) = &scene.geometries[0] else {
            panic!("it is a mesh");
        };
        let brute = BruteAccel::new(&scene);
        let holed = Holed(BruteAccel::new(&scene), 7);
        let [a, b, c] = mesh.corners(7);
        let at = |target: Vec3| {
            let mut packet = RayPacket::EMPTY;
            packet.set(0, &Ray::new(Vec3::ZERO, target));
            compare_all(&scene, [&brute, &holed], &[packet], RayKind::Camera)
        };
        let middle = at((a + b + c) / 3.0);
        assert_eq!(middle.wrong, BTreeMap::from([(Place::Other, 1)]));
        assert!(middle.example.is_some() && middle.ties.is_empty());
        let [difference] = middle.differences[..] else {
            panic!("one ray differs");
        };
        assert!(difference.is_wrong && difference.place == Place::Other);
        assert!(matches!(
            difference.replies,
            [Reply::Hit { primitive: 7, .. }, Reply::Nothing]
        ));
        // Asked again, brute force finds it, and the holed one still does not.
        let again = |accel: &dyn Accel| ask_again(&scene, [&brute, accel], &difference, Instancing::Callback);
        assert_eq!(again(&brute), (difference.replies[0], HitComparison::Same));
        assert_eq!(again(&holed), (Reply::Nothing, HitComparison::Wrong));
        // At the edge another triangle may have it: nothing, a tie, or this one's; never wrong elsewhere.
        let edge = at(0.5 * (a + b));
        assert!(!edge.wrong.contains_key(&Place::Other), "{edge:?}");
        assert_eq!(at(-(a + b + c)).rays, 1);
        assert_eq!(at(-(a + b + c)).wrong_count() + at(-(a + b + c)).tie_count(), 0);
    }
}
