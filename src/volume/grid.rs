//! Dense 3-D grids of scalars with trilinear interpolation.
//!
//! Sample (i, j, k) of nx · ny · nz is the centre of a voxel of the box [0, 1]³, x fastest: it lies at ((i + 1/2) / nx,
//! ...), like a texel. Outside the outermost centres values are clamped to the outermost samples. In *voxel space* the
//! samples lie at the integers, so that the cell of a point is its floor.
//!
//! Interpolation is three lerps a + t (b - a), in f64: eight equal samples give exactly their value, and no weight is
//! lost to rounding.

use glam::{DAffine3, DVec3};

use super::VolumeError;
use crate::numeric::{LANES, Lanes, Lanes3};

/// Immutable 3-D array whose values are all finite.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Numbers of samples along x, y, z as given.
    size: [usize; 3],
    /// Numbers of samples along x, y, z as stored: an axis of one sample is stored twice, so that every cell has eight
    /// corners.
    stored: [usize; 3],
    samples: GridSamples,
}

/// Values of a [`Grid`], x fastest, in the narrowest type that holds those of their source.
#[derive(Clone, Debug, PartialEq)]
pub enum GridSamples {
    /// Integers from 0 to 255, not normalised.
    Bytes(Vec<u8>),
    /// Integers from 0 to 65535, not normalised.
    Words(Vec<u16>),
    /// Finite floating-point numbers of any range.
    Floats(Vec<f32>),
}

/// Expands `$body` for each variant of [`GridSamples`], with its vector bound to `$values`.
macro_rules! of_any_type {
    ($samples:expr, $values:ident => $body:expr) => {
        match $samples {
            GridSamples::Bytes($values) => $body,
            GridSamples::Words($values) => $body,
            GridSamples::Floats($values) => $body,
        }
    };
}

impl GridSamples {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        of_any_type!(self, values => values.len())
    }

    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the value at `index`, which is less than [`GridSamples::len`].
    pub fn get(&self, index: usize) -> f32 {
        fn at<T: Copy + Into<f32>>(values: &[T], index: usize) -> f32 {
            values[index].into()
        }
        of_any_type!(self, values => at(values, index))
    }
}

/// Constant 2^52: adding it moves an integer below 2^52 to the low bits of the mantissa.
const ROUNDER: f64 = 4_503_599_627_370_496.0;
/// Mask of the 52 mantissa bits of an f64.
const MANTISSA: u64 = (1 << 52) - 1;

/// Cells of sixteen points: index of the lowest corner, and interpolation weights of the upper corners along each axis.
#[derive(Clone, Copy, Debug)]
struct CellWeights {
    first: Lanes<u64>,
    weight: Lanes3<f64>,
}

impl Grid {
    /// Creates a grid of `size` samples along x, y, z. `samples` holds as many as their product, x fastest.
    ///
    /// Rejects an axis without samples, a different count, and values that are not finite.
    pub fn new(size: [usize; 3], samples: GridSamples) -> Result<Grid, VolumeError> {
        // Check the number of samples
        let count = size
            .iter()
            .try_fold(1usize, |product, &side| product.checked_mul(side));
        if count != Some(samples.len()) || samples.is_empty() {
            return Err(VolumeError::Size {
                size,
                count: samples.len(),
            });
        }
        // Reject NaN and infinity; integers cannot hold them
        if let GridSamples::Floats(values) = &samples
            && let Some(index) = values.iter().position(|value| !value.is_finite())
        {
            return Err(VolumeError::NotFinite {
                at: [
                    index % size[0],
                    index / size[0] % size[1],
                    index / size[0] / size[1],
                ],
            });
        }
        // Duplicate the sample of axes that have only one
        let stored = size.map(|side| side.max(2));
        let samples = if stored == size {
            samples
        } else {
            doubled(samples, size, stored)
        };
        Ok(Grid {
            size,
            stored,
            samples,
        })
    }

    /// Returns the numbers of samples along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Returns the bytes of memory that the samples take.
    pub fn memory(&self) -> usize {
        of_any_type!(&self.samples, values => size_of_val(values.as_slice()))
    }

