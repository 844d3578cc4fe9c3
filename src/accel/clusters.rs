//! Clustering of primitives that are tested together: groups of a few, each with one box in the tree.
//!
//! The primitives are sorted along Morton's curve, the order is cut into chunks, and the surface area heuristic splits
//! each chunk into clusters (see [`splitter`]). A set that fits into a cluster stays whole where that costs no more.

mod cost;
mod splitter;

use glam::{Vec3, Vec3A};

pub(super) use self::cost::Cost;
use self::splitter::{CHUNK, ChunkSplitter};
use crate::accel::morton::{self, Box4, MortonChunk, SortedKeys};
use crate::parallel;

/// A partition of primitives into clusters, in parts of nearby clusters.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Clusters {
    parts: Vec<ClusterPart>,
}

/// Part of the clusters, near each other.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ClusterPart {
    /// Primitives, cluster by cluster, near ones close to each other.
    members: Vec<u32>,
    /// End of each cluster in `members`, ascending.
    ends: Vec<u32>,
}

/// Number of chunks of a part, which is split by one task.
const PART_CHUNKS: usize = 1 << 6;

impl Clusters {
    /// Clusters the primitives in the boxes `bounds(0..count)`, which may have any coordinates; nearly all should lie in
    /// the box `around`. `count` is below 2^32.
    ///
    /// The result does not depend on the number of threads.
    pub(super) fn of(
        count: usize,
        around: &Box4,
        bounds: impl Fn(usize) -> Box4 + Sync,
        cost: &Cost,
    ) -> Clusters {
        // Sort the boxes and cut their order into chunks
        let bounds = |index| finite(&bounds(index));
        let twice_centre = |index| bounds(index).twice_centre();
        let mut keys = morton::sorted(count, &finite(around), twice_centre);
        let chunks = morton::cut(&mut keys, CHUNK, twice_centre);
        // Split the chunks
        let parts = parallel::map_chunks(&chunks, PART_CHUNKS, &|_, chunks| {
            ClusterPart::of(&keys, chunks, bounds, cost)
        });
        Clusters { parts }
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.parts.iter().map(ClusterPart::len).sum()
    }

    /// Returns the clusters in parts, each of which is little work.
    pub(super) fn parts(&self) -> &[ClusterPart] {
        &self.parts
    }

    /// Returns the members of each cluster, in an order in which near ones are close to each other.
    pub(super) fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.parts.iter().flat_map(ClusterPart::iter)
    }
}

impl ClusterPart {
    fn of(
        keys: &SortedKeys,
        chunks: &[MortonChunk],
        bounds: impl Fn(usize) -> Box4,
        cost: &Cost,
    ) -> ClusterPart {
        let mut members = Vec::with_capacity(chunks.iter().map(MortonChunk::len).sum());
        let mut ends = Vec::new();
        let mut splitter = ChunkSplitter::new(cost);
        for chunk in chunks.iter().filter(|chunk| chunk.len() > 0) {
            let number = |index| keys.number(chunk.first + index);
            splitter.split_chunk(chunk.len(), |index| bounds(number(index)));
            let first = members.len();
            ends.extend(splitter.ends().iter().map(|end| (first + end) as u32));
            members.extend(
                splitter
                    .order()
                    .take(chunk.len())
                    .map(|index| number(index) as u32),
            );
        }
        ClusterPart { members, ends }
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Returns the members of each cluster.
    pub(super) fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let mut start = 0;
        self.ends.iter().map(move |&end| {
            let members = &self.members[start..end as usize];
            start = end as usize;
            members
        })
    }
}

/// Returns a box whose coordinates are finite, and so are their sums and differences: infinite ones are moved to the
/// ends of that range, and so is NaN.
#[inline(always)]
fn finite(bounds: &Box4) -> Box4 {
    const MAX_COORDINATE: Vec3A = Vec3A::splat(f32::MAX / 8.0);
    let [low, high] = [bounds.low, bounds.high].map(|corner| {
        // NaN fails the comparison
        let corner = Vec3A::select(corner.cmple(MAX_COORDINATE), corner, MAX_COORDINATE);
        corner.max(-MAX_COORDINATE)
    });
    Box4 { low, high }
}

