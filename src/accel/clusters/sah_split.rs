//! Best split of a set of boxes in two by the surface area heuristic (Goldsmith and Salmon, "Automatic creation of
//! object hierarchies for ray tracing", 1987): perpendicular to one axis, by the midpoints of the boxes, with the least
//! sum of the halves' areas times the cost of testing them. A large set is split at the borders of bins (Wald, "On fast
//! construction of SAH-based bounding volume hierarchies", 2007), a small one at any position.

use glam::DVec3;

use super::cost::Cost;
use super::item::Item;
use crate::numeric::Bounds;
use crate::parallel;

/// Number of boxes that a thread bins at once.
const CHUNK: usize = 1 << 14;
/// Number of bins along an axis for a large set, one more than its candidate positions.
const BINS: usize = 16;
/// Largest size of sets that are split at any position.
const SWEEP_COUNT: usize = 32;
/// Size above which a set that fits into a cluster is checked by [`may_pay_to_split`] before its best split is searched.
const TRIAL_COUNT: usize = 8;

/// Partitions a set in two and returns the size of the first half; `None` if the set is a cluster.
pub(super) fn split(items: &mut [Item], cost: &Cost, splits_left: u32) -> Option<usize> {
    let count = items.len();
    let limit = cost.limit as usize;
    let fits = count <= limit;
    if count == 1 || (fits && count > TRIAL_COUNT && !may_pay_to_split(items, cost)) {
        return None;
    }
    let found = match splits_left {
        0 => None,
        _ if count <= SWEEP_COUNT => sweep(items, cost),
        _ => bin(items, cost),
    };
    // A set that fits is split only if that is cheaper; another one always
    match found {
        Some((_, at)) if !fits => Some(at),
        Some((halves, at)) => (halves < (cost.of(count as u32) - cost.split) * area_of(items)).then_some(at),
        None => (!fits).then(|| (count / 2).next_multiple_of(limit).min(count - 1)),
    }
}

/// Returns whether it might pay to split a set that fits into a cluster, by a trial split across the middle of its
/// longest side. The halves cost at least a visit each, relative to the probability of reaching them.
fn may_pay_to_split(items: &[Item], cost: &Cost) -> bool {
    let whole = items
        .iter()
        .fold(Extent::EMPTY, |whole, item| whole.with(&Extent::of(item)));
    let length = |axis: &usize| whole.max[*axis] - whole.min[*axis];
    let Some(axis) = (0..3).max_by(|a, b| length(a).total_cmp(&length(b))) else {
        return true;
    };
    let middle = 0.5 * (whole.min[axis] + whole.max[axis]);
    let mut halves = [Extent::EMPTY; 2];
    for item in items {
        let half = usize::from(item.center(axis) > middle);
        halves[half] = halves[half].with(&Extent::of(item));
    }
    let least = cost.visit * (halves[0].half_area() + halves[1].half_area());
    least < (cost.of(items.len() as u32) - cost.split) * whole.half_area()
}

/// A growing box. The fourth components are unused.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    min: [f32; 4],
    max: [f32; 4],
}

impl Extent {
    const EMPTY: Extent = Extent {
        min: [f32::INFINITY; 4],
        max: [f32::NEG_INFINITY; 4],
    };

    fn of(item: &Item) -> Extent {
        let padded = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        Extent {
            min: padded(item.min),
            max: padded(item.max),
        }
    }

    fn of_centers(item: &Item) -> Extent {
        let center = [item.center(0), item.center(1), item.center(2), 0.0];
        Extent {
            min: center,
            max: center,
        }
    }

    #[inline(always)]
    fn with(mut self, other: &Extent) -> Extent {
        for i in 0..4 {
            self.min[i] = if other.min[i] < self.min[i] {
                other.min[i]
            } else {
                self.min[i]
            };
            self.max[i] = if other.max[i] > self.max[i] {
                other.max[i]
            } else {
                self.max[i]
            };
        }
        self
    }

