//! Pieces of a frame: a range of rows and a share of their samples.
//!
//! A job splits a frame into bands of rows and its samples into shares, so that several machines can render one frame;
//! the rows of a band that are finished can be saved on the way. All results are reproducible to the bit, so pieces may
//! overlap: all that counts is which rows of which share are present.

use std::ops::Range;

use crate::render::{Share, TILE_SIDE};

/// Rows of a frame with all or some of their samples.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Chunk {
    /// Range of image rows, not empty.
    pub rows: Range<u32>,
    /// Subset of the samples of these rows.
    pub part: ChunkKind,
}

/// Subset of the samples of some rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ChunkKind {
    /// All samples: the rows are finished.
    All,
    /// Samples of one share, by its index from 0.
    Share(u32),
}

/// Division of a frame into bands of rows and shares of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ChunkLayout {
    /// Number of rows of the image.
    pub height: u32,
    /// Number of bands of rows; at most the number of tile rows of the image.
    pub bands: u32,
    /// Number of shares of the samples, each accumulated separately.
    pub shares: u32,
}

impl ChunkLayout {
    /// Returns the division of a frame into a single piece.
    pub(crate) fn whole(height: u32) -> ChunkLayout {
        ChunkLayout {
            height,
            bands: 1,
            shares: 1,
        }
    }

    /// Returns the number of pieces.
    pub(crate) fn piece_count(&self) -> usize {
        self.bands as usize * self.shares as usize
    }

    /// Returns a piece by its index: the bands in order, and the shares of each band one after the other.
    pub(crate) fn piece(&self, number: usize) -> Chunk {
        let (band, share) = (number as u32 / self.shares, number as u32 % self.shares);
        Chunk {
            rows: self.band(band),
            part: match self.shares {
                1 => ChunkKind::All,
                _ => ChunkKind::Share(share),
            },
        }
    }

    /// Returns the piece that is the whole finished frame.
    pub(crate) fn all(&self) -> Chunk {
        Chunk {
            rows: 0..self.height,
            part: ChunkKind::All,
        }
    }

    /// Returns the rows of a band: whole rows of tiles, except at the lower edge of the image.
    fn band(&self, band: u32) -> Range<u32> {
        let tiles = u64::from(self.height.div_ceil(TILE_SIDE));
        let start = |band: u32| {
            // Divide in units of tiles, so that no tile belongs to two bands
            let row = tiles * u64::from(band) / u64::from(self.bands) * u64::from(TILE_SIDE);
            (row as u32).min(self.height)
        };
        start(band)..start(band + 1)
    }

    /// Returns a share by its index from 0.
    pub(crate) fn share(&self, index: u32) -> Share {
        Share {
            index,
            count: self.shares,
        }
    }

    /// Returns the largest number of bands of an image with `height` rows: its number of tile rows.
    pub(crate) fn max_bands(height: u32) -> u32 {
        height.div_ceil(TILE_SIDE)
    }
}

/// Set of the rows of each share that are present.
///
/// It takes memory by the number of pieces, not of rows, as the height of a frame may come from a damaged file.
#[derive(Clone, Debug)]
pub(crate) struct Coverage {
    /// Ranges of rows that are present, for each share, in no particular order.
    shares: Vec<Vec<Range<u32>>>,
}

impl Coverage {
    /// Returns the empty coverage of a frame with this division.
    pub(crate) fn none(cut: &ChunkLayout) -> Coverage {
        Coverage {
            shares: vec![Vec::new(); cut.shares as usize],
        }
    }

    /// Adds a piece; rows and shares outside the frame are ignored.
    pub(crate) fn add(&mut self, piece: &Chunk) {
        // A finished piece counts for all shares
        let shares = match piece.part {
            ChunkKind::All => &mut self.shares[..],
            ChunkKind::Share(share) => self
                .shares
                .get_mut(share as usize)
                .map_or(&mut [][..], std::slice::from_mut),
        };
        for present in shares {
            present.push(piece.rows.clone());
        }
    }

