//! Chunks of the order of Morton codes that are built in one piece.

use crate::mesh::triangle::PACK;

use super::keys::SortedKeys;

/// Maximum number of triangles of a chunk.
pub(super) const CHUNK: usize = 512;

/// Range of positions in the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MortonChunk {
    pub(super) first: usize,
    pub(super) end: usize,
}

impl MortonChunk {
    /// Returns the number of blocks of the chunk's triangles.
    pub(super) fn block_count(&self) -> usize {
        (self.end - self.first).div_ceil(PACK)
    }
}

/// Cuts the order at the highest digit in which codes differ until no chunk has more than `longest` triangles; triangles
/// with the same code are cut in the middle.
pub(super) fn cut(keys: &SortedKeys, longest: usize) -> Vec<MortonChunk> {
    let mut chunks = Vec::with_capacity(keys.len() / (longest / 4) + 1);
    let mut waiting = vec![MortonChunk {
        first: 0,
        end: keys.len(),
    }];
    while let Some(MortonChunk { first, end }) = waiting.pop() {
        // Keep a range that is short enough
        if end - first <= longest {
            chunks.push(MortonChunk { first, end });
            continue;
        }
        // Find where the highest digit that differs becomes 1
        let last_code = keys.code(end - 1);
        let differing = keys.code(first) ^ last_code;
        let middle = if differing == 0 {
            first + (end - first) / 2
        } else {
            let digit = differing.ilog2();
            first_at_or_above(keys, MortonChunk { first, end }, last_code >> digit << digit)
        };
        // Cut both sides further, the first one next
        waiting.push(MortonChunk { first: middle, end });
        waiting.push(MortonChunk { first, end: middle });
    }
    chunks
}

/// Returns the first position whose code is at least `code`.
fn first_at_or_above(keys: &SortedKeys, range: MortonChunk, code: u64) -> usize {
    let (mut low, mut high) = (range.first, range.end);
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
