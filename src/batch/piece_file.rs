//! Pieces of a frame on the disk: an EXR file each, in a folder that goes when the frame is whole.
//!
//! Finished rows are the channels of the picture, as they will be. A share's rows are the sums of its samples: f64,
//! which EXR has no channels for, as two of integers each, so that no bit is lost. The data window tells which rows.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::key::Key;
use super::piece::{Coverage, Cut, Part, Piece};
use crate::image::rows::{
    Compression, ExrChannel, ExrLayout, ExrScanlineReader, ExrScanlineWriter, SampleType, Samples, Window,
    join_f64, split_f64,
};
use crate::image::{Attribute, ChannelKind, ExrEncoding, ImageError, PngEncoding};
use crate::render::Sums;

/// The folder of all pieces, within a batch's.
const FOLDER: &str = ".whit-pieces";

/// The note that tells a piece's frame.
const FRAME: &str = "whit.frame";
/// The note that tells how many samples a pixel of a share has.
const SAMPLES: &str = "whit.samples";

/// The note that tells which channels of finished rows are colours.
const COLORS: &str = "whit.colors";

/// What names of channels of sums begin with.
const RADIANCE: &str = "radiance";
const WEIGHTED: &str = "weighted";
const SQUARES: &str = "squares";

/// One channel of some rows of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane {
    /// What the file calls it.
    pub name: String,
    /// Whether a file of halves may round it.
    pub kind: ChannelKind,
    /// A value a pixel, the top row first.
    pub values: Vec<f32>,
}

/// What every piece knows of its frame, so that whoever has the pieces can put it together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameHead {
    /// What it is made of.
    pub key: Key,
    /// Its number in its batch.
    pub number: usize,
    /// Its file, within the batch's folder.
    pub image: PathBuf,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Samples a pixel.
    pub spp: u32,
    /// Shares of its samples.
    pub shares: u32,
    /// How an EXR file holds it.
    pub exr: ExrEncoding,
    /// How a PNG holds it.
    pub png: PngEncoding,
    /// What its file is to say beside the pixels, under which names.
    pub notes: Vec<(String, String)>,
}

/// The pieces of one frame.
#[derive(Clone, Debug)]
pub struct PieceFolder {
    folder: PathBuf,
    head: FrameHead,
    cut: Cut,
}

/// Rows that were read.
#[derive(Debug)]
pub enum PieceRows {
    /// Finished ones.
    Finished(Vec<Plane>),
    /// Of a share.
    Sums(Sums),
}

impl PieceFolder {
    /// Where the pieces of a frame are within a batch's folder `out`.
    pub fn new(out: &Path, head: FrameHead) -> PieceFolder {
        PieceFolder {
            folder: folder_of(out, head.key),
            cut: Cut {
                shares: head.shares,
                ..Cut::whole(head.size[1])
            },
            head,
        }
    }