    /// Returns the missing rows of a piece as maximal ranges, in order.
    pub(crate) fn missing(&self, piece: &Chunk) -> Vec<Range<u32>> {
        // A row of several shares is missing if it is in any of them
        let shares = match piece.part {
            ChunkKind::All => &self.shares[..],
            ChunkKind::Share(share) => std::slice::from_ref(&self.shares[share as usize]),
        };
        let mut gaps: Vec<Range<u32>> = shares
            .iter()
            .flat_map(|present| gaps(&piece.rows, present))
            .collect();
        gaps.sort_by_key(|rows| rows.start);
        // Join ranges that overlap or touch
        let mut missing: Vec<Range<u32>> = Vec::new();
        for rows in gaps {
            match missing.last_mut() {
                Some(last) if rows.start <= last.end => last.end = last.end.max(rows.end),
                _ => missing.push(rows),
            }
        }
        missing
    }

    /// Returns whether no row of any share is present.
    pub(crate) fn is_empty(&self) -> bool {
        self.shares.iter().all(Vec::is_empty)
    }
}

/// Returns the rows that are in none of the ranges `present`, as ranges in order.
fn gaps(rows: &Range<u32>, present: &[Range<u32>]) -> Vec<Range<u32>> {
    let mut present = present.to_vec();
    present.sort_by_key(|range| range.start);
    // Keep what lies between the end of all ranges so far and the next one
    let mut gaps = Vec::new();
    let mut start = rows.start;
    for range in present {
        gaps.push(start..range.start.min(rows.end));
        start = start.max(range.end);
    }
    gaps.push(start..rows.end);
    gaps.retain(|gap| !gap.is_empty());
    gaps
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(rows: Range<u32>, part: ChunkKind) -> Chunk {
        Chunk { rows, part }
    }

    #[test]
    fn pieces_cover_every_row_of_every_share_once() {
        for (height, bands, shares) in [(1, 1, 1), (100, 3, 2), (16384, 16, 1), (4320, 7, 5), (33, 2, 1)] {
            let cut = ChunkLayout {
                height,
                bands,
                shares,
            };
            let mut coverage = Coverage::none(&cut);
            assert!(coverage.is_empty());
            for number in 0..cut.piece_count() {
                let piece = cut.piece(number);
                assert!(piece.rows.start.is_multiple_of(TILE_SIDE) && !piece.rows.is_empty());
                assert_eq!(coverage.missing(&piece), std::slice::from_ref(&piece.rows));
                coverage.add(&piece);
                assert_eq!(coverage.missing(&piece), []);
            }
            assert_eq!(coverage.missing(&cut.all()), []);
        }
    }

    #[test]
    fn missing_rows_are_found_between_overlapping_pieces() {
        let cut = ChunkLayout {
            height: 300,
            bands: 1,
            shares: 2,
        };
        let mut coverage = Coverage::none(&cut);
        // Share 1 has overlapping pieces and pieces beyond the frame
        for rows in [64..96, 0..32, 16..40, 200..400, 500..600] {
            coverage.add(&piece(rows, ChunkKind::Share(1)));
        }
        coverage.add(&piece(0..300, ChunkKind::Share(7)));
        let missing = |rows, part| coverage.missing(&piece(rows, part));
        assert_eq!(missing(0..128, ChunkKind::Share(1)), [40..64, 96..128]);
        assert_eq!(missing(20..30, ChunkKind::Share(1)), []);
        assert_eq!(missing(50..51, ChunkKind::Share(1)), vec![50..51; 1]);
        assert_eq!(missing(0..128, ChunkKind::Share(0)), vec![0..128; 1]);
        assert_eq!(missing(0..300, ChunkKind::All), vec![0..300; 1]);
        coverage.add(&piece(10..20, ChunkKind::All));
        assert_eq!(coverage.missing(&cut.all()), [0..10, 20..300]);
    }

    #[test]
    fn coverage_of_an_enormous_frame_takes_little_memory() {
        let cut = ChunkLayout {
            height: 1 << 31,
            bands: 1,
            shares: 1 << 16,
        };
        let mut coverage = Coverage::none(&cut);
        coverage.add(&piece(0..7, ChunkKind::All));
        assert_eq!(coverage.missing(&cut.all()), vec![7..1 << 31; 1]);
    }
}
