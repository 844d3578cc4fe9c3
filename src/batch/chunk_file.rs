//! Files of a frame's pieces: one EXR file each, in a folder that is removed once the frame is complete.
//!
//! Finished rows are stored as the final channels of the image. Rows of a share are stored as sums of samples in f64,
//! for which EXR has no channel type: each is split into two integer channels, so that no bit is lost. The data window
//! gives the rows.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::chunk::{Chunk, ChunkKind, ChunkLayout, Coverage};
use super::fingerprint::Fingerprint;
use crate::image::rows::{
    Compression, ExrChannel, ExrLayout, ExrScanlineReader, ExrScanlineWriter, RowWindow, SampleType, Samples,
    join_f64, split_f64,
};
use crate::image::{Attribute, ChannelKind, ExrEncoding, ImageError, PngEncoding};
use crate::render::PartSums;

/// Folder of the pieces of all frames, within the output folder of a batch.
const FOLDER: &str = ".whit-pieces";

/// Header attribute with the frame's metadata as JSON.
const FRAME: &str = "whit.frame";
/// Header attribute with the number of samples per pixel of a share.
const SAMPLES: &str = "whit.samples";

/// Header attribute with the names of the colour channels of finished rows.
const COLORS: &str = "whit.colors";

/// Prefixes of the channel names of sums.
const RADIANCE: &str = "radiance";
const WEIGHTED: &str = "weighted";
const SQUARES: &str = "squares";

/// One channel of some rows of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelPlane {
    /// Name of the channel in the file.
    pub name: String,
    /// Kind of the channel, which decides about rounding to half precision.
    pub kind: ChannelKind,
    /// One value per pixel, the top row first.
    pub values: Vec<f32>,
}

/// Metadata of a frame that is stored in each of its pieces, sufficient for merging them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameMetadata {
    /// Hash of the frame's inputs.
    pub key: Fingerprint,
    /// Index of the frame in its batch.
    pub number: usize,
    /// Path of the image file relative to the output folder.
    pub image: PathBuf,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Number of samples per pixel.
    pub spp: u32,
    /// Number of shares that the samples are split into.
    pub shares: u32,
    /// Encoding of the image as EXR.
    pub exr: ExrEncoding,
    /// Encoding of the image as PNG.
    pub png: PngEncoding,
    /// Names and texts of the metadata of the image file.
    pub notes: Vec<(String, String)>,
}

/// Folder with the pieces of one frame.
#[derive(Clone, Debug)]
pub struct ChunkDirectory {
    folder: PathBuf,
    head: FrameMetadata,
    cut: ChunkLayout,
}

/// Rows read from a piece.
#[derive(Debug)]
pub enum ChunkRows {
    /// Channels of finished rows.
    Finished(Vec<ChannelPlane>),
    /// Sums of the samples of a share.
    PartSums(PartSums),
}

impl ChunkDirectory {
    /// Returns the piece folder of a frame within the output folder `out`, without creating it.
    pub fn new(out: &Path, head: FrameMetadata) -> ChunkDirectory {
        ChunkDirectory {
            folder: folder_of(out, head.key),
            cut: ChunkLayout {
                shares: head.shares,
                ..ChunkLayout::whole(head.size[1])
            },
            head,
        }
    }

    /// Returns the piece folders of all frames that have pieces in the output folder `out`, in the order of the frames.
    /// Unreadable pieces are ignored.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read.
    pub fn all(out: &Path) -> io::Result<Vec<ChunkDirectory>> {
        let mut folders = Vec::new();
        for folder in entries(&out.join(FOLDER))? {
            let head = entries(&folder)?.iter().find_map(|path| {
                let reader = ExrScanlineReader::open(path).ok()?;
                serde_json::from_str::<FrameMetadata>(&reader.note(FRAME)?).ok()
            });
            folders.extend(head.map(|head| ChunkDirectory::new(out, head)));
        }
        folders.sort_by_key(|folder| folder.head.number);
        Ok(folders)
    }