    /// The folders of all frames of which there are pieces in a batch's folder `out`. Pieces that cannot be read are left
    /// out.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn all(out: &Path) -> io::Result<Vec<PieceFolder>> {
        let mut folders = Vec::new();
        for folder in entries(&out.join(FOLDER))? {
            let head = entries(&folder)?.iter().find_map(|path| {
                let reader = ExrScanlineReader::open(path).ok()?;
                serde_json::from_str::<FrameHead>(&reader.note(FRAME)?).ok()
            });
            folders.extend(head.map(|head| PieceFolder::new(out, head)));
        }
        folders.sort_by_key(|folder| folder.head.number);
        Ok(folders)
    }

    /// Makes the folder.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn make(&self) -> io::Result<()> {
        fs::create_dir_all(&self.folder)
    }

    /// How the frame is cut, bands aside.
    pub fn cut(&self) -> &Cut {
        &self.cut
    }

    /// The frame.
    pub fn head(&self) -> &FrameHead {
        &self.head
    }

    /// The pieces that there are, with their files.
    ///
    /// # Errors
    ///
    /// What the system says; a folder that is not there holds none.
    pub fn pieces(&self) -> io::Result<Vec<(Piece, PathBuf)>> {
        let mut pieces = Vec::new();
        for path in entries(&self.folder)? {
            let name = path.file_name().and_then(|name| name.to_str());
            if let Some(piece) = name.and_then(|name| self.piece_of(name)) {
                pieces.push((piece, path));
            }
        }
        // Those that finish most come first.
        pieces.sort_by_key(|(piece, _)| (piece.part != Part::All, piece.rows.start, piece.rows.end));
        Ok(pieces)
    }

    /// What of the frame there is.
    ///
    /// # Errors
    ///
    /// What the system says.
    pub fn coverage(&self) -> io::Result<Coverage> {
        let mut coverage = Coverage::none(&self.cut);
        for (piece, _) in self.pieces()? {
            coverage.add(&piece);
        }
        Ok(coverage)
    }

    /// Writes finished rows.
    ///
    /// # Errors
    ///
    /// Where the disk takes no more.
    pub fn write_finished(&self, rows: &Range<u32>, planes: &[Plane]) -> Result<(), ImageError> {
        let colors = planes.iter().filter(|plane| plane.kind == ChannelKind::Color);
        let colors: Vec<&str> = colors.map(|plane| plane.name.as_str()).collect();
        let colors = colors.join(" ");
        let note = Attribute {
            name: COLORS,
            text: &colors,
        };
        let channels = planes
            .iter()
            .map(|plane| ExrChannel::new(&plane.name, SampleType::Float));
        let values: Vec<Samples> = planes.iter().map(|plane| plane.values[..].into()).collect();
        let piece = Piece {
            rows: rows.clone(),
            part: Part::All,
        };
        self.write(&piece, channels.collect(), &values, note)
    }

    /// Writes the sums of a share's rows.
    ///
    /// # Errors
    ///
    /// Where the disk takes no more.
    pub fn write_sums(&self, rows: &Range<u32>, share: u32, sums: &Sums) -> Result<(), ImageError> {
        let planes = planes_of(sums);
        let channels = planes.iter().flat_map(|(name, _)| {
            ["high", "low"].map(|half| ExrChannel::new(format!("{name}.{half}"), SampleType::Uint))
        });
        let values = planes
            .iter()
            .flat_map(|(_, values)| split_f64(values))
            .map(Samples::from);
        let (channels, values): (Vec<ExrChannel>, Vec<Samples>) = (channels.collect(), values.collect());
        let samples = sums.samples.to_string();
        let note = Attribute {
            name: SAMPLES,
            text: &samples,
        };
        let piece = Piece {
            rows: rows.clone(),
            part: Part::Share(share),
        };
        self.write(&piece, channels, &values, note)
    }

    fn write(
        &self,
        piece: &Piece,
        channels: Vec<ExrChannel>,
        values: &[Samples],
        note: Attribute,
    ) -> Result<(), ImageError> {
        let mut writer = self.create(&self.name(piece), self.window(&piece.rows), channels, note)?;
        writer.write_rows(values)?;
        writer.finish()
    }

    /// Begins a file of the frame.
    pub(super) fn create(
        &self,
        name: &str,
        window: Window,
        channels: Vec<ExrChannel>,
        note: Attribute,
    ) -> Result<ExrScanlineWriter, ImageError> {
        let text = serde_json::to_string(&self.head).unwrap_or_default();
        let head = Attribute {
            name: FRAME,
            text: &text,
        };
        let layout = ExrLayout {
            data_window: window,
            display_window: Window::of_size(self.head.size),
            channels,
            compression: Compression::None,
            notes: &[head, note],
        };
        ExrScanlineWriter::create(&self.path(name), &layout)
    }

    /// Where a file of the frame is.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn window(&self, rows: &Range<u32>) -> Window {
        Window {
            origin: [0, rows.start as i32],
            size: [self.head.size[0], rows.end - rows.start],
        }
    }

    fn name(&self, piece: &Piece) -> String {
        let Range { start, end } = piece.rows;
        match piece.part {
            Part::All => format!("{start}-{end}.all.exr"),
            Part::Share(share) => format!("{start}-{end}.{share}-of-{}.exr", self.cut.shares),
        }
    }

    /// The piece that a file of this name holds, if it is one.
    fn piece_of(&self, name: &str) -> Option<Piece> {
        let (rows, part) = name.strip_suffix(".exr")?.split_once('.')?;
        let (start, end) = rows.split_once('-')?;
        let rows: Range<u32> = start.parse().ok()?..end.parse().ok()?;
        let part = match part {
            "all" => Part::All,
            share => {
                let (share, count) = share.split_once("-of-")?;
                let is_ours = count.parse() == Ok(self.cut.shares);
                Part::Share(
                    share
                        .parse()
                        .ok()
                        .filter(|&share| is_ours && share < self.cut.shares)?,
                )
            }
        };
        let piece = Piece { rows, part };
        // Another spelling of the numbers is not ours.
        (piece.rows.start < piece.rows.end && piece.rows.end <= self.cut.height && self.name(&piece) == name)
            .then_some(piece)
    }

    /// Removes all pieces, and what else is left of the frame.
    pub fn remove(&self) {
        remove(&self.folder);
    }

    /// Removes what is left in a batch's folder `out` of the pieces of a frame, if anything is.
    pub fn remove_of(out: &Path, key: Key) {
        remove(&folder_of(out, key));
    }

    /// Where they are.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Opens a piece, to read rows of it.
    ///
    /// # Errors
    ///
    /// Where it cannot be read, or is of another frame.
    pub fn open(&self, piece: &Piece, path: &Path) -> Result<PieceReader, ImageError> {
        let reader = self.open_file(path, self.window(&piece.rows))?;
        Ok(PieceReader {
            piece: piece.clone(),
            path: path.to_owned(),
            reader,
        })
    }

    /// Opens a file of the frame that has these pixels.
    pub(super) fn open_file(&self, path: &Path, window: Window) -> Result<ExrScanlineReader, ImageError> {
        let reader = ExrScanlineReader::open(path)?;
        let head = reader
            .note(FRAME)
            .and_then(|text| serde_json::from_str::<FrameHead>(&text).ok());
        if head.is_none_or(|head| head.key != self.head.key) || reader.data_window() != window {
            return Err(ImageError::Unusable {
                path: path.to_owned(),
                fault: "this piece is of another frame".into(),
                remedy: "remove it",
            });
        }
        Ok(reader)
    }
}

