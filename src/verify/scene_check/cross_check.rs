//! Cross-check of a scene's own rays through two acceleration structures.
//!
//! [`hit_compare`] decides whether a difference is a tie or wrong. The mesh feature of a difference is the first that
//! applies to either of the two hits. Differences are kept ray by ray, to be drawn, written to a file and traced again.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

use super::feature::{MeshFeature, feature};
use crate::accel::hit_compare::{self, HitComparison};
use crate::accel::{Accel, Coherence, Hit, Instancing, LANES, MAX_BATCH, RayEnd, RayPacket};
use crate::numeric::Ray;
use crate::parallel;
use crate::scene::Scene;
use crate::verify::harness::{QueryResult, describe_ray};

/// Purpose of a scene's rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RayKind {
    /// Camera ray (nearest-hit query).
    Camera,
    /// Shadow ray from a surface to a light (any-hit query).
    Shadow,
    /// Reflection ray of a mirror (nearest-hit query).
    Reflection,
}

impl RayKind {
    /// All kinds of rays.
    pub const ALL: [RayKind; 3] = [RayKind::Camera, RayKind::Shadow, RayKind::Reflection];

    /// Returns the word for the kind in tables and files.
    pub fn word(self) -> &'static str {
        match self {
            RayKind::Camera => "camera",
            RayKind::Shadow => "shadow",
            RayKind::Reflection => "reflection",
        }
    }

    /// Traces packets as the renderer does: camera rays, and shadow rays with a common `end`, as coherent ones.
    fn trace_all(self, end: Option<RayEnd>, accel: &dyn Accel, packets: &mut [RayPacket]) {
        match (self, end) {
            (RayKind::Camera, _) => accel.intersect(packets, Coherence::Coherent),
            (RayKind::Reflection, _) => accel.intersect(packets, Coherence::Incoherent),
            (RayKind::Shadow, Some(end)) => accel.occluded_towards(packets, end),
            (RayKind::Shadow, None) => accel.occluded(packets, Coherence::Incoherent),
        }
    }

    /// Returns the common end of the rays, for which shadow rays are traced in groups.
    fn common_end(self, packets: &[RayPacket]) -> Option<RayEnd> {
        RayEnd::common(packets).filter(|_| self == RayKind::Shadow)
    }

    /// Returns the result that a traced packet holds for a lane.
    fn query_result(self, packet: &RayPacket, lane: usize) -> QueryResult {
        match self {
            RayKind::Camera | RayKind::Reflection => QueryResult::of_hit(packet.hit(lane)),
            RayKind::Shadow if packet.is_blocked(lane) => QueryResult::Blocked,
            RayKind::Shadow => QueryResult::Free,
        }
    }
}

/// Ray for which two structures return different results.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Purpose of the ray.
    pub kind: RayKind,
    /// Ray that was traced.
    pub ray: Ray,
    /// Results of the first and the second structure.
    pub query_results: [QueryResult; 2],
    /// Flag for a difference that rounding does not explain.
    pub is_wrong: bool,
    /// Mesh feature at which the difference lies.
    pub feature: MeshFeature,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [first, second] = &self.query_results;
        write!(f, "{}: {first}, but {second}", describe_ray(&self.ray))
    }
}

/// Largest number of ties, and of wrong results, that are kept of a set of rays.
pub const MAX_DIFFERENCES: usize = 20_000;

/// Comparison of two structures on a set of rays.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BackendComparison {
    /// Number of rays traced.
    pub rays: u64,
    /// Differences that rounding explains, by mesh feature.
    pub ties: BTreeMap<MeshFeature, u64>,
    /// Differences that rounding does not explain, by mesh feature.
    pub wrong: BTreeMap<MeshFeature, u64>,
    /// First wrong result, in a form that allows reproducing the ray.
    pub example: Option<String>,
    /// First [`MAX_DIFFERENCES`] ties and as many wrong results, in the order of the rays.
    #[serde(skip)]
    pub differences: Vec<Difference>,
    /// Numbers of ties and of wrong results in `differences`.
    #[serde(skip)]
    kept: [usize; 2],
}

impl BackendComparison {
    /// Returns the number of wrong results.
    pub fn wrong_count(&self) -> u64 {
        self.wrong.values().sum()
    }

