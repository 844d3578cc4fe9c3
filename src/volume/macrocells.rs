//! Where a volume is empty: lowest and highest values of blocks of cells, and how far the nearest matter is.
//!
//! A block is empty if the transfer function has neither opacity nor emission over all values between its lowest and its
//! highest, widened by what the interpolation can round; so is a single cell of a block that is not. Samples there add
//! exactly nothing, so that leaving them out changes no bit. Sixteen samples are asked about at once. Every empty block
//! knows how far the nearest matter is, in blocks in the maximum norm (Zuiderveld, Koning & Viergever, "Acceleration of
//! ray-casting using 3-D distance transforms", 1992), so that a ray leaps through a whole cube of them. It knows that for
//! each octant of directions, as what lies behind a ray is no matter of it: a ray that has left the last matter before it
//! leaps out of the volume.

use glam::DVec3;

use super::grid::{Grid, LERP_ERROR, clamped, whole};
use super::transfer_function::Transfer;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::parallel;

/// Cells along a block's side: fewer make shorter leaps and take more memory, more leave less empty.
const SIDE: usize = 4;

/// Blocks that a thread looks into at once.
const CHUNK: usize = 1 << 8;

/// Bits of a block, one a cell.
const BITS: f64 = (SIDE * SIDE * SIDE) as f64;

/// The empty space of one grid under one transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct MacrocellGrid {
    /// Blocks along x, y, z.
    count: [usize; 3],
    /// Highest cell along x, y, z.
    last_cell: DVec3,
    /// Bits of each block say which of its cells may have matter: x + 4 y + 16 z; blocks are in order, x fastest.
    matter: Vec<u64>,
    /// Blocks to the nearest with matter, at most 255; 0 in those that have it; x fastest. One after the other for rays
    /// of each octant: what they leave behind does not count.
    distance: Vec<u8>,
    /// Share of the blocks that are empty.
    share: f64,
    /// A box in voxel space around all matter; it has no end where matter lies at the grid's border, as it goes on there.
    around_matter: [DVec3; 2],
}

/// Octants of directions: bit `axis` says that rays go down along that axis.
const OCTANTS: usize = 8;

/// A ray in voxel space.
#[derive(Clone, Copy, Debug)]
pub(super) struct VoxelRay {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    /// 1 / direction.
    pub(super) inverse: DVec3,
    /// Of the direction.
    octant: usize,
}

impl VoxelRay {
    /// The ray from `origin` in `direction`.
    #[inline(always)]
    pub(super) fn new(origin: DVec3, direction: DVec3) -> VoxelRay {
        VoxelRay::with_inverse(origin, direction, direction.recip())
    }

    /// The same where the `inverse` of the direction is known.
    #[inline(always)]
    pub(super) fn with_inverse(origin: DVec3, direction: DVec3, inverse: DVec3) -> VoxelRay {
        let down = |axis: usize| usize::from(direction[axis] < 0.0) << axis;
        VoxelRay {
            origin,
            direction,
            inverse,
            octant: down(0) | down(1) | down(2),
        }
    }
}

impl MacrocellGrid {
    /// Finds the empty space of `grid` as `transfer_function` shows it.
    pub fn new(grid: &Grid, transfer: &Transfer) -> MacrocellGrid {
        let cells = grid.cells();
        let count = cells.map(|cells| cells.div_ceil(SIDE));
        let matter = full_bits(grid, transfer, count);
        let nearest: Vec<u8> = matter
            .iter()
            .map(|&matter| if matter == 0 { u8::MAX } else { 0 })
            .collect();
        let empty_count = nearest.iter().filter(|&&distance| distance > 0).count();
        let mut distance = nearest.repeat(OCTANTS);
        parallel::for_each_chunk_mut(&mut distance, nearest.len(), &|octant, distance| {
            spread(distance, count, octant);
        });
        MacrocellGrid {
            count,
            last_cell: DVec3::from_array(cells.map(|cells| (cells - 1) as f64)),
            matter,
            share: empty_count as f64 / nearest.len() as f64,
            distance,
            around_matter: around_matter(&nearest, count),
        }
    }

