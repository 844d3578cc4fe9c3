//! Primitives sorted by the Morton codes of their centres.
//!
//! A key is a code with the primitive's index below it in one u64. The keys are sorted by their highest digit first: each
//! part of the primitives by itself, in cache, then gathered by digit; within the digit, lowest digit first, in cache
//! again.

use std::ops::Range;
use std::sync::Mutex;

use glam::Vec3A;
use multiversion::multiversion;
use rayon::prelude::*;

use super::box4::Box4;
use crate::parallel;

/// Number of binary digits of each coordinate.
const BITS_PER_AXIS: u32 = 13;
/// Number of binary digits of a code.
const CODE_BITS: u32 = 3 * BITS_PER_AXIS;
/// Number of binary digits by which keys are distributed first.
const TOP_BITS: u32 = 13;
/// Number of values of the top digit.
const BUCKETS: usize = 1 << TOP_BITS;
/// Number of binary digits by which keys are sorted at once within a bucket, in three passes.
const DIGIT_BITS: u32 = 9;
/// Number of values of a digit within a bucket.
const DIGITS: usize = 1 << DIGIT_BITS;
/// Number of passes within a bucket.
const PASSES: usize = 3;
/// Number of keys that are computed at once.
const BATCH: usize = 64;
/// Size of a bucket up to which comparisons are faster than digits.
const SMALL_BUCKET: usize = 96;
/// Least number of primitives of a part, whose keys are to fit into cache.
const PART: usize = 1 << 15;
/// Maximum number of parts: each adds a run of keys to every bucket.
const MAX_PARTS: usize = 64;
/// Least number of keys that a task sorts.
const TASK: usize = 1 << 13;

/// Sorted keys: Morton codes with the indices of primitives below.
pub(in crate::accel) struct SortedKeys {
    keys: Vec<u64>,
    index_bits: u32,
}

impl SortedKeys {
    /// Returns the index of the primitive at a position in the order.
    #[inline(always)]
    pub(in crate::accel) fn number(&self, position: usize) -> usize {
        number_of(self.keys[position], self.index_bits)
    }

    /// Returns all keys for being cut.
    pub(super) fn all(&mut self) -> KeyRange<'_> {
        KeyRange {
            first: 0,
            keys: &mut self.keys,
            index_bits: self.index_bits,
        }
    }
}

/// Keys at some positions in the order.
pub(super) struct KeyRange<'a> {
    /// Position of the first key.
    pub(super) first: usize,
    keys: &'a mut [u64],
    index_bits: u32,
}

impl<'a> KeyRange<'a> {
    /// Returns the number of keys.
    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Returns the Morton code at an offset from the first position.
    #[inline(always)]
    pub(super) fn code(&self, offset: usize) -> u64 {
        self.keys[offset] >> self.index_bits
    }

    /// Splits the keys in two, of which the second begin at an offset.
    pub(super) fn split_at(self, offset: usize) -> [KeyRange<'a>; 2] {
        let (front, back) = self.keys.split_at_mut(offset);
        [(self.first, front), (self.first + offset, back)].map(|(first, keys)| KeyRange {
            first,
            keys,
            index_bits: self.index_bits,
        })
    }

    /// Sorts keys of equal codes by new ones, in a cube around their own centres; returns whether any of these differ.
    pub(super) fn refine(&mut self, twice_centre: impl Fn(usize) -> Vec3A) -> bool {
        // Bound the centres
        let keys = &mut *self.keys;
        let mut centres = Box4::EMPTY;
        for key in &*keys {
            centres.add_point(0.5 * twice_centre(number_of(*key, self.index_bits)));
        }
        // Compute the codes and sort by them
        let curve = KeyCurve::around(&centres, self.index_bits);
        for key in &mut *keys {
            let number = number_of(*key, self.index_bits);
            *key = curve.key(twice_centre(number), number);
        }
        keys.par_sort_unstable();
        let codes = [keys.first(), keys.last()].map(|key| key.map(|key| key >> self.index_bits));
        codes[0] != codes[1]
    }
}

/// Returns the index of a primitive from its key.
#[inline(always)]
fn number_of(key: u64, index_bits: u32) -> usize {
    (key & ((1 << index_bits) - 1)) as usize
}