/// A piece that is being read.
#[derive(Debug)]
pub struct PieceReader {
    piece: Piece,
    path: PathBuf,
    reader: ExrScanlineReader,
}

impl PieceReader {
    /// What it holds.
    pub fn piece(&self) -> &Piece {
        &self.piece
    }

    /// Some of its rows, by their numbers in the picture.
    ///
    /// # Errors
    ///
    /// Where they cannot be read.
    pub fn read(&mut self, rows: &Range<u32>) -> Result<PieceRows, ImageError> {
        let first = self.piece.rows.start;
        let values = self.reader.read_rows(rows.start - first..rows.end - first)?;
        let names = self.reader.channels().iter().map(|channel| channel.name.clone());
        if self.piece.part == Part::All {
            let colors = self.reader.note(COLORS).unwrap_or_default();
            let kind = |name: &str| match colors.split(' ').any(|color| color == name) {
                true => ChannelKind::Color,
                false => ChannelKind::Exact,
            };
            let plane = |(name, values): (String, Samples)| match values {
                Samples::Floats(values) => Some(Plane {
                    kind: kind(&name),
                    name,
                    values: values.into_owned(),
                }),
                Samples::Integers(_) => None,
            };
            let planes: Option<Vec<Plane>> = names.zip(values).map(plane).collect();
            return planes.map(PieceRows::Finished).ok_or_else(|| self.damaged());
        }
        let planes: Vec<(String, Samples)> = names.zip(values).collect();
        let samples = self.reader.note(SAMPLES).and_then(|text| text.parse().ok());
        samples
            .and_then(|samples| sums_of(samples, &planes))
            .map(PieceRows::Sums)
            .ok_or_else(|| self.damaged())
    }