    /// From where to where along the ray there may be matter; the end lies before the start if there is none.
    #[inline(always)]
    pub(super) fn span(&self, ray: &VoxelRay) -> [f64; 2] {
        let mut span = [f64::NEG_INFINITY, f64::INFINITY];
        for axis in 0..3 {
            let line = [ray.origin[axis], ray.direction[axis], ray.inverse[axis]];
            span = clipped(span, line, self.around_matter.map(|corner| corner[axis]));
        }
        span
    }

    /// The lowest and the highest corner of a box in voxel space outside which there is no matter.
    #[inline(always)]
    pub(super) fn around_matter(&self) -> [DVec3; 2] {
        self.around_matter
    }

    /// Share of the blocks that are empty.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Bytes of memory that the blocks take.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.matter[..]) + size_of_val(&self.distance[..])
    }

    /// Which of sixteen points of voxel space may have matter: bit `l` says so of point `l`.
    #[inline(always)]
    pub(super) fn matter(&self, places: &Lanes3<f64>) -> u16 {
        let [nx, ny, _] = self.count.map(|count| count as f64);
        let mut index = [0.0; LANES];
        let side = SIDE as f64;
        self.bit_lanes(&places[0], self.last_cell.x, [BITS, 1.0], &mut index);
        self.bit_lanes(&places[1], self.last_cell.y, [BITS * nx, side], &mut index);
        self.bit_lanes(
            &places[2],
            self.last_cell.z,
            [BITS * nx * ny, side * side],
            &mut index,
        );
        let mut bit = [0; LANES];
        for l in 0..LANES {
            bit[l] = whole(index[l]);
        }
        // Through memory, here and below: a compiler that takes the sixteen apart here does so all the way up, and one
        // that puts them together again gathers, which is slower than sixteen loads.
        std::hint::black_box(&mut bit);
        let mut bits = [0; LANES];
        for l in 0..LANES {
            bits[l] = self.matter[(bit[l] / u64::from(u64::BITS)) as usize];
        }
        std::hint::black_box(&mut bits);
        let mut mask = 0;
        for l in 0..LANES {
            mask |= (bits[l] >> (bit[l] % u64::from(u64::BITS)) & 1) << l;
        }
        mask as u16
    }

    /// Adds what an axis has to do with the numbers of the bits of the cells that sixteen points are in: from block to
    /// block and from cell to cell they go on by the two strides.
    #[inline(always)]
    fn bit_lanes(
        &self,
        places: &Lanes<f64>,
        last: f64,
        [block_stride, stride]: [f64; 2],
        index: &mut Lanes<f64>,
    ) {
        const SIZE: f64 = SIDE as f64;
        for l in 0..LANES {
            let cell = clamped(places[l], last).floor();
            let block = (cell * (1.0 / SIZE)).floor();
            index[l] += block * block_stride + (cell - block * SIZE) * stride;
        }
    }

    /// Up to where along the ray there is nothing, from the empty block on that it is in at `t`: a parameter, computed
    /// with rounding.
    #[inline(always)]
    pub(super) fn leap(&self, ray: &VoxelRay, t: f64) -> f64 {
        const SIZE: f64 = SIDE as f64;
        let p = ray.origin + t * ray.direction;
        let cell = p.max(DVec3::ZERO).min(self.last_cell);
        let block = (cell * (1.0 / SIZE)).floor();
        let [x, y, z] = [block.x as usize, block.y as usize, block.z as usize];
        let [nx, ny, nz] = self.count;
        let distance = self.distance[((ray.octant * nz + z) * ny + y) * nx + x];
        // A cube of blocks from this one on that is all empty.
        let reach = f64::from(distance) - 1.0;
        let mut until = f64::INFINITY;
        for axis in 0..3 {
            let direction = ray.direction[axis];
            let ahead = if direction > 0.0 { 1.0 + reach } else { -reach };
            let border = (block[axis] + ahead) * SIZE;
            let leave = (border - ray.origin[axis]) * ray.inverse[axis];
            if direction != 0.0 && leave < until {
                until = leave;
            }
        }
        until
    }
}

