//! Min-max macrocells for empty-space skipping, with a distance transform: blocks of 4³ cells and their distance to the
//! nearest non-empty block.
//!
//! A block is empty if the transfer function has neither opacity nor emission over all values between the block's
//! minimum and maximum, widened by the rounding error of the interpolation; single cells of non-empty blocks are
//! classified likewise. Samples in empty cells contribute exactly nothing, so that skipping them changes no bit.
//! Sixteen samples are classified at once. Every empty block stores its distance to the nearest non-empty one, in
//! blocks in the maximum norm (Zuiderveld, Koning & Viergever, "Acceleration of ray-casting using 3-D distance
//! transforms", 1992), so that a ray skips a whole cube of blocks. Distances are stored for each octant of directions,
//! as blocks behind a ray are irrelevant: a ray that has passed the last non-empty block skips to the end of the
//! volume.

use glam::DVec3;

use super::grid::{Grid, LERP_ERROR, clamped, whole};
use super::transfer_function::Transfer;
use crate::numeric::{LANES, Lanes, Lanes3};
use crate::parallel;

/// Cells along a block's side: fewer make shorter skips and take more memory, more leave fewer blocks empty.
const SIDE: usize = 4;

/// Blocks that a thread classifies as one unit of work.
const CHUNK: usize = 1 << 8;

/// Bits of a block's mask, one a cell.
const BITS: f64 = (SIDE * SIDE * SIDE) as f64;

/// Macrocells of one grid under one transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct MacrocellGrid {
    /// Numbers of blocks along x, y, z.
    count: [usize; 3],
    /// Largest cell index along x, y, z.
    last_cell: DVec3,
    /// Masks of the cells of each block that may be non-empty: bit x + 4 y + 16 z; blocks are in order, x fastest.
    occupancy: Vec<u64>,
    /// Distances in blocks to the nearest non-empty one, at most 255; 0 in non-empty blocks; x fastest. One array after
    /// another for rays of each octant: blocks behind the ray do not count.
    distance: Vec<u8>,
    /// Fraction of the blocks that are empty.
    share: f64,
    /// Box in voxel space around all non-empty blocks; it is unbounded where they touch the grid's border, as values
    /// are clamped there.
    occupied_bounds: [DVec3; 2],
}

/// Number of octants of directions: bit `axis` of an octant is set if rays have a negative component along that axis.
const OCTANTS: usize = 8;

/// Ray in voxel space, with its reciprocal direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct VoxelRay {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    /// Componentwise reciprocal of the direction.
    pub(super) inverse: DVec3,
    /// Octant of the direction, 0 to 7.
    octant: usize,
}

impl VoxelRay {
    /// Creates the ray from `origin` in `direction`.
    #[inline(always)]
    pub(super) fn new(origin: DVec3, direction: DVec3) -> VoxelRay {
        VoxelRay::with_inverse(origin, direction, direction.recip())
    }

    /// Creates the ray with a precomputed reciprocal of the direction.
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
    /// Classifies the blocks of `grid` under the transfer function `transfer`.
    pub fn new(grid: &Grid, transfer: &Transfer) -> MacrocellGrid {
        // Classify blocks and cells
        let cells = grid.cells();
        let count = cells.map(|cells| cells.div_ceil(SIDE));
        let occupancy = occupancy_masks(grid, transfer, count);
        // Start distances with 0 in non-empty blocks
        let nearest: Vec<u8> = occupancy
            .iter()
            .map(|&occupancy| if occupancy == 0 { u8::MAX } else { 0 })
            .collect();
        let empty_count = nearest.iter().filter(|&&distance| distance > 0).count();
        // Propagate distances for each octant of directions
        let mut distance = nearest.repeat(OCTANTS);
        parallel::for_each_chunk_mut(&mut distance, nearest.len(), &|octant, distance| {
            propagate_distances(distance, count, octant);
        });
        MacrocellGrid {
            count,
            last_cell: DVec3::from_array(cells.map(|cells| (cells - 1) as f64)),
            occupancy,
            share: empty_count as f64 / nearest.len() as f64,
            distance,
            occupied_bounds: occupied_bounds(&nearest, count),
        }
    }

    /// Returns the parameters between which the ray may be in non-empty space; the end lies before the start if there
    /// is none.
    #[inline(always)]
    pub(super) fn span(&self, ray: &VoxelRay) -> [f64; 2] {
        let mut span = [f64::NEG_INFINITY, f64::INFINITY];
        for axis in 0..3 {
            let line = [ray.origin[axis], ray.direction[axis], ray.inverse[axis]];
            span = clipped(span, line, self.occupied_bounds.map(|corner| corner[axis]));
        }
        span
    }

