//! Merging of a frame's pieces, row by row: only the current rows of each piece are in memory.
//!
//! If several pieces have a row, any of them may be used, as all have the same bits. Sums of shares are added in the
//! order of the shares.

use std::collections::HashMap;
use std::io;
use std::ops::Range;
use std::path::PathBuf;

use super::chunk::{Chunk, ChunkKind, Coverage};
use super::chunk_directory::ChunkDirectory;
use super::chunk_format::{ChunkReader, ChunkRows};
use crate::batch::request::sample_layers;
use crate::image::{ChannelKind, ImageError};
use crate::render::{Layer, PartSums};

/// Number of rows that are read at a time: the largest block of rows that EXR compresses together.
const ROWS_PER_STEP: u32 = 32;

/// Reasons why pieces cannot be merged to a frame.
#[derive(Debug, thiserror::Error)]
pub enum MergeError {
    /// Some rows are not finished yet.
    #[error("{missing} of {height} rows are missing")]
    Missing {
        /// Number of rows that are not finished.
        missing: u32,
        /// Number of rows of the frame.
        height: u32,
    },
    /// The folder of the pieces cannot be read.
    #[error("cannot read its pieces: {0}")]
    Folder(#[from] io::Error),
    /// A piece is unreadable or invalid.
    #[error(transparent)]
    Chunk(#[from] ImageError),
}

/// Reader of a frame's rows from its pieces, from top to bottom.
#[derive(Debug)]
pub(crate) struct Merge<'f> {
    folder: &'f ChunkDirectory,
    pieces: Vec<(Chunk, PathBuf)>,
    /// Readers of the pieces in use, by the piece's index.
    open: HashMap<usize, ChunkReader>,
    /// Row that is read next.
    next: u32,
}

impl<'f> Merge<'f> {
    /// Starts merging a frame all of whose pieces are present.
    pub(crate) fn of(folder: &'f ChunkDirectory) -> Result<Merge<'f>, MergeError> {
        let pieces = folder.pieces()?;
        let cut = folder.cut();
        let mut coverage = Coverage::none(cut);
        pieces.iter().for_each(|(piece, _)| coverage.add(piece));
        let missing = coverage.missing(&cut.all()).iter().map(Range::len).sum::<usize>() as u32;
        if missing > 0 {
            let height = cut.height;
            return Err(MergeError::Missing { missing, height });
        }
        Ok(Merge {
            folder,
            pieces,
            open: HashMap::new(),
            next: 0,
        })
    }

    /// Returns the channels of the next rows, or `None` after the last row.
    pub(crate) fn next_rows(&mut self) -> Result<Option<Vec<Layer>>, MergeError> {
        let height = self.folder.cut().height;
        if self.next == height {
            return Ok(None);
        }
        let rows = self.next..self.end_of_step(height);
        // Close pieces that end above the next rows
        self.open.retain(|_, reader| reader.piece().rows.end > rows.start);
        // Prefer a piece with finished rows; otherwise add up the shares
        let planes = match self.holder(&rows, ChunkKind::All) {
            Some(index) => match self.read(index, &rows)? {
                ChunkRows::Finished(planes) => planes,
                // The variant follows from the name of the piece's file.
                ChunkRows::PartSums(sums) => planes_of(&sums),
            },
            None => planes_of(&self.sums(&rows)?),
        };
        self.next = rows.end;
        Ok(Some(planes))
    }

    /// Returns the end of the next run of rows, which crosses no edge of any piece.
    fn end_of_step(&self, height: u32) -> u32 {
        let edges = self
            .pieces
            .iter()
            .flat_map(|(piece, _)| [piece.rows.start, piece.rows.end]);
        let end = (self.next + ROWS_PER_STEP).min(height);
        edges.filter(|&edge| edge > self.next).fold(end, u32::min)
    }

    /// Returns the index of a piece that contains all these rows.
    fn holder(&self, rows: &Range<u32>, part: ChunkKind) -> Option<usize> {
        let has = |(piece, _): &(Chunk, PathBuf)| {
            piece.part == part && piece.rows.start <= rows.start && piece.rows.end >= rows.end
        };
        self.pieces.iter().position(has)
    }

    fn read(&mut self, index: usize, rows: &Range<u32>) -> Result<ChunkRows, MergeError> {
        if !self.open.contains_key(&index) {
            let (piece, path) = &self.pieces[index];
            self.open.insert(index, self.folder.open(piece, path)?);
        }
        let reader = self
            .open
            .get_mut(&index)
            .ok_or_else(|| io::Error::other("a piece was removed meanwhile"))?;
        Ok(reader.read(rows)?)
    }

    /// Returns the sums of all samples of these rows, over all shares.
    fn sums(&mut self, rows: &Range<u32>) -> Result<PartSums, MergeError> {
        let mut all: Option<PartSums> = None;
        for share in 0..self.folder.cut().shares {
            let holder = self.holder(rows, ChunkKind::Share(share));
            let index = holder.ok_or_else(|| io::Error::other("a piece was removed meanwhile"))?;
            match self.read(index, rows)? {
                ChunkRows::PartSums(sums) => add_sums(&mut all, sums),
                ChunkRows::Finished(_) => {
                    return Err(io::Error::other("a piece of a share has no sums").into());
                }
            }
        }
        all.ok_or_else(|| io::Error::other("the frame has no shares").into())
    }
}

/// Adds `sums` to those of the packets or shares before them.
pub(in crate::batch) fn add_sums(all: &mut Option<PartSums>, sums: PartSums) {
    match all {
        None => *all = Some(sums),
        Some(all) => all.add(&sums),
    }
}

/// Returns the image channels that result from sums of samples.
pub(crate) fn planes_of(sums: &PartSums) -> Vec<Layer> {
    let mut planes = color_planes(&sums.pixels());
    planes.extend(sums.aovs().into_iter().flat_map(sample_layers));
    planes
}

/// Returns the channels R, G and B of pixels.
pub(crate) fn color_planes(pixels: &[[f32; 3]]) -> Vec<Layer> {
    let plane = |(channel, name): (usize, &str)| Layer {
        name: name.to_owned(),
        kind: ChannelKind::Color,
        values: pixels.iter().map(|pixel| pixel[channel]).collect(),
    };
    ["R", "G", "B"].into_iter().enumerate().map(plane).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chunk_directory::FrameMetadata;
    use super::*;
    use crate::batch::fingerprint::FingerprintHasher;
    use crate::batch::request::Notes;
    use crate::image::{ExrEncoding, PngEncoding};

    fn sums(samples: u32, value: f64, rows: u32) -> PartSums {
        PartSums {
            samples,
            radiance: vec![[value, 2.0 * value, 0.0]; rows as usize],
            weighted: None,
            squares: None,
        }
    }

    fn red(merge: &mut Merge) -> Vec<f32> {
        let mut all = Vec::new();
        while let Some(planes) = merge.next_rows().unwrap() {
            let red = planes.iter().find(|plane| plane.name == "R").unwrap();
            all.extend(&red.values);
        }
        all
    }

    #[test]
    fn shares_are_added_and_finished_rows_are_copied() {
        let out = tempfile::tempdir().unwrap();
        let head = FrameMetadata {
            key: FingerprintHasher::default().key(),
            number: 0,
            image: "a.exr".into(),
            size: [1, 100],
            spp: 32,
            shares: 2,
            exr: ExrEncoding::default(),
            png: PngEncoding::default(),
            notes: Notes::default(),
        };
        let folder = ChunkDirectory::new(out.path(), head);
        // The first share has all rows, the second none: no row is finished
        folder.make().unwrap();
        folder.write_sums(&(0..100), 0, &sums(16, 16.0, 100)).unwrap();
        assert!(matches!(
            Merge::of(&folder),
            Err(MergeError::Missing {
                missing: 100,
                height: 100
            })
        ));
        // Add overlapping pieces of the second share, and finished rows that overlap them
        folder.write_sums(&(0..40), 1, &sums(16, 48.0, 40)).unwrap();
        folder.write_sums(&(30..60), 1, &sums(16, 48.0, 30)).unwrap();
        let finished = color_planes(&[[7.0; 3]; 45]);
        folder.write_finished(&(55..100), &finished).unwrap();
        let mut merge = Merge::of(&folder).unwrap();
        // The mean is (16 + 48) / 32 = 2.
        let expected: Vec<f32> = (0..100).map(|row| if row < 55 { 2.0 } else { 7.0 }).collect();
        assert_eq!(red(&mut merge), expected);
    }
}