    /// Returns the box in f64; an empty box stays empty.
    pub(super) fn bounds(&self) -> Bounds {
        let point = |[x, y, z, _]: [f32; 4]| DVec3::new(x.into(), y.into(), z.into());
        Bounds {
            min: point(self.min),
            max: point(self.max),
        }
    }

    /// Returns half the surface area; 0 for an empty box.
    #[inline(always)]
    fn half_area(&self) -> f64 {
        let edge = |axis: usize| (f64::from(self.max[axis]) - f64::from(self.min[axis])).max(0.0);
        let [x, y, z] = [edge(0), edge(1), edge(2)];
        x * y + y * z + z * x
    }
}

fn area_of(items: &[Item]) -> f64 {
    let whole = items
        .iter()
        .fold(Extent::EMPTY, |whole, item| whole.with(&Extent::of(item)));
    whole.half_area()
}

/// Sorts a small set along the axis of its best split; returns the cost of the halves and the size of the first.
fn sweep(items: &mut [Item], cost: &Cost) -> Option<(f64, usize)> {
    let count = items.len();
    if area_of(items) == 0.0 {
        return None;
    }
    let costs: [f64; SWEEP_COUNT + 1] = std::array::from_fn(|count| cost.of(count as u32));
    let mut orders = [[0u64; SWEEP_COUNT]; 3];
    let mut best: Option<(f64, usize, usize)> = None;
    for (axis, order) in orders.iter_mut().enumerate() {
        // Sort by the midpoint, then by the index, packed into one word
        for (number, (place, item)) in (0u64..).zip(order.iter_mut().zip(&*items)) {
            *place = u64::from(rank(item.center(axis))) << 32 | number;
        }
        order[..count].sort_unstable();
        let extent = |i: usize| Extent::of(&items[order[i] as u32 as usize]);
        // Sweep from above and below to get the cost of every split
        let mut above = [0.0; SWEEP_COUNT];
        let mut grown = Extent::EMPTY;
        for i in (1..count).rev() {
            grown = grown.with(&extent(i));
            above[i] = grown.half_area() * costs[count - i];
        }
        grown = Extent::EMPTY;
        for i in 1..count {
            grown = grown.with(&extent(i - 1));
            let halves = grown.half_area() * costs[i] + above[i];
            if best.is_none_or(|(least, ..)| halves < least) {
                best = Some((halves, axis, i));
            }
        }
    }
    let (halves, axis, split) = best?;
    // Put the items in the order of the best axis
    let mut sorted = [items[0]; SWEEP_COUNT];
    for (to, &place) in sorted.iter_mut().zip(&orders[axis][..count]) {
        *to = items[place as u32 as usize];
    }
    items.copy_from_slice(&sorted[..count]);
    Some((halves, split))
}

/// Returns an integer that orders as the float does, including the sign of zero.
#[inline(always)]
fn rank(x: f32) -> u32 {
    let bits = x.to_bits();
    // Negative floats increase as their bits decrease.
    bits ^ ((bits as i32 >> 31) as u32 | 1 << 31)
}

/// Contents of the bins of each axis.
#[derive(Clone)]
struct SplitBins {
    extents: [[Extent; BINS]; 3],
    counts: [[u32; BINS]; 3],
}

/// Position and width of the bins along each axis.
#[derive(Clone, Copy)]
struct Scale {
    start: [f32; 3],
    bins_per_unit: [f32; 3],
}

impl Scale {
    fn over(centers: &Extent) -> Scale {
        let [x, y, z, _] = centers.min;
        Scale {
            start: [x, y, z],
            // Infinite if all centres are equal: 0 · infinity is NaN, which converts to the first bin, as does
            // everything else.
            bins_per_unit: [0, 1, 2].map(|axis| BINS as f32 / (centers.max[axis] - centers.min[axis])),
        }
    }

    #[inline(always)]
    fn bin(&self, item: &Item, axis: usize) -> usize {
        (((item.center(axis) - self.start[axis]) * self.bins_per_unit[axis]) as usize).min(BINS - 1)
    }
}

