//! Chunks of the order of Morton codes.

use glam::Vec3A;

use super::keys::{KeyRange, SortedKeys};
use crate::parallel;

/// Number of which chunks are multiples that are cut in the middle, so that they make full blocks and clusters.
const FULL: usize = 16;

/// Range of positions in the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::accel) struct MortonChunk {
    pub(in crate::accel) first: usize,
    pub(in crate::accel) end: usize,
}

impl MortonChunk {
    /// Returns the number of primitives.
    pub(in crate::accel) fn len(&self) -> usize {
        self.end - self.first
    }
}

/// Number of primitives from which both sides of a cut are cut in parallel.
const PARALLEL: usize = 1 << 16;

/// Cuts the order at the highest digit in which codes differ until no chunk has more than `longest` primitives, which is
/// above [`FULL`]. Where the codes are equal the primitives are sorted again, in their own cube: one that is far away
/// from all others does not put these into one cell. Primitives with the same centre are cut in the middle.
pub(in crate::accel) fn cut(
    keys: &mut SortedKeys,
    longest: usize,
    twice_centre: impl Fn(usize) -> Vec3A + Sync,
) -> Vec<MortonChunk> {
    cut_range(keys.all(), longest, &twice_centre)
}

/// Cuts one range as [`cut`] does.
fn cut_range(
    keys: KeyRange,
    longest: usize,
    twice_centre: &(impl Fn(usize) -> Vec3A + Sync),
) -> Vec<MortonChunk> {
    let mut chunks = Vec::new();
    let mut waiting = vec![keys];
    while let Some(mut range) = waiting.pop() {
        // Keep a range that is short enough
        if range.len() <= longest {
            chunks.push(MortonChunk {
                first: range.first,
                end: range.first + range.len(),
            });
            continue;
        }
        // Find where the highest digit that differs becomes 1
        let is_cell = range.code(0) == range.code(range.len() - 1);
        let middle = if is_cell && !range.refine(twice_centre) {
            (range.len() / 2).next_multiple_of(FULL)
        } else {
            let last_code = range.code(range.len() - 1);
            let digit = (range.code(0) ^ last_code).ilog2();
            first_at_or_above(&range, last_code >> digit << digit)
        };
        // Cut both sides further, in parallel or the first one next
        let is_long = range.len() >= PARALLEL;
        let [front, back] = range.split_at(middle);
        if is_long {
            let (front, back) = parallel::join(
                || cut_range(front, longest, twice_centre),
                || cut_range(back, longest, twice_centre),
            );
            chunks.extend(front.into_iter().chain(back));
        } else {
            waiting.extend([back, front]);
        }
    }
    chunks
}

/// Returns the offset of the first code that is at least `code`.
fn first_at_or_above(keys: &KeyRange, code: u64) -> usize {
    let (mut low, mut high) = (0, keys.len());
    while low < high {
        let middle = low + (high - low) / 2;
        if keys.code(middle) < code {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::morton::{Box4, sorted};

    #[test]
    fn far_primitive_does_not_put_the_others_into_one_cell() {
        // A row of a thousand points, in an order of its own, and one at a distance of which a cell is longer than it.
        let centre = |i: usize| Vec3A::X * if i == 7 { 1e9 } else { (i * 389 % 1009) as f32 };
        let mut around = Box4::EMPTY;
        (0..1009).for_each(|i| around.add_point(centre(i)));
        let mut keys = sorted(1009, &around, |i| 2.0 * centre(i));
        let chunks = cut(&mut keys, 32, |i| 2.0 * centre(i));
        assert!(chunks.iter().all(|chunk| (1..=32).contains(&chunk.len())));
        let order: Vec<f32> = (0..1009)
            .map(|position| centre(keys.number(position)).x)
            .collect();
        assert!(order.is_sorted());
        assert_eq!((chunks[0].first, chunks[chunks.len() - 1].end), (0, 1009));
    }

    #[test]
    fn primitives_with_one_centre_are_cut_into_full_chunks() {
        let centre = |_: usize| Vec3A::ONE;
        let around = Box4::around(&[[1.0; 3]]);
        let mut keys = sorted(1000, &around, centre);
        let lengths: Vec<usize> = cut(&mut keys, 64, centre).iter().map(MortonChunk::len).collect();
        assert_eq!(lengths.iter().sum::<usize>(), 1000);
        assert!(
            lengths[..lengths.len() - 1]
                .iter()
                .all(|length| length % FULL == 0)
        );
    }
}