    /// Creates the folder and its parents.
    ///
    /// # Errors
    ///
    /// If the folder cannot be created.
    pub fn make(&self) -> io::Result<()> {
        fs::create_dir_all(&self.folder)
    }

    /// Returns the division of the frame into shares, with a single band.
    pub fn cut(&self) -> &ChunkLayout {
        &self.cut
    }

    /// Returns the frame's metadata.
    pub fn head(&self) -> &FrameMetadata {
        &self.head
    }

    /// Returns the existing pieces with their files.
    ///
    /// # Errors
    ///
    /// If the folder cannot be read; a missing folder has no pieces.
    pub fn pieces(&self) -> io::Result<Vec<(Chunk, PathBuf)>> {
        let mut pieces = Vec::new();
        // Keep the files whose names are those of pieces; there may be others
        for path in entries(&self.folder)? {
            let name = path.file_name().and_then(|name| name.to_str());
            if let Some(piece) = name.and_then(|name| self.piece_of(name)) {
                pieces.push((piece, path));
            }
        }
        // Finished pieces come before those of shares.
        pieces.sort_by_key(|(piece, _)| (piece.part != ChunkKind::All, piece.rows.start, piece.rows.end));
        Ok(pieces)
    }

    /// Returns the rows of each share that are present.
    ///
    /// # Errors
    ///
    /// If the folder cannot be read.
    pub fn coverage(&self) -> io::Result<Coverage> {
        let mut coverage = Coverage::none(&self.cut);
        for (piece, _) in self.pieces()? {
            coverage.add(&piece);
        }
        Ok(coverage)
    }

    /// Writes a piece of finished rows.
    ///
    /// # Errors
    ///
    /// If the file cannot be written, for example on a full disk.
    pub fn write_finished(&self, rows: &Range<u32>, planes: &[ChannelPlane]) -> Result<(), ImageError> {
        // Record which channels are colours
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
        let piece = Chunk {
            rows: rows.clone(),
            part: ChunkKind::All,
        };
        self.write(&piece, channels.collect(), &values, note)
    }

    /// Writes a piece with the sums of a share's rows.
    ///
    /// # Errors
    ///
    /// If the file cannot be written, for example on a full disk.
    pub fn write_sums(&self, rows: &Range<u32>, share: u32, sums: &PartSums) -> Result<(), ImageError> {
        // Split each f64 channel into two integer channels
        let planes = planes_of(sums);
        let channels = planes.iter().flat_map(|(name, _)| {
            ["high", "low"].map(|half| ExrChannel::new(format!("{name}.{half}"), SampleType::Uint))
        });
        let values = planes
            .iter()
            .flat_map(|(_, values)| split_f64(values))
            .map(Samples::from);
        let (channels, values): (Vec<ExrChannel>, Vec<Samples>) = (channels.collect(), values.collect());
        // Record the number of samples, which the mean is computed from
        let samples = sums.samples.to_string();
        let note = Attribute {
            name: SAMPLES,
            text: &samples,
        };
        let piece = Chunk {
            rows: rows.clone(),
            part: ChunkKind::Share(share),
        };
        self.write(&piece, channels, &values, note)
    }

    fn write(
        &self,
        piece: &Chunk,
        channels: Vec<ExrChannel>,
        values: &[Samples],
        note: Attribute,
    ) -> Result<(), ImageError> {
        let mut writer = self.create(&self.name(piece), self.window(&piece.rows), channels, note)?;
        writer.write_rows(values)?;
        writer.finish()
    }

    /// Starts writing an EXR file of the frame, with the frame's metadata and one further attribute.
    pub(super) fn create(
        &self,
        name: &str,
        window: RowWindow,
        channels: Vec<ExrChannel>,
        note: Attribute,
    ) -> Result<ExrScanlineWriter, ImageError> {
        // Every file of the frame carries the frame's metadata
        let text = serde_json::to_string(&self.head).unwrap_or_default();
        let head = Attribute {
            name: FRAME,
            text: &text,
        };
        let layout = ExrLayout {
            data_window: window,
            display_window: RowWindow::of_size(self.head.size),
            channels,
            compression: Compression::None,
            notes: &[head, note],
        };
        ExrScanlineWriter::create(&self.path(name), &layout)
    }

