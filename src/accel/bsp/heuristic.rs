//! Choice of the splitting plane of a cell: least expected cost by the surface area heuristic.
//!
//! A leaf tests its triangles eight at a time, so its cost is a step function, and memory rather than arithmetic limits
//! large scenes: visiting a node and testing a pack cost the same, which makes leaves of 15-25 triangles (measured; the
//! textbook ratios make far deeper trees that are slower and twice as large).

use super::piece::{CellBounds, PrimitivePiece};
use crate::mesh::simd::{SimdKernel, SimdLevel, dispatch};
use crate::mesh::triangle::PACK;
use crate::parallel;

/// Cost of visiting a node, in tests of a pack of triangles.
const NODE_COST: f32 = 1.0;
/// Number of packs above which a leaf costs more than its packs: it is read from memory, and nothing hides the latency.
const LONG_LEAF_PACKS: f32 = 4.0;
/// Cost factor of such a long leaf.
const LONG_LEAF_FACTOR: f32 = 1.2;
/// Largest number of pieces for which every bound of every piece is a candidate plane.
pub(super) const EXACT_COUNT: usize = 64;
/// Number of bins of a larger cell along each axis; the candidate planes are their borders.
const BINS: usize = 32;
/// Number of pieces above which several threads count a cell.
const PARALLEL_COUNT: usize = 1 << 16;
/// Number of pieces that a thread counts at once.
const CHUNK: usize = 1 << 14;
/// Number of candidate planes evaluated at once.
const WIDTH: usize = 16;

/// A splitting plane with its cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SplitPlane {
    /// Axis that the plane is perpendicular to.
    pub(super) axis: usize,
    /// Coordinate of the plane on that axis.
    pub(super) position: f32,
    /// Expected cost of the two halves.
    pub(super) cost: f32,
}

/// Returns the expected cost of testing all `count` pieces of a leaf.
#[inline(always)]
fn leaf_cost(count: f32) -> f32 {
    let packs = count * (1.0 / PACK as f32);
    if packs > LONG_LEAF_PACKS {
        LONG_LEAF_FACTOR * packs
    } else {
        packs.ceil()
    }
}

/// Returns the best plane to split a cell, or `None` if a leaf is cheaper or no plane leaves less on both sides. At
/// most `spare` pieces may be split in two.
pub(super) fn best_plane(pieces: &[PrimitivePiece], cell: &CellBounds, spare: usize) -> Option<SplitPlane> {
    let area = cell.half_area();
    if pieces.len() <= PACK || !(area.is_finite() && area > 0.0) {
        return None;
    }
    // Evaluate every bound of a small cell, and bin borders of a large one
    let plane = if pieces.len() <= EXACT_COUNT {
        dispatch(ExactPlane(pieces, cell, spare))
    } else {
        let bins = if pieces.len() > PARALLEL_COUNT {
            let chunks = parallel::map_chunks(pieces, CHUNK, &|_, chunk| dispatch(CountBins(chunk, cell)));
            chunks.into_iter().fold(Bins::default(), Bins::sum)
        } else {
            dispatch(CountBins(pieces, cell))
        };
        bins.best_plane(pieces.len(), cell, spare)
    };
    // The estimate looks one split ahead. Among long triangles no single split pays and many do, so a large cell is
    // split as long as the allowance for duplicates lasts.
    plane.filter(|plane| pieces.len() > EXACT_COUNT || plane.cost < leaf_cost(pieces.len() as f32))
}

/// Cost of splitting a cell at planes perpendicular to one axis.
struct SplitCost {
    low: f32,
    high: f32,
    /// Half area at zero thickness, and its growth with thickness; both relative to the half area of the cell.
    flat: f32,
    slope: f32,
}

impl SplitCost {
    #[inline]
    fn new(cell: &CellBounds, axis: usize) -> SplitCost {
        let extent = cell.extent();
        let (a, b) = (extent[(axis + 1) % 3], extent[(axis + 2) % 3]);
        let scale = cell.half_area().recip();
        SplitCost {
            low: cell.low[axis],
            high: cell.high[axis],
            flat: a * b * scale,
            slope: (a + b) * scale,
        }
    }

    #[inline(always)]
    fn cost(&self, position: f32, left_count: f32, right_count: f32) -> f32 {
        NODE_COST
            + (self.flat + self.slope * (position - self.low)) * leaf_cost(left_count)
            + (self.flat + self.slope * (self.high - position)) * leaf_cost(right_count)
    }
}

/// Numbers of pieces that begin and end in each bin, by axis.
struct Bins {
    begin: [[u32; BINS]; 3],
    end: [[u32; BINS]; 3],
}

impl Default for Bins {
    fn default() -> Bins {
        Bins {
            begin: [[0; BINS]; 3],
            end: [[0; BINS]; 3],
        }
    }
}