    /// Returns the number of ties.
    pub fn tie_count(&self) -> u64 {
        self.ties.values().sum()
    }

    fn with(mut self, other: BackendComparison) -> BackendComparison {
        // Add up the counts by feature
        self.rays += other.rays;
        for (sums, counts) in [(&mut self.ties, other.ties), (&mut self.wrong, other.wrong)] {
            for (feature, count) in counts {
                *sums.entry(feature).or_default() += count;
            }
        }
        self.example = self.example.or(other.example);
        // Keep the first differences of both
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
        *counts.entry(difference.feature).or_default() += 1;
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

/// Packets that one thread traces at a time: as many as the renderer does at most.
const CHUNK: usize = MAX_BATCH;

/// Traces all packets, which are rays of kind `kind`, through two structures over `scene` and compares the results.
pub fn cross_check(
    scene: &Scene,
    accels: [&dyn Accel; 2],
    packets: &[RayPacket],
    kind: RayKind,
) -> BackendComparison {
    let chunks = parallel::map_chunks(packets, CHUNK, &|_, chunk| {
        cross_check_chunk(scene, accels, chunk, kind)
    });
    chunks
        .into_iter()
        .fold(BackendComparison::default(), BackendComparison::with)
}

fn cross_check_chunk(
    scene: &Scene,
    accels: [&dyn Accel; 2],
    recorded: &[RayPacket],
    kind: RayKind,
) -> BackendComparison {
    // Trace copies of the packets through both structures
    let end = kind.common_end(recorded);
    let results = accels.map(|accel| {
        let mut packets = recorded.to_vec();
        kind.trace_all(end, accel, &mut packets);
        packets
    });
    let mut comparison = BackendComparison::default();
    // Compare the results of each active lane
    for (number, packet) in recorded.iter().enumerate() {
        for lane in (0..LANES).filter(|&lane| packet.is_active(lane)) {
            comparison.rays += 1;
            let ray = packet.ray(lane);
            let [a, b] = [0, 1].map(|i: usize| &results[i][number]);
            let (agreement, hits) = if kind == RayKind::Shadow {
                let distance = end.map(|end| end.distance(&ray, recorded));
                let blocked = [a.is_blocked(lane), b.is_blocked(lane)];
                compare_shadow(scene, &ray, distance, accels, blocked)
            } else {
                let hits = [a.hit(lane), b.hit(lane)];
                (hit_compare::compare(scene, &ray, hits[0], hits[1]), hits)
            };
            // Record the difference with its feature
            if agreement != HitComparison::Same {
                comparison.count(&Difference {
                    kind,
                    ray,
                    query_results: [a, b].map(|packet| kind.query_result(packet, lane)),
                    is_wrong: agreement == HitComparison::Wrong,
                    feature: feature(scene, &ray, hits),
                });
            }
        }
    }
    comparison
}

/// Traces a recorded ray through `accel` again and compares the result with that of `reference`. `instancing` says how
/// `accel` transforms rays into the space of meshes.
pub fn retrace(
    scene: &Scene,
    [reference, accel]: [&dyn Accel; 2],
    recorded: &Difference,
    instancing: Instancing,
) -> (QueryResult, HitComparison) {
    let ray = &recorded.ray;
    // Trace the ray through both structures in packets of one
    let packets = [reference, accel].map(|accel| {
        let mut packet = [RayPacket::EMPTY];
        packet[0].set(0, ray);
        let end = recorded.kind.common_end(&packet);
        recorded.kind.trace_all(end, accel, &mut packet);
        packet[0].clone()
    });
    // Classify the difference under the rounding of that kind of instancing
    let agreement = if recorded.kind == RayKind::Shadow {
        let blocked = packets.each_ref().map(|packet| packet.is_blocked(0));
        hit_compare::compare_occlusion_with_instancing(scene, ray, blocked, instancing)
    } else {
        let hits = packets.each_ref().map(|packet| packet.hit(0));
        hit_compare::compare_with_instancing(scene, ray, hits, instancing)
    };
    (recorded.kind.query_result(&packets[1], 0), agreement)
}

/// Compares two any-hit results for a shadow ray, and returns the nearest hits of both structures. `distance` is that of
/// the ray from the common end of its query ([`RayEnd::distance`]), if it has one. The nearest hits mostly decide whether a
/// difference is a tie; otherwise all primitives of the scene are tested, which is slow.
pub(crate) fn compare_shadow(
    scene: &Scene,
    ray: &Ray,
    distance: Option<f64>,
    accels: [&dyn Accel; 2],
    blocked: [bool; 2],
) -> (HitComparison, [Option<Hit>; 2]) {
    if blocked[0] == blocked[1] {
        return (HitComparison::Same, [None; 2]);
    }
    // Find the nearest hits, which explain most differences
    let hits = accels.map(|accel| {
        let mut packet = [RayPacket::EMPTY];
        packet[0].set(0, ray);
        accel.intersect(&mut packet, Coherence::Incoherent);
        packet[0].hit(0)
    });
    // Test the whole scene only if they are not a tie
    let agreement = match hit_compare::compare(scene, ray, hits[0], hits[1]) {
        HitComparison::Tie => HitComparison::Tie,
        _ => match distance {
            Some(distance) => hit_compare::compare_occlusion_in_group(scene, ray, blocked, distance),
            None => hit_compare::compare_occlusion(scene, ray, blocked[0], blocked[1]),
        },
    };
    (agreement, hits)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::accel::brute::BruteAccel;
    use crate::scene::Geometry;
    use crate::verify::harness::test_meshes::{icosphere, scene};

    /// Structure that loses every hit on one triangle.
    struct Holed<'s>(BruteAccel<'s>, u32);

    impl Accel for Holed<'_> {
        fn intersect(&self, packets: &mut [RayPacket], order: Coherence) {
            self.0.intersect(packets, order);
            for packet in packets {
                for lane in 0..LANES {
                    if packet.primitive[lane] == self.1 {
                        packet.clear_hit(lane);
                    }
                }
            }
        }

        fn occluded(&self, packets: &mut [RayPacket], order: Coherence) {
            self.0.occluded(packets, order);
        }

        fn report(&self) -> crate::accel::AccelReport {
            self.0.report()
        }
    }