    /// Returns the map from the box [0, 1]³ to voxel space.
    pub(crate) fn voxel_from_box(&self) -> DAffine3 {
        let size = DVec3::from_array(self.size.map(|side| side as f64));
        DAffine3::from_translation(DVec3::splat(-0.5)) * DAffine3::from_scale(size)
    }

    /// Returns the numbers of cells along x, y, z: one fewer than samples, at least one.
    pub(super) fn cells(&self) -> [usize; 3] {
        self.stored.map(|side| side - 1)
    }

    /// Returns the minimum and maximum over the corner samples of the cells from `from` to `to`, the latter excluded.
    pub(super) fn range(&self, from: [usize; 3], to: [usize; 3]) -> [f32; 2] {
        of_any_type!(&self.samples, values => self.range_of(values, from, to))
    }

    /// Implements [`Grid::range`] for one sample type.
    fn range_of<T: Copy + Into<f32>>(&self, values: &[T], from: [usize; 3], to: [usize; 3]) -> [f32; 2] {
        let [nx, ny, _] = self.stored;
        let mut range = [f32::INFINITY, f32::NEG_INFINITY];
        for z in from[2]..=to[2] {
            for y in from[1]..=to[1] {
                let row = (z * ny + y) * nx;
                for &value in &values[row + from[0]..=row + to[0]] {
                    let value = value.into();
                    range = [range[0].min(value), range[1].max(value)];
                }
            }
        }
        range
    }

    /// Returns the interpolated value at `p` in voxel space.
    pub fn sample(&self, p: DVec3) -> f64 {
        self.sample_lanes(&p.to_array().map(|x| [x; LANES]))[0]
    }

    /// Returns the interpolated values at sixteen points in voxel space, each finite.
    #[inline(always)]
    pub(super) fn sample_lanes(&self, p: &Lanes3<f64>) -> Lanes<f64> {
        // Load the eight corners of each cell
        let points = self.points(p);
        let rows = of_any_type!(&self.samples, values => self.rows(values, &points.first));
        // Interpolate along x, then y, then z
        let [u, v, w] = &points.weight;
        let mut value = [0.0; LANES];
        for l in 0..LANES {
            let x00 = lerp(u[l], rows.near[0][l], rows.far[0][l]);
            let x10 = lerp(u[l], rows.near[1][l], rows.far[1][l]);
            let x01 = lerp(u[l], rows.near[2][l], rows.far[2][l]);
            let x11 = lerp(u[l], rows.near[3][l], rows.far[3][l]);
            value[l] = lerp(w[l], lerp(v[l], x00, x10), lerp(v[l], x01, x11));
        }
        value
    }

    /// Returns the cells and weights of sixteen points; coordinates are clamped to the outermost samples.
    #[inline(always)]
    fn points(&self, p: &Lanes3<f64>) -> CellWeights {
        let mut weight = [[0.0; LANES]; 3];
        let mut index = [0.0; LANES];
        let mut stride = 1.0;
        for axis in 0..3 {
            let last_sample = (self.size[axis] - 1) as f64;
            let last_cell = (self.stored[axis] - 2) as f64;
            // Clamp to the samples and split into cell and weight
            for l in 0..LANES {
                let x = clamped(p[axis][l], last_sample);
                let floor = x.floor();
                let cell = if floor < last_cell { floor } else { last_cell };
                weight[axis][l] = x - cell;
                // Integers below 2^52: exact.
                index[l] += cell * stride;
            }
            stride *= self.stored[axis] as f64;
        }
        let first = index.map(whole);
        CellWeights { first, weight }
    }

    /// Loads the corners of sixteen cells, two neighbours along x at a time.
    #[inline(always)]
    fn rows<T: Sample>(&self, values: &[T], first: &Lanes<u64>) -> Rows {
        let row = self.stored[0];
        let slice = row * self.stored[1];
        let mut rows = Rows {
            near: [[0.0; LANES]; 4],
            far: [[0.0; LANES]; 4],
        };
        for (r, ahead) in [0, row, slice, slice + row].into_iter().enumerate() {
            let values = &values[ahead..];
            let mut pairs = [0; LANES];
            for l in 0..LANES {
                // The mask is a no-op that lets the compiler prove that start + 2 does not overflow, which saves a
                // check.
                let start = (first[l] & MANTISSA) as usize;
                pairs[l] = match values.get(start..start + 2) {
                    Some(&[a, b]) => T::pair([a, b]),
                    _ => outside(),
                };
            }
            for l in 0..LANES {
                [rows.near[r][l], rows.far[r][l]] = T::apart(pairs[l]).map(f64::from);
            }
        }
        rows
    }
}

