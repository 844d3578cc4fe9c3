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
use crate::numeric::{LANES, Lanes, Lanes3};
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
    /// Returns the number of keys.
    pub(in crate::accel) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Returns the index of the primitive at a position in the order.
    #[inline(always)]
    pub(in crate::accel) fn number(&self, position: usize) -> usize {
        number_of(self.keys[position], self.index_bits)
    }

    /// Returns the Morton code at a position in the order.
    #[inline(always)]
    pub(super) fn code(&self, position: usize) -> u64 {
        self.keys[position] >> self.index_bits
    }

    /// Sorts a range of equal codes by new ones, in a cube around its own centres; returns whether any of these differ.
    pub(super) fn refine(&mut self, range: Range<usize>, twice_centre: impl Fn(usize) -> Vec3A) -> bool {
        // Bound the centres
        let keys = &mut self.keys[range];
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
        let cell = ((twice_centre - self.corner) * self.scale).to_array();
        let limit = (1 << BITS_PER_AXIS) - 1;
        let [x, y, z] = cell.map(|x| spread((x as u32).min(limit)));
        ((x | y << 1 | z << 2) >> self.dropped_bits) << self.index_bits | number as u64
    }
}

/// Returns the keys of sixteen primitives, `first` and those after it: those of [`KeyCurve::key`].
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512cd+avx512dq+avx512vl",
    "x86_64+avx2+bmi1+bmi2+fma"
))]
fn key_packet(curve: &KeyCurve, twice_centres: &Lanes3<f32>, first: usize) -> Lanes<u64> {
    let (mut keys, mut digits) = ([0; LANES], [0; LANES]);
    let (corner, scale) = (curve.corner.to_array(), curve.scale.to_array());
    for axis in 0..3 {
        // Find the cells along the axis, then interleave their digits
        cells_along(&twice_centres[axis], corner[axis], scale[axis], &mut digits);
        add_digits(&digits, axis as u32, &mut keys);
    }
    for lane in 0..LANES {
        keys[lane] = (keys[lane] >> curve.dropped_bits) << curve.index_bits | (first + lane) as u64;
    }
    keys
}

/// Finds the cells of sixteen centres along one axis, from 0 to the last one.
#[inline(always)]
fn cells_along(twice_centres: &Lanes<f32>, corner: f32, scale: f32, cells: &mut Lanes<i32>) {
    let last = (1 << BITS_PER_AXIS) - 1;
    for lane in 0..LANES {
        cells[lane] = (((twice_centres[lane] - corner) * scale) as i32).clamp(0, last);
    }
}

/// Adds the digits of sixteen cells along one axis to the codes.
#[inline(always)]
fn add_digits(cells: &Lanes<i32>, axis: u32, codes: &mut Lanes<u64>) {
    for lane in 0..LANES {
        codes[lane] |= spread(cells[lane] as u32) << axis;
    }
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
    // Compute the keys, sixteen at a time, and count them by bucket
    let mut unsorted = Vec::with_capacity(range.len());
    let mut ends = vec![0u32; BUCKETS];
    for first in range.clone().step_by(LANES) {
        // Gather sixteen centres; lanes behind the last one are left out
        let count = LANES.min(range.end - first);
        let mut centres = [[0.0; LANES]; 3];
        for lane in 0..count {
            let [x, y, z] = twice_centre(first + lane).to_array();
            (centres[0][lane], centres[1][lane], centres[2][lane]) = (x, y, z);
        }
        let keys = key_packet(curve, &centres, first);
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
    fn keys_of_sixteen_are_those_of_each() {
        let bounds = Box4::around(&[[-1.0, 0.0, 2.0], [3.0, 1.0, 2.5]]);
        for index_bits in [25, 30] {
            let curve = KeyCurve::around(&bounds, index_bits);
            // Centres inside and outside of the cube, and such that are no numbers
            let centre = |lane: usize| match lane {
                3 => Vec3A::NAN,
                5 => Vec3A::new(f32::INFINITY, -1e30, 1e30),
                _ => Vec3A::new(
                    0.7 * lane as f32 - 3.0,
                    0.1 * lane as f32,
                    4.0 + 0.07 * lane as f32,
                ),
            };
            let rows = [0, 1, 2].map(|axis| std::array::from_fn(|lane| centre(lane)[axis]));
            let keys = key_packet(&curve, &rows, 1000);
            let each: Lanes<u64> = std::array::from_fn(|lane| curve.key(centre(lane), 1000 + lane));
            assert_eq!(keys, each);
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