/// Keys of one part of the primitives, distributed by their top digits.
struct KeyPart {
    keys: Vec<u64>,
    /// Position after the last key of each bucket.
    ends: Vec<u32>,
}

/// Returns primitives `0..count` in the order of the Morton codes of their centres in a cube around `bounds`; those with
/// equal codes in the order of their indices. Centres outside of the cube are moved to its border, NaN to the lower one.
pub(in crate::accel) fn sorted(
    count: usize,
    bounds: &Box4,
    twice_centre: impl Fn(usize) -> Vec3A + Sync,
) -> SortedKeys {
    // Make room for the indices by leaving out low digits of codes, for more than 33 million primitives
    let index_bits = (usize::BITS - count.leading_zeros()).max(u64::BITS - CODE_BITS);
    let curve = KeyCurve::around(bounds, index_bits);
    // Distribute the keys of each part
    let part_len = count.div_ceil(MAX_PARTS).max(PART);
    let parts = parallel::map(count.div_ceil(part_len), &|part| {
        let first = part * part_len;
        distributed(&twice_centre, &curve, first..count.min(first + part_len))
    });
    // Gather and sort the buckets
    let mut keys: Vec<u64> = bytemuck::zeroed_vec(count);
    let tasks = bucket_tasks(&parts, &mut keys);
    parallel::for_each(tasks.len(), &|task| {
        if let Ok(mut task) = tasks[task].lock() {
            task.gather_and_sort(&parts, index_bits);
        }
    });
    drop(tasks);
    SortedKeys { keys, index_bits }
}

/// Morton's curve through a cube.
struct KeyCurve {
    /// Twice the lower corner.
    corner: Vec3A,
    /// Half the number of cells a unit.
    scale: Vec3A,
    /// Number of low digits that are left out.
    dropped_bits: u32,
    index_bits: u32,
}

impl KeyCurve {
    fn around(bounds: &Box4, index_bits: u32) -> KeyCurve {
        let cells = ((1u32 << BITS_PER_AXIS) - 1) as f32;
        let extent = (bounds.high - bounds.low).max_element();
        // All centres of a cube without extent are in its first cell.
        let scale = if extent > 0.0 { 0.5 * cells / extent } else { 0.0 };
        KeyCurve {
            corner: bounds.low + bounds.low,
            scale: Vec3A::splat(if scale.is_finite() { scale } else { 0.0 }),
            dropped_bits: index_bits + CODE_BITS - u64::BITS,
            index_bits,
        }
    }

    #[inline(always)]
    fn key(&self, twice_centre: Vec3A, number: usize) -> u64 {
        let coordinates = ((twice_centre - self.corner) * self.scale).to_array();
        let [x, y, z] = coordinates.map(|coordinate| spread(cell(coordinate)));
        ((x | y << 1 | z << 2) >> self.dropped_bits) << self.index_bits | number as u64
    }
}

/// Returns the keys of primitives `first` and those after it: those of [`KeyCurve::key`].
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn key_batch(curve: &KeyCurve, twice_centres: &[[f32; BATCH]; 3], first: usize) -> [u64; BATCH] {
    // Find the cells along each axis, and interleave their digits
    let mut keys = [0; BATCH];
    let (corner, scale) = (curve.corner.to_array(), curve.scale.to_array());
    add_digits(&twice_centres[0], corner[0], scale[0], 0, &mut keys);
    add_digits(&twice_centres[1], corner[1], scale[1], 1, &mut keys);
    add_digits(&twice_centres[2], corner[2], scale[2], 2, &mut keys);
    // Put the indices below
    for i in 0..BATCH {
        keys[i] = (keys[i] >> curve.dropped_bits) << curve.index_bits | (first + i) as u64;
    }
    keys
}

/// Adds the digits of the cells of centres along one axis to their codes.
#[inline(always)]
fn add_digits(twice_centres: &[f32; BATCH], corner: f32, scale: f32, axis: u32, codes: &mut [u64; BATCH]) {
    for i in 0..BATCH {
        codes[i] |= spread(cell((twice_centres[i] - corner) * scale)) << axis;
    }
}