    #[test]
    fn missing_triangle_is_wrong_in_its_interior() {
        let scene = scene(vec![Geometry::Mesh(icosphere(1))]);
        let Geometry::Mesh(mesh) = &scene.geometries[0] else {
            panic!("it is a mesh");
        };
        // Aim at points of the triangle that the second structure loses
        let brute = BruteAccel::new(&scene);
        let holed = Holed(BruteAccel::new(&scene), 7);
        let [a, b, c] = mesh.corners(7);
        let at = |target: Vec3| {
            let mut packet = RayPacket::EMPTY;
            packet.set(0, &Ray::new(Vec3::ZERO, target));
            cross_check(&scene, [&brute, &holed], &[packet], RayKind::Camera)
        };
        // Check that its middle is reported as wrong
        let middle = at((a + b + c) / 3.0);
        assert_eq!(middle.wrong, BTreeMap::from([(MeshFeature::Other, 1)]));
        assert!(middle.example.is_some() && middle.ties.is_empty());
        let [difference] = middle.differences[..] else {
            panic!("one ray differs");
        };
        assert!(difference.is_wrong && difference.feature == MeshFeature::Other);
        assert!(matches!(
            difference.query_results,
            [QueryResult::Hit { primitive: 7, .. }, QueryResult::Nothing]
        ));
        // Traced again, brute force finds it, and the structure with the hole still misses it.
        let again = |accel: &dyn Accel| retrace(&scene, [&brute, accel], &difference, Instancing::Callback);
        assert_eq!(again(&brute), (difference.query_results[0], HitComparison::Same));
        assert_eq!(again(&holed), (QueryResult::Nothing, HitComparison::Wrong));
        // On the edge, the neighbour may be hit instead: no difference, a tie, or an error at the edge only.
        let edge = at(0.5 * (a + b));
        assert!(!edge.wrong.contains_key(&MeshFeature::Other), "{edge:?}");
        // Check that other triangles do not differ
        assert_eq!(at(-(a + b + c)).rays, 1);
        assert_eq!(at(-(a + b + c)).wrong_count() + at(-(a + b + c)).tie_count(), 0);
    }
}
