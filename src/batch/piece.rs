//! What of a frame is made at a time: some of its rows, some of its samples.
//!
//! A frame is cut into bands of rows and its samples into shares as its job says, so that several machines can make one
//! frame; what a process has made of a band can be kept on the way. Whatever is made twice has the same bits, so pieces
//! may overlap: what counts is only which rows of which share there are.

use std::ops::Range;

use crate::render::{Share, TILE_SIDE};

/// Some rows of a frame.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Piece {
    /// Rows of the picture, of which there is at least one.
    pub rows: Range<u32>,
    /// What of their samples.
    pub part: Part,
}

/// What of the samples of some rows there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Part {
    /// All, so that the rows are finished.
    All,
    /// Those of a share, by its number from 0.
    Share(u32),
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
            part: match self.shares {
                1 => Part::All,
                _ => Part::Share(share),
            },
        }
    }

    /// The whole frame, finished.
    pub fn all(&self) -> Piece {
        Piece {
            rows: 0..self.height,
            part: Part::All,
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

/// What of a frame there is.
#[derive(Clone, Debug)]
pub struct Coverage {
    /// For each share, for each row, whether it is there.
    shares: Vec<Vec<bool>>,
}

impl Coverage {
    /// Nothing of a frame that is cut like this.
    pub fn none(cut: &Cut) -> Coverage {
        Coverage {
            shares: vec![vec![false; cut.height as usize]; cut.shares as usize],
        }
    }

    /// Takes note of a piece; what of it is no part of the frame is none.
    pub fn add(&mut self, piece: &Piece) {
        let shares = match piece.part {
            Part::All => &mut self.shares[..],
            Part::Share(share) => self
                .shares
                .get_mut(share as usize)
                .map_or(&mut [][..], std::slice::from_mut),
        };
        for rows in shares {
            let end = rows.len().min(piece.rows.end as usize);
            if let Some(rows) = rows.get_mut(piece.rows.start as usize..end) {
                rows.fill(true);
            }
        }
    }

    /// The rows of a piece that are missing, in order.
    pub fn missing(&self, piece: &Piece) -> Vec<Range<u32>> {
        let is_there = |row: u32| match piece.part {
            Part::All => self.shares.iter().all(|rows| rows[row as usize]),
            Part::Share(share) => self.shares[share as usize][row as usize],
        };
        let mut missing: Vec<Range<u32>> = Vec::new();
        for row in piece.rows.clone().filter(|&row| !is_there(row)) {
            match missing.last_mut() {
                Some(rows) if rows.end == row => rows.end = row + 1,
                _ => missing.push(row..row + 1),
            }
        }
        missing
    }

    /// Whether nothing of it is there.
    pub fn is_empty(&self) -> bool {
        !self.shares.iter().flatten().any(|&there| there)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(rows: Range<u32>, part: Part) -> Piece {
        Piece { rows, part }
    }

    #[test]
    fn pieces_cover_every_row_of_every_share_once() {
        for (height, bands, shares) in [(1, 1, 1), (100, 3, 2), (16384, 16, 1), (4320, 7, 5), (33, 2, 1)] {
            let cut = Cut {
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
    fn what_is_missing_is_found_between_pieces_that_overlap() {
        let cut = Cut {
            height: 300,
            bands: 1,
            shares: 2,
        };
        let mut coverage = Coverage::none(&cut);
        for rows in [64..96, 0..32, 16..40, 200..400, 500..600] {
            coverage.add(&piece(rows, Part::Share(1)));
        }
        coverage.add(&piece(0..300, Part::Share(7)));
        let missing = |rows, part| coverage.missing(&piece(rows, part));
        assert_eq!(missing(0..128, Part::Share(1)), [40..64, 96..128]);
        assert_eq!(missing(20..30, Part::Share(1)), []);
        assert_eq!(missing(50..51, Part::Share(1)), vec![50..51; 1]);
        assert_eq!(missing(0..128, Part::Share(0)), vec![0..128; 1]);
        assert_eq!(missing(0..300, Part::All), vec![0..300; 1]);
        coverage.add(&piece(10..20, Part::All));
        assert_eq!(coverage.missing(&cut.all()), [0..10, 20..300]);
    }
}
