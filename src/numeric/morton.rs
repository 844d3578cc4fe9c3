//! Points in a cube, ordered along Morton's curve (G. M. Morton 1966), whose runs are the cells of an octree.

use glam::DVec3;
use rayon::prelude::*;

use super::Bounds;
use crate::parallel;

/// Number of binary digits of each coordinate.
const BITS_PER_AXIS: u32 = 21;

/// Morton code of a point with its index.
pub(crate) type MortonKey = (u64, u32);

/// Morton curve through a cube.
#[derive(Clone, Copy, Debug)]
struct MortonCurve {
    corner: DVec3,
    cells_per_unit: f64,
}

impl MortonCurve {
    /// Creates the curve through the smallest cube at the lower corner of `bounds` that encloses them.
    fn around(bounds: &Bounds) -> MortonCurve {
        MortonCurve {
            corner: bounds.min,
            cells_per_unit: f64::from(1u32 << BITS_PER_AXIS) / bounds.extent().max_element(),
        }
    }

    /// Returns the Morton code of a finite position in the cube: a number of three times [`BITS_PER_AXIS`] bits.
    #[inline(always)]
    fn code(&self, position: DVec3) -> u64 {
        // In a cube of zero size all codes are 0: 0 · infinity is NaN, which is cast to 0.
        let cell = ((position - self.corner) * self.cells_per_unit).to_array();
        let [x, y, z] = cell.map(|x| (x as u64).min((1 << BITS_PER_AXIS) - 1));
        spread(x) | spread(y) << 1 | spread(z) << 2
    }
}

/// Returns the Morton codes of `position(0..count)` in the cube around them, in ascending order; equal codes are sorted
/// by index. Also returns the bounds of the positions.
///
/// The result does not depend on the number of threads. `count` must be below 2^32, and positions finite.
pub(crate) fn sorted_keys(
    count: usize,
    position: impl Fn(usize) -> DVec3 + Sync,
) -> (Bounds, Vec<MortonKey>) {
    const CHUNK: usize = 1 << 14;
    // Bound the positions
    let in_chunk = |chunk: usize| {
        let first = chunk * CHUNK;
        Bounds::of_points((first..count.min(first + CHUNK)).map(&position))
    };
    let bounds = parallel::map(count.div_ceil(CHUNK), &in_chunk);
    let bounds = bounds.into_iter().fold(Bounds::EMPTY, Bounds::union);
    // Compute and sort the codes
    let curve = MortonCurve::around(&bounds);
    let mut keys: Vec<MortonKey> = parallel::generate(count, |i| (curve.code(position(i)), i as u32));
    keys.par_sort_unstable();
    (bounds, keys)
}

/// Spreads the lowest 21 bits, with two zeros before each.
fn spread(digits: u64) -> u64 {
    let mut v = digits;
    v = (v | v << 32) & 0x001f_0000_0000_ffff;
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread_to_every_third_position() {
        for bit in 0..BITS_PER_AXIS {
            assert_eq!(spread(1 << bit), 1 << (3 * bit));
        }
        assert_eq!(spread(0b1011), 0b1000001001);
    }

    #[test]
    fn morton_order_sorts_cube_corners_and_ties_by_index() {
        let corner = |i: usize| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64);
        let (bounds, keys) = sorted_keys(16, |i| corner(15 - i));
        assert_eq!((bounds.min, bounds.max), (DVec3::ZERO, DVec3::ONE));
        let order: Vec<u32> = keys.iter().map(|key| key.1).collect();
        assert_eq!(order, [7, 15, 6, 14, 5, 13, 4, 12, 3, 11, 2, 10, 1, 9, 0, 8]);
    }

    #[test]
    fn coincident_points_have_one_code() {
        let (_, keys) = sorted_keys(3, |_| DVec3::splat(5.0));
        assert_eq!(keys, [(0, 0), (0, 1), (0, 2)]);
    }
}
