//! What of a frame is made at a time: some of its rows, some of its samples.
//!
//! A frame is cut into bands of rows and its samples into shares as its job says, so that several machines can make one
//! frame; what a process has made of a band can be kept on the way. Whatever is made twice has the same bits, so pieces
//! may overlap: what counts is only which rows of which share there are.

use std::ops::Range;

use crate::render::{Share, TILE_SIDE};

/// Some rows of a share of a frame's samples.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Piece {
    /// Rows of the picture, of which there is at least one.
    pub rows: Range<u32>,
    /// Which share, from 0.
    pub share: u32,
}

/// How a frame is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Cut {
    /// Rows of the picture.
    pub height: u32,
    /// Bands of rows, one above the other; no more than the picture has rows of tiles.
    pub bands: u32,
    /// Shares of the samples, each summed up by itself.
    pub shares: u32,
}

impl Cut {
    /// The whole frame at once.
    pub fn whole(height: u32) -> Cut {
        Cut {
            height,
            bands: 1,
            shares: 1,
        }
    }

    /// How many pieces there are.
    pub fn piece_count(&self) -> usize {
        self.bands as usize * self.shares as usize
    }

    /// A piece by its number: band by band, the shares of each one after the other.
    pub fn piece(&self, number: usize) -> Piece {
        let (band, share) = (number as u32 / self.shares, number as u32 % self.shares);
        Piece {
            rows: self.band(band),
            share,
        }
    }

    /// The rows of a band: whole rows of tiles, but for what is left at the end.
    fn band(&self, band: u32) -> Range<u32> {
        let tiles = u64::from(self.height.div_ceil(TILE_SIDE));
        let start = |band: u32| {
            let row = tiles * u64::from(band) / u64::from(self.bands) * u64::from(TILE_SIDE);
            (row as u32).min(self.height)
        };
        start(band)..start(band + 1)
    }

    /// A share by its number.
    pub fn share(&self, index: u32) -> Share {
        Share {
            index,
            count: self.shares,
        }
    }

    /// The most bands that a picture of so many rows has.
    pub fn most_bands(height: u32) -> u32 {
        height.div_ceil(TILE_SIDE)
    }
}

/// Which rows of which share are there.
#[derive(Clone, Debug, Default)]
pub struct Coverage {
    /// Ranges of rows by share, in any order; they may overlap.
    rows: Vec<Vec<Range<u32>>>,
}

impl Coverage {
    /// Takes note of a piece.
    pub fn add(&mut self, piece: &Piece) {
        let share = piece.share as usize;
        if self.rows.len() <= share {
            self.rows.resize(share + 1, Vec::new());
        }
        self.rows[share].push(piece.rows.clone());
    }

    /// What of a piece is missing, in order.
    pub fn missing(&self, piece: &Piece) -> Vec<Range<u32>> {
        let mut covered = self.rows.get(piece.share as usize).cloned().unwrap_or_default();
        covered.sort_by_key(|rows| rows.start);
        let (mut missing, mut next) = (Vec::new(), piece.rows.start);
        for rows in covered.into_iter().filter(|rows| rows.start < piece.rows.end) {
            if rows.start > next {
                missing.push(next..rows.start);
            }
            next = next.max(rows.end);
        }
        if next < piece.rows.end {
            missing.push(next..piece.rows.end);
        }
        missing
    }

    /// Whether all of a frame is there.
    pub fn is_complete(&self, cut: &Cut) -> bool {
        let all = |share| Piece {
            rows: 0..cut.height,
            share,
        };
        (0..cut.shares).all(|share| self.missing(&all(share)).is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(rows: Range<u32>, share: u32) -> Piece {
        Piece { rows, share }
    }

    #[test]
    fn pieces_cover_every_row_of_every_share_once() {
        for (height, bands, shares) in [(1, 1, 1), (100, 3, 2), (16384, 16, 1), (4320, 7, 5), (33, 2, 1)] {
            let cut = Cut {
                height,
                bands,
                shares,
            };
            let mut seen = vec![0; (height * shares) as usize];
            for number in 0..cut.piece_count() {
                let Piece { rows, share } = cut.piece(number);
                assert!(rows.start < rows.end && rows.start % TILE_SIDE == 0, "{rows:?}");
                rows.for_each(|row| seen[(share * height + row) as usize] += 1);
            }
            assert!(seen.iter().all(|&times| times == 1));
        }
    }

    #[test]
    fn what_is_missing_is_found_between_pieces_that_overlap() {
        let mut coverage = Coverage::default();
        for rows in [64..96, 0..32, 16..40, 200..300] {
            coverage.add(&piece(rows, 1));
        }
        assert_eq!(coverage.missing(&piece(0..128, 1)), [40..64, 96..128]);
        assert_eq!(coverage.missing(&piece(20..30, 1)), []);
        assert_eq!(coverage.missing(&piece(50..51, 1)), [50..51]);
        assert_eq!(coverage.missing(&piece(0..128, 0)), [0..128]);
        assert_eq!(coverage.missing(&piece(0..128, 7)), [0..128]);
    }

    #[test]
    fn a_frame_is_complete_when_all_rows_of_all_shares_are_there() {
        let cut = Cut {
            height: 50,
            bands: 2,
            shares: 2,
        };
        let mut coverage = Coverage::default();
        for number in 0..cut.piece_count() {
            assert!(!coverage.is_complete(&cut));
            coverage.add(&cut.piece(number));
        }
        assert!(coverage.is_complete(&cut));
    }
}
