//! Splitting of a chunk of boxes into clusters by the surface area heuristic (Goldsmith and Salmon, "Automatic creation
//! of object hierarchies for ray tracing", 1987): a set is split perpendicular to one axis, by the midpoints of the
//! boxes, with the least sum of the halves' areas times the cost of testing them, at the borders of bins (Wald, "On fast
//! construction of SAH-based bounding volume hierarchies", 2007).

use std::ops::Range;

use glam::Vec3A;

use super::cost::Cost;
use crate::accel::morton::Box4;

/// Maximum number of boxes of a chunk, a power of two. Larger ones make better clusters and take longer.
pub(super) const CHUNK: usize = 1 << 7;
/// Maximum number of bins along an axis, one more than its candidate positions.
const BINS: usize = 16;
/// Number of bins along an axis for small sets, whose boxes mostly have a bin of their own then, too.
const FEW_BINS: usize = 8;
/// Largest number of boxes of a small set.
const FEW: usize = 32;
/// Size above which a set that fits into a cluster is checked by [`ChunkSplitter::may_pay_to_split`] before its best
/// split is searched.
const TRIAL_COUNT: usize = 2;

/// Boxes of a chunk, which are split into clusters.
pub(super) struct ChunkSplitter {
    cost: Cost,
    /// Cost of testing each number of members.
    costs: [f32; CHUNK + 1],
    boxes: [Box4; CHUNK],
    /// Indices of the boxes, set by set.
    order: [u8; CHUNK],
    /// Bins along each axis at each position of the order, in the set that is split.
    places: [[u8; 4]; CHUNK],
    /// Position after the last member of each cluster.
    ends: Vec<usize>,
}

/// Split of a set before a bin along an axis.
#[derive(Clone, Copy)]
struct BinSplit {
    cost: f32,
    axis: usize,
    bin: usize,
}

impl ChunkSplitter {
    pub(super) fn new(cost: &Cost) -> ChunkSplitter {
        ChunkSplitter {
            cost: *cost,
            costs: std::array::from_fn(|count| cost.of(count)),
            boxes: [Box4::EMPTY; CHUNK],
            order: [0; CHUNK],
            places: [[0; 4]; CHUNK],
            ends: Vec::with_capacity(CHUNK),
        }
    }

    /// Splits the boxes `bounds(0..count)`, of which there are one to [`CHUNK`].
    pub(super) fn split_chunk(&mut self, count: usize, bounds: impl Fn(usize) -> Box4) {
        for index in 0..count {
            self.boxes[index] = bounds(index);
            self.order[index] = index as u8;
        }
        self.ends.clear();
        self.split_set(0..count);
    }

    /// Returns the indices of the boxes, cluster by cluster.
    pub(super) fn order(&self) -> impl Iterator<Item = usize> {
        self.order.iter().map(|&index| usize::from(index))
    }

    /// Returns the position after the last member of each cluster, ascending.
    pub(super) fn ends(&self) -> &[usize] {
        &self.ends
    }

    /// Splits a set, at least one, into clusters.
    fn split_set(&mut self, set: Range<usize>) {
        // Keep a set that fits unless a split is cheaper
        let count = set.len();
        let fits = count <= self.cost.limit as usize;
        if count == 1 || (fits && count > TRIAL_COUNT && !self.may_pay_to_split(set.clone())) {
            return self.ends.push(set.end);
        }
        let best = if count <= FEW {
            self.best_split::<FEW_BINS>(set.clone(), fits)
        } else {
            self.best_split::<BINS>(set.clone(), fits)
        };
        if fits && best.is_none() {
            return self.ends.push(set.end);
        }
        // Split in the middle where there is no best split
        let first_count = match best {
            Some(best) => self.partition(set.clone(), &best),
            None => (count / 2)
                .next_multiple_of(self.cost.limit as usize)
                .min(count - 1),
        };
        let middle = set.start + first_count;
        self.split_set(set.start..middle);
        self.split_set(middle..set.end);
    }

    /// Returns the box at a position of the order.
    #[inline(always)]
    fn at(&self, position: usize) -> &Box4 {
        &self.boxes[usize::from(self.order[position]) % CHUNK]
    }