    fn damaged(&self) -> ImageError {
        damaged(&self.path)
    }
}

/// That a file of a frame is not what it should be.
pub(super) fn damaged(path: &Path) -> ImageError {
    ImageError::Unusable {
        path: path.to_owned(),
        fault: "this piece lacks something of its frame".into(),
        remedy: "remove it",
    }
}

/// Where the pieces of a frame are within a batch's folder.
fn folder_of(out: &Path, key: Key) -> PathBuf {
    out.join(FOLDER).join(key.short())
}

/// Removes a frame's folder, and that of all frames where it was the last.
fn remove(folder: &Path) {
    // What cannot be removed is only in the way.
    let _ = fs::remove_dir_all(folder);
    if let Some(all) = folder.parent() {
        // Only when it is empty.
        let _ = fs::remove_dir(all);
    }
}

/// What is in a folder; nothing if that is not there.
fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.map(|entry| Ok(entry?.path())).collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

/// Sums by channels.
fn planes_of(sums: &Sums) -> Vec<(String, Vec<f64>)> {
    fn planes<const N: usize>(name: &str, sums: &[[f64; N]]) -> Vec<(String, Vec<f64>)> {
        let plane = |channel: usize| sums.iter().map(|sum| sum[channel]).collect();
        (0..N)
            .map(|channel| (format!("{name}.{channel}"), plane(channel)))
            .collect()
    }
    let mut all = planes(RADIANCE, &sums.radiance);
    if let Some(weighted) = &sums.weighted {
        all.extend(planes(WEIGHTED, weighted));
    }
    if let Some(squares) = &sums.squares {
        all.push((SQUARES.into(), squares.clone()));
    }
    all
}

/// The sums that these channels hold; nothing where one is missing.
fn sums_of(samples: u32, planes: &[(String, Samples)]) -> Option<Sums> {
    let half = |name: String| match planes.iter().find(|(plane, _)| *plane == name)? {
        (_, Samples::Integers(values)) => Some(values),
        (_, Samples::Floats(_)) => None,
    };
    let plane = |name: &str| {
        Some(join_f64(
            half(format!("{name}.high"))?,
            half(format!("{name}.low"))?,
        ))
    };
    fn zipped<const N: usize>(planes: [Option<Vec<f64>>; N]) -> Option<Vec<[f64; N]>> {
        let planes: Vec<Vec<f64>> = planes.into_iter().collect::<Option<_>>()?;
        let sums = (0..planes[0].len()).map(|pixel| std::array::from_fn(|channel| planes[channel][pixel]));
        Some(sums.collect())
    }
    Some(Sums {
        samples,
        radiance: zipped([0, 1, 2].map(|channel| plane(&format!("{RADIANCE}.{channel}"))))?,
        weighted: zipped([0, 1, 2, 3].map(|channel| plane(&format!("{WEIGHTED}.{channel}")))),
        squares: plane(SQUARES),
    })
}

/// That of a small frame, made.
#[cfg(test)]
pub(super) fn folder(out: &Path, shares: u32) -> PieceFolder {
    let head = FrameHead {
        key: super::key::Keyring::default().add("a", "b").key(),
        number: 3,
        image: "a.exr".into(),
        size: [2, 64],
        spp: 16,
        shares,
        exr: ExrEncoding::default(),
        png: PngEncoding::default(),
        notes: vec![("whit.plan".into(), "shadow on\n".into())],
    };
    let folder = PieceFolder::new(out, head);
    folder.make().unwrap();
    folder
}