/// The part of the span of t in which a coordinate lies between two `sides`, whose `line` has this origin, direction and
/// inverse of the latter. There is none if the end lies before the start.
#[inline(always)]
pub(super) fn clipped(
    [start, end]: [f64; 2],
    [origin, direction, inverse]: [f64; 3],
    [low, high]: [f64; 2],
) -> [f64; 2] {
    let a = (low - origin) * inverse;
    let b = (high - origin) * inverse;
    // By the direction, as a box of nothing is inside out.
    let (near, far) = if direction > 0.0 { (a, b) } else { (b, a) };
    let crosses = direction != 0.0;
    let is_outside = !crosses & !((origin >= low) & (origin <= high));
    let start = if crosses & (near > start) { near } else { start };
    let end = if crosses & (far < end) { far } else { end };
    [start, if is_outside { f64::NEG_INFINITY } else { end }]
}

/// The bits of all blocks, `[nx, ny, nz]` of them: [`MacrocellGrid::matter`].
fn full_bits(grid: &Grid, transfer: &Transfer, [nx, ny, nz]: [usize; 3]) -> Vec<u64> {
    let (cells, count) = (grid.cells(), nx * ny * nz);
    let is_empty = |from: [usize; 3], to: [usize; 3]| {
        let [low, high] = grid.range(from, to).map(f64::from);
        let slack = LERP_ERROR * low.abs().max(high.abs());
        transfer.most(low - slack, high + slack) == (0.0, false)
    };
    let box_of = |i: usize| {
        let from = [i % nx, i / nx % ny, i / nx / ny].map(|b| b * SIDE);
        [from, [0, 1, 2].map(|axis| (from[axis] + SIDE).min(cells[axis]))]
    };
    let full_block = |i: usize| {
        let [from, to] = box_of(i);
        !is_empty(from, to)
    };
    // Where no block is empty nothing is leapt over: nobody asks about cells.
    let mut matter = vec![u64::MAX; count];
    let are_full = |chunk: usize| {
        let first = chunk * CHUNK;
        (first..count.min(first + CHUNK)).all(full_block)
    };
    if !parallel::all(count.div_ceil(CHUNK), &are_full) {
        parallel::for_each_chunk_mut(&mut matter, CHUNK, &|chunk, matter| {
            for (i, matter) in (chunk * CHUNK..).zip(matter) {
                let [from, to] = box_of(i);
                *matter = if is_empty(from, to) {
                    0
                } else {
                    full_cells(from, to, is_empty)
                };
            }
        });
    }
    matter
}

/// The bits of the cells `from` to `to` of a block, the latter excluded, that are not empty.
fn full_cells(from: [usize; 3], to: [usize; 3], is_empty: impl Fn([usize; 3], [usize; 3]) -> bool) -> u64 {
    let mut full = 0;
    for z in from[2]..to[2] {
        for y in from[1]..to[1] {
            for x in from[0]..to[0] {
                let bit = ((z % SIDE) * SIDE + y % SIDE) * SIDE + x % SIDE;
                full |= u64::from(!is_empty([x, y, z], [x + 1, y + 1, z + 1])) << bit;
            }
        }
    }
    full
}

/// The box around the blocks whose distance is 0, a voxel wider than they are, which is more than any rounding of a
/// place.
fn around_matter(distance: &[u8], [nx, ny, nz]: [usize; 3]) -> [DVec3; 2] {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for (i, _) in distance
        .iter()
        .enumerate()
        .filter(|(_, distance)| **distance == 0)
    {
        let block = [i % nx, i / nx % ny, i / nx / ny];
        for (axis, last) in [nx - 1, ny - 1, nz - 1].into_iter().enumerate() {
            let [from, to] = [block[axis], block[axis] + 1].map(|border| (border * SIDE) as f64);
            let is_first = block[axis] == 0;
            low[axis] = low[axis].min(if is_first { f64::NEG_INFINITY } else { from - 1.0 });
            high[axis] = high[axis].max(if block[axis] == last {
                f64::INFINITY
            } else {
                to + 1.0
            });
        }
    }
    [low, high]
}