/// Returns the index of the cell that contains a coordinate in cells: 0 below the first and for NaN, the last one above.
#[inline(always)]
fn cell(coordinate: f32) -> u32 {
    /// From here to twice as much, the last bit of a number has the value 1.
    const ONES: f32 = (1 << 23) as f32;
    const LAST: f32 = ((1 << BITS_PER_AXIS) - 1) as f32;
    let coordinate = if coordinate > 0.0 {
        coordinate.min(LAST)
    } else {
        0.0
    };
    // Round down by hand: the cast of the language, which saturates, is not vectorised
    let nearest = coordinate + ONES - ONES;
    let whole = if nearest > coordinate {
        nearest - 1.0
    } else {
        nearest
    };
    (whole + ONES).to_bits() - ONES.to_bits()
}

/// Spreads the lowest 13 bits, with two zeros before each.
#[inline(always)]
fn spread(digits: u32) -> u64 {
    let mut v = u64::from(digits);
    v = (v | v << 16) & 0x001f_0000_ff00_00ff;
    v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
    v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
    (v | v << 2) & 0x1249_2492_4924_9249
}

/// Returns the top digit of a key.
#[inline(always)]
fn bucket_of(key: u64) -> usize {
    (key >> (u64::BITS - TOP_BITS)) as usize
}

/// Computes the keys of a range of primitives and distributes them by their top digits.
fn distributed(twice_centre: &impl Fn(usize) -> Vec3A, curve: &KeyCurve, range: Range<usize>) -> KeyPart {
    // Compute the keys in batches, and count them by bucket
    let mut unsorted = Vec::with_capacity(range.len());
    let mut ends = vec![0u32; BUCKETS];
    let mut centres = [[0.0; BATCH]; 3];
    for first in range.clone().step_by(BATCH) {
        // Gather the centres; those behind the last one are left out
        let count = BATCH.min(range.end - first);
        for i in 0..count {
            let [x, y, z] = twice_centre(first + i).to_array();
            (centres[0][i], centres[1][i], centres[2][i]) = (x, y, z);
        }
        let keys = key_batch(curve, &centres, first);
        for &key in &keys[..count] {
            ends[bucket_of(key)] += 1;
        }
        unsorted.extend_from_slice(&keys[..count]);
    }
    // Turn counts into starts, which placing the keys turns into ends
    let mut start = 0;
    for end in &mut ends {
        start += std::mem::replace(end, start);
    }
    // Place the keys
    let mut keys = vec![0; unsorted.len()];
    for key in unsorted {
        let end = &mut ends[bucket_of(key)];
        keys[*end as usize] = key;
        *end += 1;
    }
    KeyPart { keys, ends }
}

/// Range of buckets that one task sorts, with their place in the order.
struct BucketTask<'a> {
    first: usize,
    /// Number of keys in each bucket from the first.
    counts: Vec<usize>,
    keys: &'a mut [u64],
}

/// Divides the order into tasks of whole buckets.
fn bucket_tasks<'a>(parts: &[KeyPart], keys: &'a mut [u64]) -> Vec<Mutex<BucketTask<'a>>> {
    let mut tasks = Vec::new();
    let mut rest = keys;
    let (mut first, mut counts, mut total) = (0, Vec::new(), 0);
    let mut starts = vec![0u32; parts.len()];
    for bucket in 0..BUCKETS {
        // Count the bucket's keys in all parts
        let mut count = 0;
        for (part, start) in parts.iter().zip(&mut starts) {
            let end = part.ends[bucket];
            count += (end - std::mem::replace(start, end)) as usize;
        }
        counts.push(count);
        total += count;
        // Close the task when it has enough
        if total >= TASK || bucket == BUCKETS - 1 {
            let (keys, behind) = rest.split_at_mut(total);
            rest = behind;
            let counts = std::mem::take(&mut counts);
            tasks.push(Mutex::new(BucketTask { first, counts, keys }));
            (first, total) = (bucket + 1, 0);
        }
    }
    tasks
}

impl BucketTask<'_> {
    fn gather_and_sort(&mut self, parts: &[KeyPart], index_bits: u32) {
        // Find where the first bucket's run starts in each part
        let mut gathered: Vec<u64> = Vec::new();
        let mut starts: Vec<u32> = parts
            .iter()
            .map(|part| {
                if self.first == 0 {
                    0
                } else {
                    part.ends[self.first - 1]
                }
            })
            .collect();
        let mut rest = &mut *self.keys;
        for (offset, &count) in self.counts.iter().enumerate() {
            if count == 0 {
                continue;
            }
            // Gather the bucket's run in each part
            gathered.clear();
            for (part, start) in parts.iter().zip(&mut starts) {
                let end = part.ends[self.first + offset];
                gathered.extend_from_slice(&part.keys[*start as usize..end as usize]);
                *start = end;
            }
            // Sort them into their place
            let (sorted, behind) = rest.split_at_mut(count);
            rest = behind;
            sort_bucket(&mut gathered, sorted, index_bits);
        }
    }
}