impl SplitBins {
    const EMPTY: SplitBins = SplitBins {
        extents: [[Extent::EMPTY; BINS]; 3],
        counts: [[0; BINS]; 3],
    };

    fn of(items: &[Item], scale: &Scale) -> SplitBins {
        let mut bins = SplitBins::EMPTY;
        for item in items {
            let extent = Extent::of(item);
            for axis in 0..3 {
                let bin = scale.bin(item, axis);
                bins.extents[axis][bin] = bins.extents[axis][bin].with(&extent);
                bins.counts[axis][bin] += 1;
            }
        }
        bins
    }

    fn sum(mut self, other: SplitBins) -> SplitBins {
        for axis in 0..3 {
            for bin in 0..BINS {
                self.extents[axis][bin] = self.extents[axis][bin].with(&other.extents[axis][bin]);
                self.counts[axis][bin] += other.counts[axis][bin];
            }
        }
        self
    }

    /// Returns the least cost of two halves, with the axis and the bin before which to split.
    fn best(&self, cost: &Cost) -> Option<(f64, usize, usize)> {
        let mut best: Option<(f64, usize, usize)> = None;
        for axis in 0..3 {
            let (extents, counts) = (&self.extents[axis], &self.counts[axis]);
            let half = |extent: &Extent, count: u32| extent.half_area() * cost.of(count);
            // Sum up the bins from above
            let mut above = [(0.0, 0); BINS];
            let (mut grown, mut count) = (Extent::EMPTY, 0);
            for bin in (1..BINS).rev() {
                grown = grown.with(&extents[bin]);
                count += counts[bin];
                above[bin] = (half(&grown, count), count);
            }
            // Sum up the bins from below and keep the cheapest split
            (grown, count) = (Extent::EMPTY, 0);
            for bin in 1..BINS {
                grown = grown.with(&extents[bin - 1]);
                count += counts[bin - 1];
                let halves = half(&grown, count) + above[bin].0;
                let is_split = count > 0 && above[bin].1 > 0;
                if is_split && best.is_none_or(|(least, ..)| halves < least) {
                    best = Some((halves, axis, bin));
                }
            }
        }
        best
    }
}

/// Partitions a large set at the best bin border; returns the cost of the halves and the size of the first.
fn bin(items: &mut [Item], cost: &Cost) -> Option<(f64, usize)> {
    let scale = Scale::over(&centers(items));
    let bins = if is_large(items) {
        let chunks = parallel::map_chunks(items, CHUNK, &|_, chunk| SplitBins::of(chunk, &scale));
        chunks.into_iter().fold(SplitBins::EMPTY, SplitBins::sum)
    } else {
        SplitBins::of(items, &scale)
    };
    let (halves, axis, border) = bins.best(cost)?;
    Some((halves, part(items, |item| scale.bin(item, axis) < border)))
}

/// Returns the bounding box of the midpoints of a set.
pub(super) fn centers(items: &[Item]) -> Extent {
    let around = |items: &[Item]| {
        let all = items.iter().map(Extent::of_centers);
        all.fold(Extent::EMPTY, |whole, center| whole.with(&center))
    };
    if !is_large(items) {
        return around(items);
    }
    let chunks = parallel::map_chunks(items, CHUNK, &|_, chunk| around(chunk));
    chunks.iter().fold(Extent::EMPTY, |whole, part| whole.with(part))
}

/// Returns whether a set is large enough for several threads.
fn is_large(items: &[Item]) -> bool {
    items.len() >= 2 * CHUNK
}

/// Partitions `items` so that those with `is_first` come first, and returns their number.
pub(super) fn part<T>(items: &mut [T], is_first: impl Fn(&T) -> bool) -> usize {
    let (mut low, mut high) = (0, items.len());
    loop {
        while low < high && is_first(&items[low]) {
            low += 1;
        }
        while low < high && !is_first(&items[high - 1]) {
            high -= 1;
        }
        if low >= high {
            return low;
        }
        items.swap(low, high - 1);
        low += 1;
        high -= 1;
    }
}
