//! Where a volume is empty: lowest and highest values of blocks of cells, and how far the nearest matter is.
//!
//! A block is empty if the transfer function has neither opacity nor emission over all values between its lowest and its
//! highest, widened by what the interpolation can round. Samples there add exactly nothing, so that leaving them out
//! changes no bit. Every block knows its distance to the nearest one of the other kind, in blocks in the maximum norm
//! (Zuiderveld, Koning & Viergever, "Acceleration of ray-casting using 3-D distance transforms", 1992), so that a ray
//! leaps through a whole cube of empty ones at once, and asks once about a whole cube of full ones.

use glam::DVec3;
use rayon::prelude::*;

use super::grid::{Grid, LERP_ERROR};
use super::transfer::Transfer;

/// Cells along a block's side: fewer cost more leaps, more leave less empty.
const SIDE: usize = 8;

/// The empty space of one grid under one transfer function.
#[derive(Clone, Debug, PartialEq)]
pub struct EmptySpace {
    /// Blocks along x, y, z.
    count: [usize; 3],
    /// Highest cell along x, y, z.
    last_cell: DVec3,
    /// Blocks to the nearest of the other kind, at most 127: positive in empty ones, negative in those with matter; x
    /// fastest.
    distance: Vec<i8>,
}

/// What lies around a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surroundings {
    /// Whether nothing is there.
    pub(super) empty: bool,
    /// Up to where along the ray it stays so: a parameter, computed with rounding.
    pub(super) until: f64,
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
        let empty: Vec<bool> = (0..nx * ny * nz)
            .into_par_iter()
            .map(|i| {
                let block = [i % nx, i / nx % ny, i / nx / ny];
                let from = block.map(|b| b * SIDE);
                let to = [0, 1, 2].map(|axis| (from[axis] + SIDE).min(cells[axis]));
                let [low, high] = grid.range(from, to).map(f64::from);
                let slack = LERP_ERROR * low.abs().max(high.abs());
                transfer.most(low - slack, high + slack) == (0.0, false)
            })
            .collect();
        let [to_full, to_empty] = [true, false].map(|inside| distances(&empty, inside, count));
        let distance = to_full.iter().zip(&to_empty).map(|(full, empty)| full - empty);
        EmptySpace {
            count,
            last_cell: DVec3::from_array(cells.map(|cells| (cells - 1) as f64)),
            distance: distance.collect(),
        }
    }

    /// Share of the blocks that are empty.
    pub fn share(&self) -> f64 {
        let empty = self.distance.iter().filter(|&&distance| distance > 0).count();
        empty as f64 / self.distance.len() as f64
    }

    /// Bytes of memory that the blocks take.
    pub fn byte_count(&self) -> usize {
        size_of_val(&self.distance[..])
    }

    /// What lies around the point of the ray at `t`.
    #[inline(always)]
    pub(super) fn around(&self, ray: &VoxelRay, t: f64) -> Surroundings {
        const SIZE: f64 = SIDE as f64;
        let p = ray.origin + t * ray.direction;
        let cell = p.max(DVec3::ZERO).min(self.last_cell);
        let [x, y, z] = cell.to_array().map(|x| x as usize / SIDE);
        let distance = self.distance[(z * self.count[1] + y) * self.count[0] + x];
        // A cube of blocks around this one that is all alike.
        let reach = f64::from(distance).abs() - 1.0;
        let mut until = f64::INFINITY;
        for (axis, block) in [x, y, z].into_iter().enumerate() {
            let direction = ray.direction[axis];
            let ahead = if direction > 0.0 { 1.0 + reach } else { -reach };
            let border = (block as f64 + ahead) * SIZE;
            let leave = (border - ray.origin[axis]) * ray.inverse[axis];
            if direction != 0.0 && leave < until {
                until = leave;
            }
        }
        Surroundings {
            empty: distance > 0,
            until,
        }
    }
}

/// Distances from the blocks that are `inside`, empty or not, to the nearest that are not; 0 in the latter.
fn distances(empty: &[bool], inside: bool, count: [usize; 3]) -> Vec<i8> {
    let far = |&empty: &bool| if empty == inside { i8::MAX } else { 0 };
    let mut distance: Vec<i8> = empty.iter().map(far).collect();
    spread(&mut distance, count);
    distance
}

/// Brings every distance down to one more than the lowest among its 26 neighbours, in two sweeps: exact for the maximum
/// norm (Rosenfeld & Pfaltz, "Distance functions on digital pictures", 1968).
fn spread(distance: &mut [i8], count: [usize; 3]) {
    let [nx, ny, _] = count;
    let relax = |distance: &mut [i8], i: usize, forward: bool| {
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
        let matter = [[3, 4, 5], [41, 4, 44], [17, 30, 21]];
        let space = EmptySpace::new(&grid(&matter, 1.0), &transfer(0.0));
        assert_eq!(space.count, [7; 3]);
        // No sample lies on a border of blocks, so each is in one.
        for i in 0..343usize {
            let block: [usize; 3] = [i % 7, i / 7 % 7, i / 49];
            let away = |sample: &[usize; 3]| (0..3).map(|a: usize| block[a].abs_diff(sample[a] / 8)).max();
            let nearest = matter.iter().map(|sample| away(sample).unwrap()).min().unwrap();
            assert_eq!(
                usize::from(space.distance[i].max(0).unsigned_abs()),
                nearest,
                "{block:?}"
            );
            // Those with matter have empty ones beside them.
            assert!(nearest > 0 || space.distance[i] == -1);
        }
    }

    #[test]
    fn a_sample_on_a_border_belongs_to_the_cells_on_both_sides() {
        let space = EmptySpace::new(&grid(&[[8, 8, 8]], 1.0), &transfer(0.0));
        let full = space.distance.iter().filter(|&&distance| distance < 0).count();
        assert_eq!(full, 8);
    }

    #[test]
    fn values_that_the_transfer_function_does_not_show_are_empty() {
        let matter = grid(&[[3, 3, 3]], 1.0);
        assert_eq!(EmptySpace::new(&matter, &transfer(1.5)).share(), 1.0);
        assert_eq!(EmptySpace::new(&matter, &transfer(0.5)).share(), 342.0 / 343.0);
        // At the very edge what rounding may add is not empty.
        assert_eq!(EmptySpace::new(&matter, &transfer(1.0)).share(), 342.0 / 343.0);
    }

    #[test]
    fn a_leap_ends_before_the_first_block_with_matter() {
        let space = EmptySpace::new(&grid(&[[44, 4, 4]], 1.0), &transfer(0.0));
        let direction = DVec3::new(2.0, 0.0, 0.0);
        let ray = VoxelRay {
            origin: DVec3::new(-1.0, 4.0, 4.0),
            direction,
            inverse: direction.recip(),
        };
        // Matter is in block 5, cells 40 to 47; block 0 has a distance of 5: it sees to the end of block 4, x = 40.
        let around = space.around(&ray, 0.5);
        assert_eq!((around.empty, around.until), (true, 20.5));
        let around = space.around(&ray, 21.0);
        assert_eq!((around.empty, around.until), (false, 24.5));
    }
}