    /// Returns the path of a file of the frame.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn window(&self, rows: &Range<u32>) -> RowWindow {
        RowWindow {
            origin: [0, rows.start as i32],
            size: [self.head.size[0], rows.end - rows.start],
        }
    }

    fn name(&self, piece: &Chunk) -> String {
        let Range { start, end } = piece.rows;
        match piece.part {
            ChunkKind::All => format!("{start}-{end}.all.exr"),
            ChunkKind::Share(share) => format!("{start}-{end}.{share}-of-{}.exr", self.cut.shares),
        }
    }

    /// Returns the piece that a file of this name holds, or `None` if the name is not that of a piece.
    fn piece_of(&self, name: &str) -> Option<Chunk> {
        // Parse the rows and the part from the name
        let (rows, part) = name.strip_suffix(".exr")?.split_once('.')?;
        let (start, end) = rows.split_once('-')?;
        let rows: Range<u32> = start.parse().ok()?..end.parse().ok()?;
        let part = match part {
            "all" => ChunkKind::All,
            share => {
                let (share, count) = share.split_once("-of-")?;
                let is_ours = count.parse() == Ok(self.cut.shares);
                ChunkKind::Share(
                    share
                        .parse()
                        .ok()
                        .filter(|&share| is_ours && share < self.cut.shares)?,
                )
            }
        };
        let piece = Chunk { rows, part };
        // Only the canonical spelling of the numbers is accepted.
        (piece.rows.start < piece.rows.end && piece.rows.end <= self.cut.height && self.name(&piece) == name)
            .then_some(piece)
    }

    /// Removes all pieces and all other files of the frame.
    pub fn remove(&self) {
        remove(&self.folder);
    }

    /// Removes the pieces of a frame from the output folder `out`, if there are any.
    pub fn remove_of(out: &Path, key: Fingerprint) {
        remove(&folder_of(out, key));
    }

    /// Returns the path of the folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Opens a piece for reading rows.
    ///
    /// # Errors
    ///
    /// If the file cannot be read, or belongs to another frame.
    pub fn open(&self, piece: &Chunk, path: &Path) -> Result<ChunkReader, ImageError> {
        let reader = self.open_file(path, self.window(&piece.rows))?;
        Ok(ChunkReader {
            piece: piece.clone(),
            path: path.to_owned(),
            reader,
        })
    }

    /// Opens an EXR file of the frame, which must have this data window.
    pub(super) fn open_file(&self, path: &Path, window: RowWindow) -> Result<ExrScanlineReader, ImageError> {
        let reader = ExrScanlineReader::open(path)?;
        let head = reader
            .note(FRAME)
            .and_then(|text| serde_json::from_str::<FrameMetadata>(&text).ok());
        // Reject files of another frame, and files with other rows than their name says
        if head.is_none_or(|head| head.key != self.head.key) || reader.data_window() != window {
            return Err(ImageError::Unusable {
                path: path.to_owned(),
                fault: "this piece belongs to another frame".into(),
                remedy: "remove it",
            });
        }
        Ok(reader)
    }
}

/// Open piece, from which rows can be read.
#[derive(Debug)]
pub struct ChunkReader {
    piece: Chunk,
    path: PathBuf,
    reader: ExrScanlineReader,
}

impl ChunkReader {
    /// Returns the rows and samples of the piece.
    pub fn piece(&self) -> &Chunk {
        &self.piece
    }

