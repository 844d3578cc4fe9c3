//! Folder with the pieces of a frame: one EXR file each; it is removed once the frame is complete.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::chunk::{Chunk, ChunkKind, ChunkLayout, Coverage};
use super::chunk_format::{ChunkReader, EncodedRows};
use crate::batch::fingerprint::Fingerprint;
use crate::batch::request::Notes;
use crate::image::rows::{
    Compression, ExrChannel, ExrLayout, ExrScanlineReader, ExrScanlineWriter, RowWindow,
};
use crate::image::{Attribute, ExrEncoding, ImageError, PngEncoding};
use crate::render::{Layer, PartSums};
use crate::scene::image_settings::{MAX_PIXELS, MAX_SPP};

/// Folder of the pieces of all frames, within the output folder of a batch.
const FOLDER: &str = ".whit-pieces";

/// Header attribute with the frame's metadata as JSON.
const FRAME: &str = "whit.frame";

/// Metadata of a frame that is stored in each of its pieces, sufficient for merging them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FrameMetadata {
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
    pub notes: Notes,
}

impl FrameMetadata {
    /// Reads the metadata from the header of a file; `None` if it is absent or invalid.
    ///
    /// Files are untrusted: the image must be inside of the output folder, and its numbers within the limits of jobs.
    fn of_file(reader: &ExrScanlineReader) -> Option<FrameMetadata> {
        let head: FrameMetadata = serde_json::from_str(&reader.note(FRAME)?).ok()?;
        let [width, height] = head.size.map(u64::from);
        let is_inside = head.image.file_name().is_some()
            && head
                .image
                .components()
                .all(|part| matches!(part, Component::Normal(_)));
        let is_in_range = (1..=MAX_PIXELS).contains(&(width * height))
            && (1..=MAX_SPP).contains(&head.spp)
            && (1..=MAX_SPP).contains(&head.shares);
        (is_inside && is_in_range).then_some(head)
    }
}

/// Folder with the pieces of one frame.
#[derive(Clone, Debug)]
pub(crate) struct ChunkDirectory {
    folder: PathBuf,
    head: FrameMetadata,
    cut: ChunkLayout,
}