/// Returns the number of clusters that boxes, each given by its lowest and its highest corner, are grouped into at the
/// costs of spheres, with at most `limit` members each, which is not 0. For the benchmark `timing`.
#[doc(hidden)]
pub fn cluster_count(boxes: &[[Vec3; 2]], limit: u32) -> usize {
    let cost = Cost {
        limit,
        visit: 1.0,
        member: 0.05,
        split: 1.0,
        whole_limit: u32::MAX,
    };
    let bounds = |index: usize| {
        let [low, high] = boxes[index].map(Vec3A::from);
        Box4 { low, high }
    };
    let around = Box4::around(bytemuck::cast_slice(boxes));
    Clusters::of(boxes.len(), &around, bounds, &cost).len()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::numeric::Bounds;

    const COST: Cost = Cost {
        limit: 8,
        visit: 1.0,
        member: 0.05,
        split: 1.0,
        whole_limit: u32::MAX,
    };

    /// Returns point `i` of a sequence that fills the unit cube evenly (Weyl's sequence on the plastic number's
    /// powers).
    fn in_cube(i: u32) -> DVec3 {
        let fraction = |step: f64| (f64::from(i) * step).fract();
        DVec3::new(
            fraction(0.819_172_513_396_164_4),
            fraction(0.671_043_606_703_789_2),
            fraction(0.549_700_477_901_970_2),
        )
    }

    fn around(center: DVec3, radius: f64) -> Bounds {
        Bounds {
            min: center - DVec3::splat(radius),
            max: center + DVec3::splat(radius),
        }
    }

    fn of_boxes(boxes: &[Bounds], cost: &Cost) -> Clusters {
        let corner = |p: DVec3| Vec3A::from(p.as_vec3());
        let bounds = |i: usize| Box4 {
            low: corner(boxes[i].min),
            high: corner(boxes[i].max),
        };
        let mut around = Box4::EMPTY;
        (0..boxes.len()).for_each(|i| around.add(&bounds(i)));
        Clusters::of(boxes.len(), &around, bounds, cost)
    }

    /// Asserts that every primitive is in one cluster and no cluster is empty or too large.
    fn assert_parted(clusters: &Clusters, count: usize, limit: usize) {
        let mut members: Vec<u32> = clusters.iter().flatten().copied().collect();
        members.sort_unstable();
        assert!(members.into_iter().eq(0..count as u32));
        assert!(
            clusters
                .iter()
                .all(|members| (1..=limit).contains(&members.len()))
        );
        assert_eq!(clusters.iter().map(<[u32]>::len).sum::<usize>(), count);
        assert_eq!(clusters.iter().count(), clusters.len());
    }

    #[test]
    fn every_primitive_is_in_one_cluster_of_limited_size() {
        for limit in [1, 3, 8, 16, 100] {
            for count in [0, 1, 2, 7, 8, 9, 31, 32, 33, 1000, 40_000] {
                let boxes: Vec<Bounds> = (0..count).map(|i| around(in_cube(i), 0.01)).collect();
                let clusters = of_boxes(&boxes, &Cost { limit, ..COST });
                assert_parted(&clusters, boxes.len(), limit as usize);
            }
        }
    }

    #[test]
    fn clusters_do_not_depend_on_thread_count() {
        let boxes: Vec<Bounds> = (0..100_000).map(|i| around(in_cube(i), 0.01)).collect();
        let by = |threads| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| of_boxes(&boxes, &COST))
        };
        let alone = by(1);
        assert_eq!(alone, by(2));
        assert_eq!(alone, by(5));
    }

    #[test]
    fn close_boxes_share_a_cluster() {
        // Eight beside the origin and eight a hundred away, alternating.
        let at = |i: u32| DVec3::new(100.0 * f64::from(i % 2) + 0.1 * f64::from(i / 2), 0.0, 0.0);
        let boxes: Vec<Bounds> = (0..16).map(|i| around(at(i), 0.1)).collect();
        let clusters = of_boxes(&boxes, &COST);
        let found: Vec<&[u32]> = clusters.iter().collect();
        assert_eq!(found, [[0, 2, 4, 6, 8, 10, 12, 14], [1, 3, 5, 7, 9, 11, 13, 15]]);
    }

    #[test]
    fn distant_boxes_are_in_separate_clusters() {
        // Half areas: 12 of each cube, 4 + 2 · 204 = 412 of both. Together (1 + 0.1 - 1) 412 = 41.2, separate 2 · 1.05
        // · 12 = 25.2.
        let boxes = [0.0, 100.0].map(|x| around(DVec3::new(x, 0.0, 0.0), 1.0));
        assert_eq!(of_boxes(&boxes, &COST).len(), 2);
        // If members cost nothing, the two are one cluster at any distance.
        let free = Cost { member: 0.0, ..COST };
        assert_eq!(of_boxes(&boxes, &free).len(), 1);
    }

    #[test]
    fn clusters_are_nearly_full() {
        let boxes: Vec<Bounds> = (0..20_000).map(|i| around(in_cube(i), 0.02)).collect();
        let mean = 20_000.0 / of_boxes(&boxes, &COST).len() as f64;
        assert!(mean > 0.85 * 8.0, "{mean}");
    }

    #[test]
    fn indistinguishable_boxes_are_split_by_count() {
        let everything = Bounds {
            min: DVec3::NEG_INFINITY,
            max: DVec3::INFINITY,
        };
        let unknown = Bounds {
            min: DVec3::NAN,
            max: DVec3::NAN,
        };
        let point = around(DVec3::splat(3.0), 0.0);
        for bounds in [
            everything,
            unknown,
            point,
            Bounds::EMPTY,
            around(DVec3::ZERO, 1e300),
        ] {
            let clusters = of_boxes(&vec![bounds; 1000], &COST);
            assert_parted(&clusters, 1000, 8);
            assert_eq!(clusters.len(), 125);
        }
    }

    #[test]
    fn infinite_boxes_do_not_affect_the_other_clusters() {
        let mut boxes: Vec<Bounds> = (0..10_000).map(|i| around(in_cube(i), 0.01)).collect();
        boxes[77].max.x = f64::INFINITY;
        boxes[777].min = DVec3::NEG_INFINITY;
        boxes[7777].min = DVec3::NAN;
        let clusters = of_boxes(&boxes, &COST);
        assert_parted(&clusters, boxes.len(), 8);
        let diagonal = |members: &[u32]| {
            let all = members.iter().map(|&i| boxes[i as usize]);
            all.fold(Bounds::EMPTY, Bounds::union).extent().length()
        };
        let large = clusters
            .iter()
            .filter(|members| !(diagonal(members) < 0.5))
            .count();
        assert!(large <= 8, "{large}");
    }

    #[test]
    fn shrinking_boxes_are_split_a_limited_number_of_times() {
        let boxes: Vec<Bounds> = (0..5000)
            .map(|i| around(DVec3::splat(0.99f64.powi(i)), 0.5 * 0.99f64.powi(i)))
            .collect();
        assert_parted(&of_boxes(&boxes, &COST), boxes.len(), 8);
    }
}