    /// Reads some rows, given by their numbers in the image.
    ///
    /// # Errors
    ///
    /// If the rows cannot be read, or a channel is missing.
    pub fn read(&mut self, rows: &Range<u32>) -> Result<ChunkRows, ImageError> {
        let first = self.piece.rows.start;
        let values = self.reader.read_rows(rows.start - first..rows.end - first)?;
        let names = self.reader.channels().iter().map(|channel| channel.name.clone());
        // Finished rows: restore the kind of each channel
        if self.piece.part == ChunkKind::All {
            let colors = self.reader.note(COLORS).unwrap_or_default();
            let kind = |name: &str| match colors.split(' ').any(|color| color == name) {
                true => ChannelKind::Color,
                false => ChannelKind::Exact,
            };
            let plane = |(name, values): (String, Samples)| match values {
                Samples::Floats(values) => Some(ChannelPlane {
                    kind: kind(&name),
                    name,
                    values: values.into_owned(),
                }),
                Samples::Integers(_) => None,
            };
            let planes: Option<Vec<ChannelPlane>> = names.zip(values).map(plane).collect();
            return planes.map(ChunkRows::Finished).ok_or_else(|| self.damaged());
        }
        // Rows of a share: join the integer channels to sums in f64
        let planes: Vec<(String, Samples)> = names.zip(values).collect();
        let samples = self.reader.note(SAMPLES).and_then(|text| text.parse().ok());
        samples
            .and_then(|samples| sums_of(samples, &planes))
            .map(ChunkRows::PartSums)
            .ok_or_else(|| self.damaged())
    }

    fn damaged(&self) -> ImageError {
        damaged(&self.path)
    }
}

/// Returns the error for a file of the frame with missing or wrong contents.
pub(super) fn damaged(path: &Path) -> ImageError {
    ImageError::Unusable {
        path: path.to_owned(),
        fault: "this piece lacks data of its frame".into(),
        remedy: "remove it",
    }
}

/// Returns the path of the folder for the pieces of a frame.
fn folder_of(out: &Path, key: Fingerprint) -> PathBuf {
    out.join(FOLDER).join(key.short())
}

/// Removes a frame's folder, and the parent folder if it is empty then.
fn remove(folder: &Path) {
    // Files that cannot be removed do no harm.
    let _ = fs::remove_dir_all(folder);
    if let Some(all) = folder.parent() {
        // `remove_dir` fails if the folder is not empty.
        let _ = fs::remove_dir(all);
    }
}

/// Returns the paths of a folder's entries; none if the folder does not exist.
fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.map(|entry| Ok(entry?.path())).collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

