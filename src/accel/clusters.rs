//! Clustering of primitives that are tested together: groups of a few, each with one box in the tree.
//!
//! Clustering is top-down: a large set is split in the middle of its octree cell, along the Morton curve, a small one
//! where the surface area heuristic says (see [`sah_split`]). A set that fits into a cluster stays whole where that
//! costs no more. The cost of a test has a part per cluster and a part per member, which alone makes clusters full: a
//! set of seventeen is better split into eight and nine than into one and sixteen.

mod cost;
mod item;
mod sah_split;

use glam::Vec3;

pub(super) use self::cost::Cost;
use self::item::Item;
use self::sah_split::{centers, part, split};
use crate::numeric::morton::{CODE_BITS, MortonCurve};
use crate::parallel;

/// A partition of primitives into clusters.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Clusters {
    /// All primitives, cluster by cluster, near ones close to each other.
    members: Vec<u32>,
    /// End of each cluster in `members`, ascending.
    ends: Vec<u32>,
}

/// Size above which sets are split through the middle of octree cells, which costs next to nothing, and only below it
/// at the best plane: the last few splits decide the quality of the clusters.
const CELL_COUNT: usize = 1 << 8;
/// Least size of sets that are split by several threads.
const PARALLEL_COUNT: usize = 1 << 12;
/// Number of splits after which sets are halved by index: whatever the boxes, the work stays proportional to n log n.
const SPLIT_LIMIT: u32 = 64;

impl Clusters {
    /// Clusters the primitives in the boxes `bounds(0..count)`, each given by its lowest and its highest corner, which
    /// may be any number; `count` is below 2^32.
    ///
    /// The result does not depend on the number of threads.
    pub(super) fn of(count: usize, bounds: impl Fn(u32) -> [Vec3; 2] + Sync, cost: &Cost) -> Clusters {
        // Compute a Morton key for the midpoint of each box
        let of_index = |index: u32| Item::new(index, bounds(index));
        let unsorted = parallel::generate(count, |index| of_index(index as u32));
        let curve = MortonCurve::around(&centers(&unsorted).bounds());
        let mut keys = parallel::generate(count, |index| ClusterKey::new(&unsorted[index], &curve));
        // Allocate zeroed pages without writing to them
        let mut items: Vec<Item> = bytemuck::zeroed_vec(count);
        if count > 0 {
            divide_cell(&mut items, &mut keys, &unsorted, KEY_DIGITS, cost);
        }
        Clusters {
            members: items.iter().map(|item| item.index).collect(),
            ends: (1u32..)
                .zip(&items)
                .filter_map(|(end, item)| item.is_last().then_some(end))
                .collect(),
        }
    }

    /// Returns the number of clusters.
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Returns the members of each cluster, in an order in which near ones are close to each other.
    pub(super) fn iter(&self) -> impl Iterator<Item = &[u32]> {
        let mut start = 0;
        self.ends.iter().map(move |&end| {
            let members = &self.members[start..end as usize];
            start = end as usize;
            members
        })
    }
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
    };
    Clusters::of(boxes.len(), |i| boxes[i as usize], &cost).len()
}

/// The octree cell of a box.
#[derive(Clone, Copy, bytemuck::Zeroable)]
struct ClusterKey {
    /// The first [`KEY_DIGITS`] binary digits of its position along the curve.
    cell: u32,
    index: u32,
}

/// Number of binary digits of a cell's key: ten of each coordinate.
const KEY_DIGITS: u32 = 30;

impl ClusterKey {
    fn new(item: &Item, curve: &MortonCurve) -> ClusterKey {
        ClusterKey {
            cell: (curve.code(item.midpoint()) >> (CODE_BITS - KEY_DIGITS)) as u32,
            index: item.index,
        }
    }
}

/// Clusters the boxes in an octree cell, of which there is at least one, and marks the last member of every cluster.
/// The boxes are those of `keys` out of `all`; their keys differ in the last `digits` alone. They are written to
/// `items`, cluster by cluster.
fn divide_cell(items: &mut [Item], keys: &mut [ClusterKey], all: &[Item], digits: u32, cost: &Cost) {
    // Hand small sets, and sets in one finest cell, to the surface area heuristic
    let Some(digits) = digits.checked_sub(1).filter(|_| keys.len() > CELL_COUNT) else {
        for (item, key) in items.iter_mut().zip(&*keys) {
            *item = all[key.index as usize];
        }
        return divide(items, cost, SPLIT_LIMIT);
    };
    // Partition by the next digit of the key
    let split = part(keys, |key| key.cell >> digits & 1 == 0);
    if split == 0 || split == keys.len() {
        return divide_cell(items, keys, all, digits, cost);
    }
    let ((low, high), (low_keys, high_keys)) = (items.split_at_mut(split), keys.split_at_mut(split));
    parallel::join(
        || divide_cell(low, low_keys, all, digits, cost),
        || divide_cell(high, high_keys, all, digits, cost),
    );
}

/// Clusters a non-empty set, which it sorts, and marks the last member of every cluster.
fn divide(items: &mut [Item], cost: &Cost, splits_left: u32) {
    let Some(split) = split(items, cost, splits_left) else {
        if let Some(last) = items.last_mut() {
            last.last = 1;
        }
        return;
    };
    let is_large = items.len() >= PARALLEL_COUNT;
    let (low, high) = items.split_at_mut(split);
    let splits_left = splits_left.saturating_sub(1);
    if is_large {
        parallel::join(
            || divide(low, cost, splits_left),
            || divide(high, cost, splits_left),
        );
    } else {
        divide(low, cost, splits_left);
        divide(high, cost, splits_left);
    }
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
        let bounds = |i: u32| [boxes[i as usize].min, boxes[i as usize].max].map(|corner| corner.as_vec3());
        Clusters::of(boxes.len(), bounds, cost)
    }

    /// Asserts that every primitive is in one cluster and no cluster is empty or too large.
    fn assert_parted(clusters: &Clusters, count: usize, limit: usize) {
        let mut members = clusters.members.clone();
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