/// Writes the keys of one bucket to `sorted` in order; `gathered` is overwritten.
fn sort_bucket(gathered: &mut [u64], sorted: &mut [u64], index_bits: u32) {
    // Sort a small bucket by comparisons
    if gathered.len() <= SMALL_BUCKET {
        sorted.copy_from_slice(gathered);
        return sorted.sort_unstable();
    }
    // Count all digits in one pass
    let digit = |key: u64, pass: usize| (key >> (index_bits + DIGIT_BITS * pass as u32)) as usize % DIGITS;
    let mut places = [[0u32; DIGITS]; PASSES];
    for &key in &*gathered {
        for pass in 0..PASSES {
            places[pass][digit(key, pass)] += 1;
        }
    }
    // Place the keys by one digit after the other
    let (mut from, mut to) = (gathered, sorted);
    for (pass, places) in places.iter_mut().enumerate() {
        // Turn counts into starts
        let mut start = 0;
        for place in places.iter_mut() {
            start += std::mem::replace(place, start);
        }
        for &key in &*from {
            let place = &mut places[digit(key, pass)];
            to[*place as usize] = key;
            *place += 1;
        }
        std::mem::swap(&mut from, &mut to);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_spread_by_two_zeros() {
        for digits in [0, 1, 0b101, 0x1fff, 0x1234] {
            let expected = (0..13).fold(0, |v, i| v | u64::from(digits >> i & 1) << (3 * i));
            assert_eq!(spread(digits), expected, "{digits:b}");
        }
    }

    #[test]
    fn keys_of_a_batch_are_those_of_each() {
        let bounds = Box4::around(&[[-1.0, 0.0, 2.0], [3.0, 1.0, 2.5]]);
        for index_bits in [25, 30] {
            let curve = KeyCurve::around(&bounds, index_bits);
            // Centres inside and outside of the cube, and such that are no numbers
            let centre = |i: usize| match i {
                3 => Vec3A::NAN,
                5 => Vec3A::new(f32::INFINITY, -1e30, 1e30),
                _ => Vec3A::new(0.17 * i as f32 - 3.0, 0.03 * i as f32, 4.0 + 0.02 * i as f32),
            };
            let rows = [0, 1, 2].map(|axis| std::array::from_fn(|i| centre(i)[axis]));
            let keys = key_batch(&curve, &rows, 1000);
            let each: [u64; BATCH] = std::array::from_fn(|i| curve.key(centre(i), 1000 + i));
            assert_eq!(keys, each);
        }
    }

    #[test]
    fn cells_are_whole_and_within_the_cube() {
        for coordinate in [0.0f32, 0.999, 1.0, 1.001, 2.5, 3.5, 4095.999, 8190.9995, 8191.0] {
            assert_eq!(cell(coordinate), coordinate as u32);
        }
        for (outside, expected) in [
            (-0.5, 0),
            (-1e30, 0),
            (8191.5, 8191),
            (f32::INFINITY, 8191),
            (f32::NAN, 0),
        ] {
            assert_eq!(cell(outside), expected, "{outside}");
        }
    }

    #[test]
    fn a_bucket_is_sorted_by_codes_and_then_by_indices() {
        for count in [1, SMALL_BUCKET + 1, 5000] {
            // A Weyl sequence of 26-bit codes, many of them equal, over indices of 25 bits
            let mut keys: Vec<u64> = (0..count as u64)
                .map(|i| (i.wrapping_mul(0x9e37_79b9) % 4096 * 16_381 % (1 << 26)) << 25 | i)
                .collect();
            let mut expected = keys.clone();
            expected.sort_unstable();
            let mut sorted = vec![0; count];
            sort_bucket(&mut keys, &mut sorted, 25);
            assert_eq!(sorted, expected);
        }
    }
}