    /// Returns the minimum and maximum corner of a box in voxel space outside which all is empty.
    #[inline(always)]
    pub(super) fn occupied_bounds(&self) -> [DVec3; 2] {
        self.occupied_bounds
    }

    /// Returns the fraction of the blocks that are empty.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Returns the bytes of memory that the masks and distances take.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.occupancy[..]) + size_of_val(&self.distance[..])
    }

    /// Returns a mask of sixteen points in voxel space: bit `l` is set if point `l` lies in a cell that may be
    /// non-empty.
    #[inline(always)]
    pub(super) fn occupancy(&self, points: &Lanes3<f64>) -> u16 {
        // Compute the bit index of each point's cell
        let [nx, ny, _] = self.count.map(|count| count as f64);
        let mut index = [0.0; LANES];
        let side = SIDE as f64;
        self.bit_lanes(&points[0], self.last_cell.x, [BITS, 1.0], &mut index);
        self.bit_lanes(&points[1], self.last_cell.y, [BITS * nx, side], &mut index);
        self.bit_lanes(
            &points[2],
            self.last_cell.z,
            [BITS * nx * ny, side * side],
            &mut index,
        );
        let mut bit = [0; LANES];
        for l in 0..LANES {
            bit[l] = whole(index[l]);
        }
        // Pass through memory, here and below: a compiler that extracts the sixteen lanes here propagates that to all
        // callers, and one that joins them again uses a gather, which is slower than sixteen loads.
        std::hint::black_box(&mut bit);
        // Load the mask of each point's block
        let mut bits = [0; LANES];
        for l in 0..LANES {
            bits[l] = self.occupancy[(bit[l] / u64::from(u64::BITS)) as usize];
        }
        std::hint::black_box(&mut bits);
        // Extract the bit of each point's cell
        let mut mask = 0;
        for l in 0..LANES {
            mask |= (bits[l] >> (bit[l] % u64::from(u64::BITS)) & 1) << l;
        }
        mask as u16
    }

    /// Adds one axis's contribution to the bit indices of the cells of sixteen points: the strides are those between
    /// blocks and between cells of a block.
    #[inline(always)]
    fn bit_lanes(
        &self,
        points: &Lanes<f64>,
        last: f64,
        [block_stride, stride]: [f64; 2],
        index: &mut Lanes<f64>,
    ) {
        const SIZE: f64 = SIDE as f64;
        for l in 0..LANES {
            let cell = clamped(points[l], last).floor();
            let block = (cell * (1.0 / SIZE)).floor();
            index[l] += block * block_stride + (cell - block * SIZE) * stride;
        }
    }

    /// Returns the parameter up to which the ray is in empty space, from its empty block at `t` on, computed with
    /// rounding.
    #[inline(always)]
    pub(super) fn skip_ahead(&self, ray: &VoxelRay, t: f64) -> f64 {
        const SIZE: f64 = SIDE as f64;
        // Find the block of the point at `t`
        let p = ray.origin + t * ray.direction;
        let cell = p.max(DVec3::ZERO).min(self.last_cell);
        let block = (cell * (1.0 / SIZE)).floor();
        let [x, y, z] = [block.x as usize, block.y as usize, block.z as usize];
        let [nx, ny, nz] = self.count;
        let distance = self.distance[((ray.octant * nz + z) * ny + y) * nx + x];
        // The cube of this many more blocks ahead is empty.
        let reach = f64::from(distance) - 1.0;
        // Intersect the ray with the faces ahead of the cube
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

/// Clips an interval of t to a slab between two `sides` along one axis; the line is given as origin, direction and
/// reciprocal direction. The result is empty, with its end before its start, if they do not intersect.
#[inline(always)]
pub(super) fn clipped(
    [start, end]: [f64; 2],
    [origin, direction, inverse]: [f64; 3],
    [low, high]: [f64; 2],
) -> [f64; 2] {
    let a = (low - origin) * inverse;
    let b = (high - origin) * inverse;
    // Order by the direction, not by the values: the sides of an empty box are reversed.
    let (near, far) = if direction > 0.0 { (a, b) } else { (b, a) };
    // A ray parallel to the slab lies inside or outside as a whole
    let crosses = direction != 0.0;
    let is_outside = !crosses & !((origin >= low) & (origin <= high));
    let start = if crosses & (near > start) { near } else { start };
    let end = if crosses & (far < end) { far } else { end };
    [start, if is_outside { f64::NEG_INFINITY } else { end }]
}

/// Returns the cell masks of all `[nx, ny, nz]` blocks, as in [`MacrocellGrid::occupancy`].
fn occupancy_masks(grid: &Grid, transfer: &Transfer, [nx, ny, nz]: [usize; 3]) -> Vec<u64> {
    let (cells, count) = (grid.cells(), nx * ny * nz);
    // Test a range of cells with its min and max, widened by the interpolation error
    let is_empty = |from: [usize; 3], to: [usize; 3]| {
        let [low, high] = grid.range(from, to).map(f64::from);
        let slack = LERP_ERROR * low.abs().max(high.abs());
        transfer.maximum(low - slack, high + slack) == (0.0, false)
    };
    let box_of = |i: usize| {
        let from = [i % nx, i / nx % ny, i / nx / ny].map(|b| b * SIDE);
        [from, [0, 1, 2].map(|axis| (from[axis] + SIDE).min(cells[axis]))]
    };
    let full_block = |i: usize| {
        let [from, to] = box_of(i);
        !is_empty(from, to)
    };
    // Skip the cell masks if no block is empty: marches then never query them.
    let mut occupancy = vec![u64::MAX; count];
    let are_full = |chunk: usize| {
        let first = chunk * CHUNK;
        (first..count.min(first + CHUNK)).all(full_block)
    };
    // Classify the single cells of non-empty blocks
    if !parallel::all(count.div_ceil(CHUNK), &are_full) {
        parallel::for_each_chunk_mut(&mut occupancy, CHUNK, &|chunk, occupancy| {
            for (i, occupancy) in (chunk * CHUNK..).zip(occupancy) {
                let [from, to] = box_of(i);
                *occupancy = if is_empty(from, to) {
                    0
                } else {
                    occupied_cells(from, to, is_empty)
                };
            }
        });
    }
    occupancy
}

/// Returns the mask of the non-empty cells from `from` to `to` of a block, the latter excluded.
fn occupied_cells(
    from: [usize; 3],
    to: [usize; 3],
    is_empty: impl Fn([usize; 3], [usize; 3]) -> bool,
) -> u64 {
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

/// Returns the box around the blocks whose distance is 0, extended by a voxel, a margin larger than any rounding error
/// of a position.
fn occupied_bounds(distance: &[u8], [nx, ny, nz]: [usize; 3]) -> [DVec3; 2] {
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for (i, _) in distance
        .iter()
        .enumerate()
        .filter(|(_, distance)| **distance == 0)
    {
        let block = [i % nx, i / nx % ny, i / nx / ny];
        // Extend to infinity at the grid's border
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

/// Propagates distances in one sweep: each becomes at most one more than the minimum among the seven neighbours ahead
/// of a ray of the octant. This is exact for the maximum norm, as a shortest path takes its diagonal steps first.
fn propagate_distances(distance: &mut [u8], [nx, ny, nz]: [usize; 3], octant: usize) {
    // Sweep from the last block that a ray visits back to the first.
    let order = |axis: usize, count: usize| {
        let is_down = octant >> axis & 1 == 1;
        (0..count).map(move |i| if is_down { i } else { count - 1 - i })
    };
    let ahead = |axis: usize, i: usize, count: usize| match octant >> axis & 1 {
        0 => (i + 1).min(count - 1),
        _ => i.saturating_sub(1),
    };
    // Visit blocks in an order in which all neighbours ahead are final
    for z in order(2, nz) {
        for y in order(1, ny) {
            let rows = [y, ahead(1, y, ny)].map(|y| [z, ahead(2, z, nz)].map(|z| (z * ny + y) * nx));
            for x in order(0, nx) {
                let i = rows[0][0] + x;
                // At the border a missing neighbour is replaced by the block itself or by another of the seven.
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
    use crate::volume::GridSamples;
    use crate::volume::transfer_function::{Thickness, TransferNode};

    /// Returns a transfer function that is clear up to `clear_to` and has extinction 1 from 2 on.
    fn transfer(clear_to: f64) -> Transfer {
        let node = |value, thickness| TransferNode {
            value,
            thickness,
            color: [1.0; 3],
            emission: [0.0; 3],
        };
        Transfer::new(&[node(clear_to, 0.0), node(2.0, 1.0)], Thickness::Extinction).unwrap()
    }

    /// Number of blocks of a grid of 50³ samples, 49³ cells.
    const BLOCKS: usize = 13 * 13 * 13;

    /// Returns a grid of 50³ that is `inside` at the samples `occupancy` and 0 elsewhere.
    fn grid(occupancy: &[[usize; 3]], inside: f32) -> Grid {
        let mut values = vec![0.0; 50 * 50 * 50];
        for [x, y, z] in occupancy {
            values[(z * 50 + y) * 50 + x] = inside;
        }
        Grid::new([50; 3], GridSamples::Floats(values)).unwrap()
    }

    #[test]
    fn distances_match_an_exhaustive_search() {
        let occupancy = [[3, 5, 6], [41, 5, 45], [17, 30, 21]];
        let space = MacrocellGrid::new(&grid(&occupancy, 1.0), &transfer(0.0));
        assert_eq!(space.count, [13; 3]);
        // No sample lies on a border of blocks, so each is in one.
        for (i, &distance) in space.distance.iter().enumerate() {
            let (octant, block) = (i / BLOCKS, [i % 13, i / 13 % 13, i % BLOCKS / 169]);
            let away = |axis: usize, sample: &[usize; 3]| match octant >> axis & 1 {
                0 => (sample[axis] / 4).checked_sub(block[axis]),
                _ => block[axis].checked_sub(sample[axis] / 4),
            };
            // Skip samples that lie behind along any axis.
            let ways = occupancy.iter().filter_map(|sample| {
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
    fn border_sample_belongs_to_both_adjacent_cells() {
        let space = MacrocellGrid::new(&grid(&[[8, 8, 8]], 1.0), &transfer(0.0));
        let full = space.distance[..BLOCKS]
            .iter()
            .filter(|&&distance| distance == 0)
            .count();
        assert_eq!(full, 8);
    }

    #[test]
    fn values_invisible_to_the_transfer_function_are_empty() {
        let occupancy = grid(&[[3, 3, 3]], 1.0);
        assert_eq!(MacrocellGrid::new(&occupancy, &transfer(1.5)).share(), 1.0);
        let all_but_one = (BLOCKS - 1) as f64 / BLOCKS as f64;
        assert_eq!(
            MacrocellGrid::new(&occupancy, &transfer(0.5)).share(),
            all_but_one
        );
        // At the threshold itself, the rounding margin makes the block non-empty.
        assert_eq!(
            MacrocellGrid::new(&occupancy, &transfer(1.0)).share(),
            all_but_one
        );
    }

    #[test]
    fn skip_ends_before_the_first_occupied_block() {
        let space = MacrocellGrid::new(&grid(&[[42, 5, 5]], 1.0), &transfer(0.0));
        let along_x =
            |x: f64, speed: f64| VoxelRay::new(DVec3::new(x, 5.0, 5.0), DVec3::new(speed, 0.0, 0.0));
        // The sample is in block 10, cells 40 to 43; block 0 has a distance of 10: the skip ends at block 9's far side,
        // x = 40.
        assert_eq!(space.skip_ahead(&along_x(-1.0, 2.0), 0.5), 20.5);
        // From block 11 on there is none: to the end of 255 blocks, x = 44 + 1020.
        assert_eq!(space.skip_ahead(&along_x(-1.0, 2.0), 23.0), 532.5);
        // In the opposite direction the skip ends at block 11's near side, x = 44.
        assert_eq!(space.skip_ahead(&along_x(49.0, -2.0), 0.5), 2.5);
    }

    #[test]
    fn occupied_span_extends_only_beyond_the_border() {
        let space = MacrocellGrid::new(&grid(&[[1, 21, 46], [5, 26, 49]], 1.0), &transfer(0.0));
        // Blocks 0 to 1, 5 to 6 and 11 to 12 of 0 to 12, and a voxel on either side.
        let [low, high] = [
            DVec3::new(-f64::INFINITY, 19.0, 43.0),
            DVec3::new(9.0, 29.0, f64::INFINITY),
        ];
        assert_eq!(space.occupied_bounds, [low, high]);
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
    fn occupancy_is_correct_inside_and_beyond_the_border() {
        let space = MacrocellGrid::new(&grid(&[[1, 1, 1], [49, 49, 49]], 1.0), &transfer(0.0));
        let mut points = [[20.0; LANES]; 3];
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
                points[axis][l] = place[axis];
            }
        }
        assert_eq!(space.occupancy(&points), 1 | 1 << 2 | 1 << 9 | 1 << 15);
    }
}