/// Panics for a cell outside its grid, out of line so that the hot loop stays small.
#[cold]
fn outside() -> ! {
    panic!("a cell outside its grid")
}

/// Corner values of sixteen cells in rows along x: row r has (y, z) offsets (0, 0), (1, 0), (0, 1), (1, 1) from the
/// lowest corner.
struct Rows {
    near: [Lanes<f64>; 4],
    far: [Lanes<f64>; 4],
}

/// Sample type of which two neighbours are packed in 64 bits, to be loaded at once and unpacked with vector
/// instructions.
trait Sample: Copy {
    /// Packs two neighbours into 64 bits.
    fn pair(pair: [Self; 2]) -> u64;
    /// Unpacks two neighbours and converts them to f32.
    fn apart(pair: u64) -> [f32; 2];
}

impl Sample for f32 {
    #[inline(always)]
    fn pair([a, b]: [f32; 2]) -> u64 {
        u64::from(a.to_bits()) | u64::from(b.to_bits()) << 32
    }

    #[inline(always)]
    fn apart(pair: u64) -> [f32; 2] {
        [f32::from_bits(pair as u32), f32::from_bits((pair >> 32) as u32)]
    }
}

impl Sample for u8 {
    #[inline(always)]
    fn pair([a, b]: [u8; 2]) -> u64 {
        u64::from(a) | u64::from(b) << 32
    }

    #[inline(always)]
    fn apart(pair: u64) -> [f32; 2] {
        [(pair as u32) as f32, ((pair >> 32) as u32) as f32]
    }
}

impl Sample for u16 {
    #[inline(always)]
    fn pair([a, b]: [u16; 2]) -> u64 {
        u64::from(a) | u64::from(b) << 32
    }

    #[inline(always)]
    fn apart(pair: u64) -> [f32; 2] {
        [(pair as u32) as f32, ((pair >> 32) as u32) as f32]
    }
}

/// Converts an integral f64 from 0 to 2^52, excluded, to an integer.
#[inline(always)]
pub(super) fn whole(x: f64) -> u64 {
    (x + ROUNDER).to_bits() & MANTISSA
}

/// Returns `x` clamped to [0, last]; NaN gives 0.
#[inline(always)]
pub(super) fn clamped(x: f64, last: f64) -> f64 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < last { x } else { last }
}

/// Interpolates linearly; exact at t = 0, and where a = b.
#[inline(always)]
fn lerp(t: f64, a: f64, b: f64) -> f64 {
    a + t * (b - a)
}

/// Bound on the rounding error of an interpolated value, relative to the largest magnitude among the corners: each of
/// the three lerps rounds a difference of up to twice that magnitude, a product and a sum, each with a relative error
/// of 2^-53.
pub(super) const LERP_ERROR: f64 = 3.0 * 5.0 * (f64::EPSILON / 2.0);

