//! Where a volume is empty: lowest and highest values of blocks of cells, and how far the nearest matter is.
//!
//! A block is empty if the transfer function has neither opacity nor emission over all values between its lowest and its
//! highest, widened by what the interpolation can round. Samples there add exactly nothing, so that leaving them out
//! changes no bit. Sixteen samples are asked about at once. Every empty block knows how far the nearest matter is, in
//! blocks in the maximum norm (Zuiderveld, Koning & Viergever, "Acceleration of ray-casting using 3-D distance
//! transforms", 1992), so that a ray leaps through a whole cube of them.

use glam::DVec3;
use rayon::prelude::*;

use super::grid::{Grid, LERP_ERROR, clamped, whole};
use super::transfer::Transfer;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Cells along a block's side: fewer make shorter leaps and take more memory, more leave less empty.
const SIDE: usize = 4;

/// The empty space of one grid under one transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct EmptySpace {
    /// Blocks along x, y, z.
    count: [usize; 3],
    /// Highest cell along x, y, z.
    last_cell: DVec3,
    /// Blocks to the nearest with matter, at most 255; 0 in those that have it; x fastest.
    distance: Vec<u8>,
    /// Share of the blocks that are empty.
    share: f64,
    /// A box in voxel space around all matter; it has no end where matter lies at the grid's border, as it goes on there.
    around_matter: [DVec3; 2],
}

/// A ray in voxel space.
#[derive(Clone, Copy, Debug)]
pub(super) struct VoxelRay {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    /// 1 / direction.
    pub(super) inverse: DVec3,
}

impl EmptySpace {
    /// Finds the empty space of `grid` as `transfer` shows it.
    pub fn new(grid: &Grid, transfer: &Transfer) -> EmptySpace {
        let cells = grid.cells();
        let count = cells.map(|cells| cells.div_ceil(SIDE));
        let [nx, ny, nz] = count;
        let mut distance: Vec<u8> = (0..nx * ny * nz)
            .into_par_iter()
            .map(|i| {
                let block = [i % nx, i / nx % ny, i / nx / ny];
                let from = block.map(|b| b * SIDE);
                let to = [0, 1, 2].map(|axis| (from[axis] + SIDE).min(cells[axis]));
                let [low, high] = grid.range(from, to).map(f64::from);
                let slack = LERP_ERROR * low.abs().max(high.abs());
                let is_empty = transfer.most(low - slack, high + slack) == (0.0, false);
                if is_empty { u8::MAX } else { 0 }
            })
            .collect();
        let around_matter = around_matter(&distance, count);
        let empty_count = distance.iter().filter(|&&distance| distance > 0).count();
        spread(&mut distance, count);
        EmptySpace {
            count,
            last_cell: DVec3::from_array(cells.map(|cells| (cells - 1) as f64)),
            share: empty_count as f64 / distance.len() as f64,
            distance,
            around_matter,
        }
    }

    /// From where to where along the ray there may be matter; the end lies before the start if there is none.
    #[inline(always)]
    pub(super) fn span(&self, ray: &VoxelRay) -> [f64; 2] {
        let [low, high] = &self.around_matter;
        let [mut start, mut end] = [f64::NEG_INFINITY, f64::INFINITY];
        for axis in 0..3 {
            if ray.direction[axis] == 0.0 {
                if ray.origin[axis] < low[axis] || ray.origin[axis] > high[axis] {
                    end = f64::NEG_INFINITY;
                }
                continue;
            }
            let a = (low[axis] - ray.origin[axis]) * ray.inverse[axis];
            let b = (high[axis] - ray.origin[axis]) * ray.inverse[axis];
            // By the direction, as the box of no matter is inside out.
            let (near, far) = if ray.direction[axis] > 0.0 { (a, b) } else { (b, a) };
            start = if near > start { near } else { start };
            end = if far < end { far } else { end };
        }
        [start, end]
    }