#[cfg(test)]
mod tests {
    use super::super::key::Keyring;
    use super::*;

    fn plane(name: &str, values: Vec<f32>) -> Plane {
        Plane {
            name: name.into(),
            kind: if name == "Z" {
                ChannelKind::Exact
            } else {
                ChannelKind::Color
            },
            values,
        }
    }

    #[test]
    fn sums_keep_every_bit() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 3);
        let value = |i: usize| f64::from_bits(0x3ff0_0000_0000_0000 + 0x1_0001 * i as u64);
        let sums = Sums {
            samples: 48,
            radiance: (0..64).map(|i| [value(i), -value(i + 1), 0.0]).collect(),
            weighted: Some((0..64).map(|i| [value(3 * i); 4]).collect()),
            squares: Some((0..64).map(|i| 1.0 / value(i)).collect()),
        };
        folder.write_sums(&(32..64), 1, &sums).unwrap();
        let pieces = folder.pieces().unwrap();
        let [(piece, path)] = &pieces[..] else {
            panic!("{pieces:?}")
        };
        assert_eq!((piece.rows.clone(), piece.part), (32..64, Part::Share(1)));
        let mut reader = folder.open(piece, path).unwrap();
        match reader.read(&(32..64)).unwrap() {
            PieceRows::Sums(read) => assert_eq!(read, sums),
            other => panic!("{other:?}"),
        }
        match reader.read(&(40..41)).unwrap() {
            PieceRows::Sums(read) => assert_eq!(read.radiance, sums.radiance[16..18]),
            other => panic!("{other:?}"),
        }
        let missing = folder.coverage().unwrap().missing(&folder.cut().all());
        assert_eq!(missing, vec![0..64; 1]);
    }

    #[test]
    fn finished_rows_come_back_by_their_channels() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 1);
        let planes: Vec<Plane> = ["R", "G", "Z"]
            .iter()
            .enumerate()
            .map(|(number, name)| plane(name, (0..64).map(|i| (i * number) as f32).collect()))
            .collect();
        folder.write_finished(&(0..32), &planes).unwrap();
        let (piece, path) = folder.pieces().unwrap().remove(0);
        let mut reader = folder.open(&piece, &path).unwrap();
        let PieceRows::Finished(read) = reader.read(&(1..2)).unwrap() else {
            panic!("sums")
        };
        let find = |name: &str| read.iter().find(|plane| plane.name == name).unwrap().clone();
        assert_eq!(find("G"), plane("G", vec![2.0, 3.0]));
        assert_eq!(find("Z"), plane("Z", vec![4.0, 6.0]));
        let [again] = &PieceFolder::all(out.path()).unwrap()[..] else {
            panic!("one frame")
        };
        assert_eq!(again.head(), folder.head());
        let missing = folder.coverage().unwrap().missing(&folder.cut().all());
        assert_eq!(missing, vec![32..64; 1]);
        folder.remove();
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
    }

    #[test]
    fn other_files_and_pieces_of_other_frames_are_none() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 2);
        for name in [
            "0-32.0-of-3.exr",
            "00-32.all.exr",
            "32-0.all.exr",
            "0-65.all.exr",
            ".whit-1.tmp",
            "0-32.2-of-2.exr",
        ] {
            fs::write(folder.folder.join(name), b"").unwrap();
        }
        assert_eq!(folder.pieces().unwrap(), []);
        let path = folder.folder.join("0-32.all.exr");
        fs::write(&path, b"not an image").unwrap();
        let piece = folder.pieces().unwrap().remove(0).0;
        assert!(folder.open(&piece, &path).is_err());
        let mut other = folder.clone();
        other.head.key = Keyring::default().key();
        other
            .write_finished(&(0..32), &[plane("R", vec![0.0; 64])])
            .unwrap();
        let message = folder.open(&piece, &path).unwrap_err().to_string();
        assert!(
            message.ends_with("this piece is of another frame: remove it"),
            "{message}"
        );
    }
}