/// Copies the samples so that every axis of one sample has two equal samples.
fn doubled(samples: GridSamples, size: [usize; 3], stored: [usize; 3]) -> GridSamples {
    fn copy<T: Copy>(values: &[T], size: [usize; 3], stored: [usize; 3]) -> Vec<T> {
        let at = |i: usize| {
            let place = [
                i % stored[0],
                i / stored[0] % stored[1],
                i / stored[0] / stored[1],
            ];
            let [x, y, z] = [0, 1, 2].map(|axis| place[axis].min(size[axis] - 1));
            values[(z * size[1] + y) * size[0] + x]
        };
        (0..stored.iter().product()).map(at).collect()
    }
    match samples {
        GridSamples::Bytes(values) => GridSamples::Bytes(copy(&values, size, stored)),
        GridSamples::Words(values) => GridSamples::Words(copy(&values, size, stored)),
        GridSamples::Floats(values) => GridSamples::Floats(copy(&values, size, stored)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a function that is linear in each coordinate, so that trilinear interpolation is exact.
    fn trilinear(p: DVec3) -> f64 {
        1.0 + 2.0 * p.x - 3.0 * p.y + 0.5 * p.z + p.x * p.y - 0.25 * p.x * p.y * p.z
    }

    /// Returns a grid of `value` at the integer points of voxel space.
    fn grid(size: [usize; 3], value: impl Fn(DVec3) -> f64) -> Grid {
        let mut values = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    values.push(value(DVec3::new(x as f64, y as f64, z as f64)) as f32);
                }
            }
        }
        Grid::new(size, GridSamples::Floats(values)).unwrap()
    }

    #[test]
    fn trilinear_functions_are_interpolated_exactly() {
        let grid = grid([5, 3, 4], trilinear);
        for p in [
            DVec3::ZERO,
            DVec3::new(0.25, 1.5, 2.75),
            DVec3::new(3.75, 0.5, 0.125),
            DVec3::new(4.0, 2.0, 3.0),
            DVec3::new(1.0, 1.9, 3.0),
        ] {
            // Values and weights have few bits; 1.9 has rounding errors of magnitudes up to 20.
            assert!((grid.sample(p) - trilinear(p)).abs() <= 20.0 * LERP_ERROR, "{p}");
        }
    }

    #[test]
    fn outermost_samples_extend_to_the_border() {
        let grid = grid([5, 3, 4], trilinear);
        let corner = trilinear(DVec3::new(4.0, 0.0, 3.0));
        for p in [DVec3::new(4.5, -0.5, 3.5), DVec3::new(1e300, -1e300, 1e9)] {
            assert_eq!(grid.sample(p), corner);
        }
    }

    #[test]
    fn equal_samples_interpolate_exactly() {
        let grid = grid([3, 3, 3], |_| 0.1);
        for i in 0..100 {
            let t = f64::from(i) / 37.0;
            assert_eq!(grid.sample(DVec3::new(t, 0.7 * t, 1.0 - t)), f64::from(0.1f32));
        }
    }

    #[test]
    fn axis_of_one_sample_is_constant() {
        let flat = grid([4, 1, 1], |p| p.x * p.x);
        assert_eq!(flat.size(), [4, 1, 1]);
        assert_eq!(flat.sample(DVec3::new(2.5, -0.5, 0.5)), 6.5);
        let single = grid([1, 1, 1], |_| 7.0);
        assert_eq!(single.sample(DVec3::new(0.3, -4.0, 0.9)), 7.0);
    }

    #[test]
    fn bytes_and_words_keep_their_values() {
        let bytes = Grid::new([2, 1, 1], GridSamples::Bytes(vec![0, 255])).unwrap();
        assert_eq!(bytes.sample(DVec3::new(0.5, 0.0, 0.0)), 127.5);
        let words = Grid::new([2, 1, 1], GridSamples::Words(vec![65535, 1])).unwrap();
        assert_eq!(words.sample(DVec3::new(0.25, 0.0, 0.0)), 49151.5);
    }

    #[test]
    fn voxel_centres_are_integers_in_voxel_space() {
        let grid = grid([4, 2, 1], |p| p.x);
        let map = grid.voxel_from_box();
        assert_eq!(
            map.transform_point3(DVec3::new(0.125, 0.75, 0.5)),
            DVec3::new(0.0, 1.0, 0.0)
        );
        assert_eq!(map.transform_point3(DVec3::ONE), DVec3::new(3.5, 1.5, 0.5));
    }

    #[test]
    fn wrong_counts_empty_axes_and_nan_are_rejected() {
        for size in [[2, 2, 2], [0, 3, 1], [usize::MAX, 4, 4], [3, 0, 0]] {
            assert!(matches!(
                Grid::new(size, GridSamples::Bytes(vec![0; 3])),
                Err(VolumeError::Size { .. })
            ));
        }
        assert!(Grid::new([0, 0, 0], GridSamples::Bytes(vec![])).is_err());
        let mut values = vec![0.0; 24];
        values[2 * 6 + 3 + 1] = f32::NAN;
        assert_eq!(
            Grid::new([3, 2, 4], GridSamples::Floats(values)),
            Err(VolumeError::NotFinite { at: [1, 1, 2] })
        );
    }
}