/// Brings every distance down to one more than the lowest among the seven neighbours that a ray of the octant may go to:
/// exact for the maximum norm, as a way to a block goes diagonally first.
fn spread(distance: &mut [u8], [nx, ny, nz]: [usize; 3], octant: usize) {
    // From the last block that a ray comes to on, back to the first.
    let order = |axis: usize, count: usize| {
        let is_down = octant >> axis & 1 == 1;
        (0..count).map(move |i| if is_down { i } else { count - 1 - i })
    };
    let ahead = |axis: usize, i: usize, count: usize| match octant >> axis & 1 {
        0 => (i + 1).min(count - 1),
        _ => i.saturating_sub(1),
    };
    for z in order(2, nz) {
        for y in order(1, ny) {
            let rows = [y, ahead(1, y, ny)].map(|y| [z, ahead(2, z, nz)].map(|z| (z * ny + y) * nx));
            for x in order(0, nx) {
                let i = rows[0][0] + x;
                // At the border a neighbour is the block itself, or another one of them.
                let lowest = |x: usize| rows.as_flattened().iter().map(|row| distance[row + x]).min();
                let others = lowest(x).min(lowest(ahead(0, x, nx))).unwrap_or(0);
                distance[i] = distance[i].min(others.saturating_add(1));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Samples;
    use crate::volume::transfer_function::{Thickness, TransferNode};

    fn transfer(clear_to: f64) -> Transfer {
        let node = |value, thickness| TransferNode {
            value,
            thickness,
            color: [1.0; 3],
            emission: [0.0; 3],
        };
        Transfer::new(&[node(clear_to, 0.0), node(2.0, 1.0)], Thickness::Extinction).unwrap()
    }

    /// Blocks of a grid of 50³ samples, 49³ cells.
    const BLOCKS: usize = 13 * 13 * 13;

    /// A grid of 50³ that is `inside` at the samples `matter` and 0 elsewhere.
    fn grid(matter: &[[usize; 3]], inside: f32) -> Grid {
        let mut values = vec![0.0; 50 * 50 * 50];
        for [x, y, z] in matter {
            values[(z * 50 + y) * 50 + x] = inside;
        }
        Grid::new([50; 3], Samples::Floats(values)).unwrap()
    }

    #[test]
    fn distances_are_those_of_a_search_through_all_blocks() {
        let matter = [[3, 5, 6], [41, 5, 45], [17, 30, 21]];
        let space = MacrocellGrid::new(&grid(&matter, 1.0), &transfer(0.0));
        assert_eq!(space.count, [13; 3]);
        // No sample lies on a border of blocks, so each is in one.
        for (i, &distance) in space.distance.iter().enumerate() {
            let (octant, block) = (i / BLOCKS, [i % 13, i / 13 % 13, i % BLOCKS / 169]);
            let away = |axis: usize, sample: &[usize; 3]| match octant >> axis & 1 {
                0 => (sample[axis] / 4).checked_sub(block[axis]),
                _ => block[axis].checked_sub(sample[axis] / 4),
            };
            // None of what is behind along any axis.
            let ways = matter.iter().filter_map(|sample| {
                let [x, y, z] = [0, 1, 2].map(|axis| away(axis, sample));
                Some(x?.max(y?).max(z?))
            });
            assert_eq!(
                usize::from(distance),
                ways.min().unwrap_or(255),
                "{octant} {block:?}"
            );
        }
    }

    #[test]
    fn a_sample_on_a_border_belongs_to_the_cells_on_both_sides() {
        let space = MacrocellGrid::new(&grid(&[[8, 8, 8]], 1.0), &transfer(0.0));
        let full = space.distance[..BLOCKS]
            .iter()
            .filter(|&&distance| distance == 0)
            .count();
        assert_eq!(full, 8);
    }

    #[test]
    fn values_that_the_transfer_function_does_not_show_are_empty() {
        let matter = grid(&[[3, 3, 3]], 1.0);
        assert_eq!(MacrocellGrid::new(&matter, &transfer(1.5)).share(), 1.0);
        let all_but_one = (BLOCKS - 1) as f64 / BLOCKS as f64;
        assert_eq!(MacrocellGrid::new(&matter, &transfer(0.5)).share(), all_but_one);
        // At the very edge what rounding may add is not empty.
        assert_eq!(MacrocellGrid::new(&matter, &transfer(1.0)).share(), all_but_one);
    }

    #[test]
    fn a_leap_ends_before_the_first_block_with_matter() {
        let space = MacrocellGrid::new(&grid(&[[42, 5, 5]], 1.0), &transfer(0.0));
        let along_x =
            |x: f64, speed: f64| VoxelRay::new(DVec3::new(x, 5.0, 5.0), DVec3::new(speed, 0.0, 0.0));
        // Matter is in block 10, cells 40 to 43; block 0 has a distance of 10: it sees to the end of block 9, x = 40.
        assert_eq!(space.leap(&along_x(-1.0, 2.0), 0.5), 20.5);
        // From block 11 on there is none: to the end of 255 blocks, x = 44 + 1020.
        assert_eq!(space.leap(&along_x(-1.0, 2.0), 23.0), 532.5);
        // The other way there is: to the end of block 11, x = 44.
        assert_eq!(space.leap(&along_x(49.0, -2.0), 0.5), 2.5);
    }

    #[test]
    fn the_span_of_matter_goes_on_beyond_the_border_only() {
        let space = MacrocellGrid::new(&grid(&[[1, 21, 46], [5, 26, 49]], 1.0), &transfer(0.0));
        // Blocks 0 to 1, 5 to 6 and 11 to 12 of 0 to 12, and a voxel on either side.
        let [low, high] = [
            DVec3::new(-f64::INFINITY, 19.0, 43.0),
            DVec3::new(9.0, 29.0, f64::INFINITY),
        ];
        assert_eq!(space.around_matter, [low, high]);
        let span = |origin: [f64; 3], direction: [f64; 3]| {
            space.span(&VoxelRay::new(origin.into(), direction.into()))
        };
        assert_eq!(span([4.0, -1.0, 44.0], [0.0, 2.0, 0.0]), [10.0, 15.0]);
        assert_eq!(span([9.0, 29.0, 44.0], [0.0, -2.0, 0.0]), [0.0, 5.0]);
        assert_eq!(span([3.0, 20.0, 44.0], [2.0, 0.0, 0.0]), [f64::NEG_INFINITY, 3.0]);
        for (origin, direction) in [
            ([9.5, 20.0, 44.0], [0.0, 1.0, 0.0]),
            ([0.0, 0.0, 90.0], [1.0, 1.0, 0.0]),
        ] {
            let [start, end] = span(origin, direction);
            assert!(end < start, "{start} {end}");
        }
        let clear = MacrocellGrid::new(&grid(&[], 1.0), &transfer(0.0));
        let [start, end] = clear.span(&VoxelRay::new(DVec3::ZERO, DVec3::ONE));
        assert!(end < start);
    }

    #[test]
    fn points_are_asked_about_where_they_are_and_beyond_the_border() {
        let space = MacrocellGrid::new(&grid(&[[1, 1, 1], [49, 49, 49]], 1.0), &transfer(0.0));
        let mut places = [[20.0; LANES]; 3];
        let all = |x: f64| [x; 3];
        for (l, place) in [
            (0, all(1.9)),
            (1, all(2.1)),
            (2, [-1e9, 0.0, -0.0]),
            (5, [1.0, 1.0, 2.0]),
            (9, all(48.5)),
            (15, [49.5, 1e300, 60.0]),
        ] {
            for axis in 0..3 {
                places[axis][l] = place[axis];
            }
        }
        assert_eq!(space.matter(&places), 1 | 1 << 2 | 1 << 9 | 1 << 15);
    }
}