    /// Returns whether it might pay to split a set that fits into a cluster, by a trial split across the middle of its
    /// longest side. The halves cost at least a visit each, relative to the probability of reaching them.
    fn may_pay_to_split(&self, set: Range<usize>) -> bool {
        let mut whole = Box4::EMPTY;
        for position in set.clone() {
            whole.add(self.at(position));
        }
        let axis = (whole.high - whole.low).max_position();
        let middle = whole.twice_centre()[axis];
        let mut halves = [Box4::EMPTY; 2];
        let count = set.len();
        for position in set {
            let bounds = self.at(position);
            halves[usize::from(bounds.twice_centre()[axis] > middle)].add(bounds);
        }
        let least = self.cost.visit * (half_area(&halves[0]) + half_area(&halves[1]));
        least < self.max_cost(count, &whole)
    }

    /// Returns the cost of testing the members of a set in one cluster, less the cost of a split.
    fn max_cost(&self, count: usize, bounds: &Box4) -> f32 {
        (self.costs[count] - self.cost.split) * bounds.half_area()
    }

    /// Returns the split of least cost between `N` bins an axis, and stores the bins of the set. Returns `None` if all
    /// midpoints are in one bin, if no cost is finite, or if the set fits into a cluster that costs no more.
    fn best_split<const N: usize>(&mut self, set: Range<usize>, fits: bool) -> Option<BinSplit> {
        // Bound the midpoints
        let mut centres = Box4::EMPTY;
        for position in set.clone() {
            centres.add_point(self.at(position).twice_centre());
        }
        // Not finite if all midpoints are equal: everything converts to one bin
        let bins_per_unit = Vec3A::splat(N as f32) / (centres.high - centres.low);
        // Fill the bins
        let mut bins = [[Box4::EMPTY; N]; 3];
        let mut counts = [[0usize; N]; 3];
        for position in set.clone() {
            let bounds = *self.at(position);
            let place = ((bounds.twice_centre() - centres.low) * bins_per_unit).to_array();
            for axis in 0..3 {
                let bin = (place[axis] as i32 as usize).min(N - 1);
                bins[axis][bin].add(&bounds);
                counts[axis][bin] += 1;
                self.places[position][axis] = bin as u8;
            }
        }
        // Compare the borders along every axis with each other and with the whole set
        let mut whole = Box4::EMPTY;
        bins[0].iter().for_each(|bin| whole.add(bin));
        let mut best = BinSplit {
            cost: if fits {
                self.max_cost(set.len(), &whole)
            } else {
                f32::INFINITY
            },
            axis: 0,
            bin: 0,
        };
        for axis in 0..3 {
            self.compare_borders(&bins[axis], &counts[axis], axis, &mut best);
        }
        (best.bin > 0).then_some(best)
    }

    /// Replaces `best` by the cheapest border between bins along an axis that is cheaper.
    #[inline(always)]
    fn compare_borders<const N: usize>(
        &self,
        bins: &[Box4; N],
        counts: &[usize; N],
        axis: usize,
        best: &mut BinSplit,
    ) {
        // Sum up the bins from above
        let mut above = [f32::INFINITY; N];
        let (mut grown, mut count) = (Box4::EMPTY, 0);
        for bin in (1..N).rev() {
            grown.add(&bins[bin]);
            count += counts[bin];
            if count > 0 {
                above[bin] = grown.half_area() * self.costs[count % (CHUNK + 1)];
            }
        }
        // Sum up the bins from below
        (grown, count) = (Box4::EMPTY, 0);
        for bin in 1..N {
            grown.add(&bins[bin - 1]);
            count += counts[bin - 1];
            let cost = grown.half_area() * self.costs[count % (CHUNK + 1)] + above[bin];
            if count > 0 && cost < best.cost {
                *best = BinSplit { cost, axis, bin };
            }
        }
    }

    /// Moves the members of a set behind a border to its end, in their order, and returns the number of the others.
    fn partition(&mut self, set: Range<usize>, split: &BinSplit) -> usize {
        let mut behind = [0; CHUNK];
        let (mut low_count, mut behind_count) = (0, 0);
        for position in set.clone() {
            let index = self.order[position];
            let is_low = usize::from(self.places[position][split.axis]) < split.bin;
            self.order[set.start + low_count] = index;
            behind[behind_count % CHUNK] = index;
            low_count += usize::from(is_low);
            behind_count += usize::from(!is_low);
        }
        self.order[set.start + low_count..set.end].copy_from_slice(&behind[..behind_count]);
        low_count
    }
}

/// Returns half the surface area of a box; 0 if it is empty.
#[inline(always)]
fn half_area(bounds: &Box4) -> f32 {
    if bounds.low.x <= bounds.high.x {
        bounds.half_area()
    } else {
        0.0
    }
}