impl ChunkDirectory {
    /// Returns the piece folder of a frame within the output folder `out`, without creating it.
    pub(crate) fn new(out: &Path, head: FrameMetadata) -> ChunkDirectory {
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
    /// Unreadable and invalid pieces are ignored.
    pub(crate) fn all(out: &Path) -> io::Result<Vec<ChunkDirectory>> {
        let mut folders = Vec::new();
        for folder in entries(&out.join(FOLDER))? {
            let head = entries(&folder)?
                .iter()
                .find_map(|path| FrameMetadata::of_file(&ExrScanlineReader::open(path).ok()?));
            folders.extend(head.map(|head| ChunkDirectory::new(out, head)));
        }
        folders.sort_by_key(|folder| folder.head.number);
        Ok(folders)
    }

    /// Creates the folder and its parents.
    pub(crate) fn make(&self) -> io::Result<()> {
        fs::create_dir_all(&self.folder)
    }

    /// Returns the division of the frame into shares, with a single band.
    pub(crate) fn cut(&self) -> &ChunkLayout {
        &self.cut
    }

    /// Returns the frame's metadata.
    pub(crate) fn head(&self) -> &FrameMetadata {
        &self.head
    }

    /// Returns the existing pieces with their files.
    pub(crate) fn pieces(&self) -> io::Result<Vec<(Chunk, PathBuf)>> {
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
    pub(crate) fn coverage(&self) -> io::Result<Coverage> {
        let mut coverage = Coverage::none(&self.cut);
        for (piece, _) in self.pieces()? {
            coverage.add(&piece);
        }
        Ok(coverage)
    }

    /// Writes a piece of finished rows.
    pub(crate) fn write_finished(&self, rows: &Range<u32>, planes: &[Layer]) -> Result<(), ImageError> {
        self.write(rows, ChunkKind::All, EncodedRows::of_planes(planes))
    }

    /// Writes a piece with the sums of a share's rows.
    pub(crate) fn write_sums(
        &self,
        rows: &Range<u32>,
        share: u32,
        sums: &PartSums,
    ) -> Result<(), ImageError> {
        self.write(rows, ChunkKind::Share(share), EncodedRows::of_sums(sums))
    }

    fn write(&self, rows: &Range<u32>, part: ChunkKind, encoded: EncodedRows) -> Result<(), ImageError> {
        let rows = rows.clone();
        let window = self.window(&rows);
        let (name, text) = &encoded.note;
        let note = Attribute { name, text };
        let mut writer = self.create(&self.name(&Chunk { rows, part }), window, encoded.channels, note)?;
        writer.write_rows(&encoded.values)?;
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
    pub(crate) fn remove(&self) {
        remove(&self.folder);
    }

    /// Removes the pieces of a frame from the output folder `out`, if there are any.
    pub(crate) fn remove_of(out: &Path, key: Fingerprint) {
        remove(&folder_of(out, key));
    }

    /// Returns the path of the folder.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Opens a piece for reading rows.
    pub(crate) fn open(&self, piece: &Chunk, path: &Path) -> Result<ChunkReader, ImageError> {
        let reader = self.open_file(path, self.window(&piece.rows))?;
        Ok(ChunkReader::new(piece, path, reader))
    }

    /// Opens an EXR file of the frame, which must have this data window.
    pub(super) fn open_file(&self, path: &Path, window: RowWindow) -> Result<ExrScanlineReader, ImageError> {
        let reader = ExrScanlineReader::open(path)?;
        let head = FrameMetadata::of_file(&reader);
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

/// Creates the piece folder of a frame of 2 by 64 pixels, for tests.
#[cfg(test)]
pub(super) fn folder(out: &Path, shares: u32) -> ChunkDirectory {
    let mut notes = Notes::default();
    notes.add("whit.plan", "shadow on\n".into());
    let head = FrameMetadata {
        key: crate::batch::fingerprint::FingerprintHasher::default()
            .add("a", "b")
            .key(),
        number: 3,
        image: "a.exr".into(),
        size: [2, 64],
        spp: 16,
        shares,
        exr: ExrEncoding::default(),
        png: PngEncoding::default(),
        notes,
    };
    let folder = ChunkDirectory::new(out, head);
    folder.make().unwrap();
    folder
}

#[cfg(test)]
mod tests {
    use super::super::chunk_format::ChunkRows;
    use super::*;
    use crate::batch::fingerprint::FingerprintHasher;
    use crate::image::ChannelKind;
    use crate::image::rows::SampleType;

    fn plane(name: &str, values: Vec<f32>) -> Layer {
        Layer {
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
        let planes: Vec<Layer> = ["R", "G", "Z"]
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
    fn pieces_with_metadata_out_of_range_are_ignored() {
        type Change = fn(&mut FrameMetadata);
        let changes: [(&str, Change); 6] = [
            ("absolute path", |head| head.image = "/tmp/a.exr".into()),
            ("path out of the folder", |head| {
                head.image = "../a.exr".into();
            }),
            ("no name", |head| head.image = "".into()),
            ("too many pixels", |head| head.size = [1 << 16; 2]),
            ("no shares", |head| head.shares = 0),
            ("too many shares", |head| head.shares = u32::MAX),
        ];
        for (name, change) in changes {
            let out = tempfile::tempdir().unwrap();
            let sound = folder(out.path(), 1);
            let mut head = sound.head.clone();
            change(&mut head);
            let changed = ChunkDirectory {
                head,
                ..sound.clone()
            };
            let window = RowWindow::of_size([2, 64]);
            let note = Attribute { name: "a", text: "b" };
            let channels = vec![ExrChannel::new("R", SampleType::Float)];
            let mut writer = changed.create("0-64.all.exr", window, channels, note).unwrap();
            writer.write_rows(&[vec![0.0; 128].into()]).unwrap();
            writer.finish().unwrap();
            assert!(ChunkDirectory::all(out.path()).unwrap().is_empty(), "{name}");
        }
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