impl Bins {
    fn sum(mut self, other: Bins) -> Bins {
        let add = |a: &mut [[u32; BINS]; 3], b: &[[u32; BINS]; 3]| {
            for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
                *a += b;
            }
        };
        add(&mut self.begin, &other.begin);
        add(&mut self.end, &other.end);
        self
    }

    fn best_plane(&self, count: usize, cell: &CellBounds, spare: usize) -> Option<SplitPlane> {
        let extent = cell.extent();
        let mut best: Option<SplitPlane> = None;
        for axis in 0..3 {
            let costs = SplitCost::new(cell, axis);
            let (mut left, mut right) = (0, count);
            for border in 1..BINS {
                left += self.begin[axis][border - 1] as usize;
                right -= self.end[axis][border - 1] as usize;
                let position = cell.low[axis] + extent[axis] * (border as f32 / BINS as f32);
                let inside = cell.low[axis] < position && position < cell.high[axis];
                if !inside || left == count || right == count || left + right > count + spare {
                    continue;
                }
                let cost = costs.cost(position, left as f32, right as f32);
                if best.is_none_or(|b| cost < b.cost) {
                    best = Some(SplitPlane { axis, position, cost });
                }
            }
        }
        best
    }
}

#[inline(always)]
fn count_bins(pieces: &[PrimitivePiece], cell: &CellBounds) -> Bins {
    let mut bins = Bins::default();
    let extent = cell.extent();
    // A flat cell puts everything into bin 0, where no plane is evaluated.
    let mut scale = [0.0; 3];
    for axis in 0..3 {
        if extent[axis] > 0.0 {
            scale[axis] = (BINS as f32 / extent[axis]).min(f32::MAX);
        }
    }
    for piece in pieces {
        for axis in 0..3 {
            let slice = |x: f32| ((x - cell.low[axis]) * scale[axis]) as usize;
            bins.begin[axis][slice(piece.low[axis]).min(BINS - 1)] += 1;
            bins.end[axis][slice(piece.high[axis]).min(BINS - 1)] += 1;
        }
    }
    bins
}

/// [`count_bins`] as a SIMD kernel.
struct CountBins<'a>(&'a [PrimitivePiece], &'a CellBounds);

impl SimdKernel for CountBins<'_> {
    type Output = Bins;

    #[inline(always)]
    fn run<I: SimdLevel>(self, _: I) -> Bins {
        count_bins(self.0, self.1)
    }
}

/// [`exact_plane`] as a SIMD kernel.
struct ExactPlane<'a>(&'a [PrimitivePiece], &'a CellBounds, usize);

impl SimdKernel for ExactPlane<'_> {
    type Output = Option<SplitPlane>;

    #[inline(always)]
    fn run<I: SimdLevel>(self, isa: I) -> Option<SplitPlane> {
        exact_plane(isa, self.0, self.1, self.2)
    }
}

/// Evaluates every bound of every piece. Counting all pieces for sixteen planes at a time is faster than sorting.
#[inline(always)]
fn exact_plane<I: SimdLevel>(
    isa: I,
    pieces: &[PrimitivePiece],
    cell: &CellBounds,
    spare: usize,
) -> Option<SplitPlane> {
    let count = pieces.len();
    let mut best: Option<SplitPlane> = None;
    for axis in 0..3 {
        let costs = SplitCost::new(cell, axis);
        // Collect the bounds inside the cell as candidates
        let mut candidates = [f32::NAN; 2 * EXACT_COUNT + WIDTH];
        let mut candidate_count = 0;
        for piece in pieces {
            for position in [piece.low[axis], piece.high[axis]] {
                // Write always, and advance only for a candidate inside: no branch to mispredict.
                candidates[candidate_count] = position;
                candidate_count += usize::from(costs.low < position && position < costs.high);
            }
        }
        for chunk in candidates[..candidate_count.next_multiple_of(WIDTH)]
            .as_chunks::<WIDTH>()
            .0
        {
            // Count the pieces on each side of sixteen candidates
            let mut right = [0i32; WIDTH];
            let mut right_only = [0i32; WIDTH];
            for piece in pieces {
                let (low, high) = (piece.low[axis], piece.high[axis]);
                isa.count_below(chunk, low, high, &mut right, &mut right_only);
            }
            // Evaluate the costs and keep the least
            let mut cost = [0.0; WIDTH];
            for i in 0..WIDTH {
                let left = count as i32 - right_only[i];
                cost[i] = costs.cost(chunk[i], left as f32, right[i] as f32);
            }
            for i in 0..WIDTH {
                // Comparisons with NaN, the cost of an unused slot, are false.
                if cost[i] < best.map_or(f32::INFINITY, |b| b.cost) {
                    let left = count - right_only[i] as usize;
                    let right = right[i] as usize;
                    if left < count && right < count && left + right <= count + spare {
                        best = Some(SplitPlane {
                            axis,
                            position: chunk[i],
                            cost: cost[i],
                        });
                    }
                }
            }
        }
    }
    best
}