    /// Share of the blocks that are empty.
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Bytes of memory that the blocks take.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.distance[..])
    }

    /// Which of sixteen points of voxel space may have matter: bit `l` says so of point `l`.
    #[inline(always)]
    pub(super) fn matter(&self, places: &Lanes3<f64>) -> u16 {
        let mut index = [0.0; LANES];
        let row = self.count[0] as f64;
        self.block_lanes(&places[0], self.last_cell.x, 1.0, &mut index);
        self.block_lanes(&places[1], self.last_cell.y, row, &mut index);
        self.block_lanes(
            &places[2],
            self.last_cell.z,
            row * self.count[1] as f64,
            &mut index,
        );
        // Through memory: a compiler that takes the sixteen apart here does so all the way up.
        std::hint::black_box(&mut index);
        let mut mask = 0;
        for l in 0..LANES {
            mask |= u16::from(self.distance[whole(index[l]) as usize] == 0) << l;
        }
        mask
    }

    /// Adds what an axis has to do with the numbers of the blocks that sixteen points are in.
    #[inline(always)]
    fn block_lanes(&self, places: &Lanes<f64>, last: f64, stride: f64, index: &mut Lanes<f64>) {
        for l in 0..LANES {
            let cell = clamped(places[l], last);
            index[l] += (cell * (1.0 / SIDE as f64)).floor() * stride;
        }
    }

    /// Up to where along the ray there is nothing, from the empty block on that it is in at `t`: a parameter, computed with
    /// rounding.
    #[inline(always)]
    pub(super) fn leap(&self, ray: &VoxelRay, t: f64) -> f64 {
        const SIZE: f64 = SIDE as f64;
        let p = ray.origin + t * ray.direction;
        let cell = p.max(DVec3::ZERO).min(self.last_cell);
        let block = (cell * (1.0 / SIZE)).floor();
        let [x, y, z] = [block.x as usize, block.y as usize, block.z as usize];
        let distance = self.distance[(z * self.count[1] + y) * self.count[0] + x];
        // A cube of blocks around this one that is all empty.
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

/// The box around the blocks whose distance is 0, a voxel wider than they are, which is more than any rounding of a place.
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

/// Brings every distance down to one more than the lowest among its 26 neighbours, in two sweeps: exact for the maximum
/// norm (Rosenfeld & Pfaltz, "Distance functions on digital pictures", 1968).
fn spread(distance: &mut [u8], count: [usize; 3]) {
    let [nx, ny, _] = count;
    let relax = |distance: &mut [u8], i: usize, forward: bool| {
        let place = [i % nx, i / nx % ny, i / nx / ny];
        let near = |axis: usize| place[axis].saturating_sub(1)..(place[axis] + 2).min(count[axis]);
        let mut least = distance[i];
        for z in near(2) {
            for y in near(1) {
                for x in near(0) {
                    let j = (z * ny + y) * nx + x;
                    if (j < i) == forward {
                        least = least.min(distance[j].saturating_add(1));
                    }
                }
            }
        }
        distance[i] = least;
    };
    for i in 0..distance.len() {
        relax(distance, i, true);
    }
    for i in (0..distance.len()).rev() {
        relax(distance, i, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Samples;
    use crate::volume::transfer::{Thickness, TransferNode};

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
        let space = EmptySpace::new(&grid(&matter, 1.0), &transfer(0.0));
        assert_eq!(space.count, [13; 3]);
        // No sample lies on a border of blocks, so each is in one.
        for i in 0..BLOCKS {
            let block: [usize; 3] = [i % 13, i / 13 % 13, i / 169];
            let away = |sample: &[usize; 3]| (0..3).map(|a: usize| block[a].abs_diff(sample[a] / 4)).max();
            let nearest = matter.iter().map(|sample| away(sample).unwrap()).min().unwrap();
            assert_eq!(usize::from(space.distance[i]), nearest, "{block:?}");
        }
    }

    #[test]
    fn a_sample_on_a_border_belongs_to_the_cells_on_both_sides() {
        let space = EmptySpace::new(&grid(&[[8, 8, 8]], 1.0), &transfer(0.0));
        let full = space.distance.iter().filter(|&&distance| distance == 0).count();
        assert_eq!(full, 8);
    }

    #[test]
    fn values_that_the_transfer_function_does_not_show_are_empty() {
        let matter = grid(&[[3, 3, 3]], 1.0);
        assert_eq!(EmptySpace::new(&matter, &transfer(1.5)).share(), 1.0);
        let all_but_one = (BLOCKS - 1) as f64 / BLOCKS as f64;
        assert_eq!(EmptySpace::new(&matter, &transfer(0.5)).share(), all_but_one);
        // At the very edge what rounding may add is not empty.
        assert_eq!(EmptySpace::new(&matter, &transfer(1.0)).share(), all_but_one);
    }

    #[test]
    fn a_leap_ends_before_the_first_block_with_matter() {
        let space = EmptySpace::new(&grid(&[[42, 5, 5]], 1.0), &transfer(0.0));
        let direction = DVec3::new(2.0, 0.0, 0.0);
        let ray = VoxelRay {
            origin: DVec3::new(-1.0, 5.0, 5.0),
            direction,
            inverse: direction.recip(),
        };
        // Matter is in block 10, cells 40 to 43; block 0 has a distance of 10: it sees to the end of block 9, x = 40.
        assert_eq!(space.leap(&ray, 0.5), 20.5);
        // Block 11 has a distance of 1: to its own end, x = 48.
        assert_eq!(space.leap(&ray, 23.0), 24.5);
    }

    #[test]
    fn the_span_of_matter_goes_on_beyond_the_border_only() {
        let space = EmptySpace::new(&grid(&[[1, 21, 46], [5, 26, 49]], 1.0), &transfer(0.0));
        // Blocks 0 to 1, 5 to 6 and 11 to 12 of 0 to 12, and a voxel on either side.
        let [low, high] = [
            DVec3::new(-f64::INFINITY, 19.0, 43.0),
            DVec3::new(9.0, 29.0, f64::INFINITY),
        ];
        assert_eq!(space.around_matter, [low, high]);
        let span = |origin: [f64; 3], direction: [f64; 3]| {
            let direction = DVec3::from_array(direction);
            space.span(&VoxelRay {
                origin: DVec3::from_array(origin),
                direction,
                inverse: direction.recip(),
            })
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
        let clear = EmptySpace::new(&grid(&[], 1.0), &transfer(0.0));
        let [start, end] = clear.span(&VoxelRay {
            origin: DVec3::ZERO,
            direction: DVec3::ONE,
            inverse: DVec3::ONE,
        });
        assert!(end < start);
    }

    #[test]
    fn points_are_asked_about_where_they_are_and_beyond_the_border() {
        let space = EmptySpace::new(&grid(&[[2, 2, 2], [49, 49, 49]], 1.0), &transfer(0.0));
        let mut places = [[20.0; LANES]; 3];
        let all = |x: f64| [x; 3];
        for (l, place) in [
            (0, all(3.9)),
            (1, all(4.1)),
            (2, [-1e9, 0.0, -0.0]),
            (5, [3.0, 3.0, 4.0]),
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