/// Returns the named channels of sums, without splitting the values.
fn planes_of(sums: &PartSums) -> Vec<(String, Vec<f64>)> {
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

/// Returns the sums that these channels hold, or `None` if a mandatory channel is missing.
fn sums_of(samples: u32, planes: &[(String, Samples)]) -> Option<PartSums> {
    let half = |name: String| match planes.iter().find(|(plane, _)| *plane == name)? {
        (_, Samples::Integers(values)) => Some(values),
        (_, Samples::Floats(_)) => None,
    };
    // Join the halves of a channel, which is absent if one of them is
    let plane = |name: &str| {
        Some(join_f64(
            half(format!("{name}.high"))?,
            half(format!("{name}.low"))?,
        ))
    };
    // Interleave the channels to one array per pixel
    fn zipped<const N: usize>(planes: [Option<Vec<f64>>; N]) -> Option<Vec<[f64; N]>> {
        let planes: Vec<Vec<f64>> = planes.into_iter().collect::<Option<_>>()?;
        let sums = (0..planes[0].len()).map(|pixel| std::array::from_fn(|channel| planes[channel][pixel]));
        Some(sums.collect())
    }
    Some(PartSums {
        samples,
        radiance: zipped([0, 1, 2].map(|channel| plane(&format!("{RADIANCE}.{channel}"))))?,
        weighted: zipped([0, 1, 2, 3].map(|channel| plane(&format!("{WEIGHTED}.{channel}")))),
        squares: plane(SQUARES),
    })
}

/// Creates the piece folder of a frame of 2 by 64 pixels, for tests.
#[cfg(test)]
pub(super) fn folder(out: &Path, shares: u32) -> ChunkDirectory {
    let head = FrameMetadata {
        key: super::fingerprint::FingerprintHasher::default()
            .add("a", "b")
            .key(),
        number: 3,
        image: "a.exr".into(),
        size: [2, 64],
        spp: 16,
        shares,
        exr: ExrEncoding::default(),
        png: PngEncoding::default(),
        notes: vec![("whit.plan".into(), "shadow on\n".into())],
    };
    let folder = ChunkDirectory::new(out, head);
    folder.make().unwrap();
    folder
}

#[cfg(test)]
mod tests {
    use super::super::fingerprint::FingerprintHasher;
    use super::*;

    fn plane(name: &str, values: Vec<f32>) -> ChannelPlane {
        ChannelPlane {
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
    fn sums_are_read_back_to_the_bit() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 3);
        let value = |i: usize| f64::from_bits(0x3ff0_0000_0000_0000 + 0x1_0001 * i as u64);
        let sums = PartSums {
            samples: 48,
            radiance: (0..64).map(|i| [value(i), -value(i + 1), 0.0]).collect(),
            weighted: Some((0..64).map(|i| [value(3 * i); 4]).collect()),
            squares: Some((0..64).map(|i| 1.0 / value(i)).collect()),
        };
        // Write and read back the piece, whole and in part
        folder.write_sums(&(32..64), 1, &sums).unwrap();
        let pieces = folder.pieces().unwrap();
        let [(piece, path)] = &pieces[..] else {
            panic!("{pieces:?}")
        };
        assert_eq!((piece.rows.clone(), piece.part), (32..64, ChunkKind::Share(1)));
        let mut reader = folder.open(piece, path).unwrap();
        match reader.read(&(32..64)).unwrap() {
            ChunkRows::PartSums(read) => assert_eq!(read, sums),
            other => panic!("{other:?}"),
        }
        match reader.read(&(40..41)).unwrap() {
            ChunkRows::PartSums(read) => assert_eq!(read.radiance, sums.radiance[16..18]),
            other => panic!("{other:?}"),
        }
        let missing = folder.coverage().unwrap().missing(&folder.cut().all());
        assert_eq!(missing, vec![0..64; 1]);
    }

    #[test]
    fn finished_rows_are_read_back_with_their_channels() {
        let out = tempfile::tempdir().unwrap();
        let folder = folder(out.path(), 1);
        let planes: Vec<ChannelPlane> = ["R", "G", "Z"]
            .iter()
            .enumerate()
            .map(|(number, name)| plane(name, (0..64).map(|i| (i * number) as f32).collect()))
            .collect();
        folder.write_finished(&(0..32), &planes).unwrap();
        let (piece, path) = folder.pieces().unwrap().remove(0);
        let mut reader = folder.open(&piece, &path).unwrap();
        let ChunkRows::Finished(read) = reader.read(&(1..2)).unwrap() else {
            panic!("sums")
        };
        let find = |name: &str| read.iter().find(|plane| plane.name == name).unwrap().clone();
        assert_eq!(find("G"), plane("G", vec![2.0, 3.0]));
        assert_eq!(find("Z"), plane("Z", vec![4.0, 6.0]));
        // List the frames, then remove the only one
        let [again] = &ChunkDirectory::all(out.path()).unwrap()[..] else {
            panic!("one frame")
        };
        assert_eq!(again.head(), folder.head());
        let missing = folder.coverage().unwrap().missing(&folder.cut().all());
        assert_eq!(missing, vec![32..64; 1]);
        folder.remove();
        assert_eq!(fs::read_dir(out.path()).unwrap().count(), 0);
    }

    #[test]
    fn other_files_and_pieces_of_other_frames_are_rejected() {
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
        other.head.key = FingerprintHasher::default().key();
        other
            .write_finished(&(0..32), &[plane("R", vec![0.0; 64])])
            .unwrap();
        let message = folder.open(&piece, &path).unwrap_err().to_string();
        assert!(
            message.ends_with("this piece belongs to another frame: remove it"),
            "{message}"
        );
    }
}
