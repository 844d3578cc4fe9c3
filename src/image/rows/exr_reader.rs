//! Streaming scanline reader for EXR files: the offset table locates each block of rows, so that any can be read alone.

use std::fs::File;
use std::io::{BufReader, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use exr::block::UncompressedBlock;
use exr::block::chunk::Chunk;
use exr::error::{Error, Result as ExrResult};
use exr::io::{PeekRead, Tracking};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData, Requirements, magic_number};
use exr::prelude::{AttributeValue, Text, Vec2, f16};

use super::super::ImageError;
use super::{ExrChannel, RowWindow, SampleType, Samples};
use crate::parallel;

/// Largest size in bytes of a block of rows: 64 channels of 32 rows of 2^17 pixels.
const MAX_BLOCK_BYTES: u64 = 1 << 30;

/// Reader for an EXR file of one part of scan lines, which reads rows on demand.
#[derive(Debug)]
pub struct ExrScanlineReader {
    path: PathBuf,
    file: BufReader<File>,
    meta: MetaData,
    channels: Vec<ExrChannel>,
    /// Offset of each block in the file, from the top.
    block_offsets: Vec<u64>,
    /// Block that was read last, which the next rows may begin in.
    last: Option<UncompressedBlock>,
}

impl ExrScanlineReader {
    /// Reads the header of the file at `path`.
    ///
    /// # Errors
    ///
    /// If it cannot be read, is no EXR file, or has tiles, several parts, or deep or subsampled pixels.
    pub fn open(path: &Path) -> Result<ExrScanlineReader, ImageError> {
        let opened = File::open(path).map_err(Error::from).and_then(|file| {
            let mut file = BufReader::new(file);
            let (meta, block_offsets) = read_head(&mut file)?;
            Ok((file, meta, block_offsets))
        });
        let (file, meta, block_offsets) = opened.map_err(|error| read_error(path, &error))?;
        let channel = |channel: &exr::prelude::ChannelDescription| {
            ExrChannel::new(channel.name.to_string(), SampleType::of_exr(channel.sample_type))
        };
        Ok(ExrScanlineReader {
            path: path.to_owned(),
            file,
            channels: meta.headers[0].channels.list.iter().map(channel).collect(),
            meta,
            block_offsets,
            last: None,
        })
    }

    /// Returns the rectangle of pixels that the file contains.
    pub fn data_window(&self) -> RowWindow {
        RowWindow::of_bounds(self.header().data_window())
    }

    /// Returns the rectangle of the complete image, of which the file may contain a part.
    pub fn display_window(&self) -> RowWindow {
        RowWindow::of_bounds(self.header().shared_attributes.display_window)
    }

    /// Returns the channels, sorted by name.
    pub fn channels(&self) -> &[ExrChannel] {
        &self.channels
    }

    /// Returns the text attribute `name` of the file, if present.
    pub fn note(&self, name: &str) -> Option<String> {
        match self
            .header()
            .own_attributes
            .other
            .get(&Text::new_or_none(name)?)?
        {
            AttributeValue::Text(text) => Some(text.to_string()),
            _ => None,
        }
    }

    /// Returns the number of rows that are compressed together: reading whole blocks, counted from the top, wastes no
    /// work.
    pub fn rows_per_block(&self) -> u32 {
        self.header().compression.scan_lines_per_block() as u32
    }

    /// Reads the values of `rows`, counted from the top of the data window: channel by channel, in the order of
    /// [`ExrScanlineReader::channels`].
    ///
    /// # Errors
    ///
    /// If the file cannot be read, is damaged, or has no such rows.
    pub fn read_rows(&mut self, rows: Range<u32>) -> Result<Vec<Samples<'static>>, ImageError> {
        let rows = rows.start as usize..rows.end as usize;
        let result = self.blocks(&rows);
        let blocks = result.map_err(|error| read_error(&self.path, &error))?;
        let samples = self.gather(&blocks, &rows);
        self.last = blocks.into_iter().next_back();
        Ok(samples)
    }

    /// Returns the header of the file's only part.
    fn header(&self) -> &Header {
        &self.meta.headers[0]
    }

    /// Reads and decompresses the blocks that contain `rows`.
    fn blocks(&mut self, rows: &Range<usize>) -> ExrResult<Vec<UncompressedBlock>> {
        let height = self.header().layer_size.height();
        if rows.start > rows.end || rows.end > height {
            let fault = format!("it has no rows {} to {}, only {height}", rows.start, rows.end);
            return Err(Error::Invalid(fault.into()));
        }
        if rows.is_empty() {
            return Ok(Vec::new());
        }
        // Reuse the last block if the rows begin in it
        let block_rows = self.header().compression.scan_lines_per_block();
        let mut indices = rows.start / block_rows..rows.end.div_ceil(block_rows);
        let begins = |block: &UncompressedBlock| block.index.pixel_position.y() == indices.start * block_rows;
        let kept = self.last.take().filter(begins);
        indices.start += usize::from(kept.is_some());
        // Read the remaining blocks from the file
        let chunks = indices
            .clone()
            .map(|index| self.chunk(index))
            .collect::<ExrResult<Vec<Chunk>>>()?;
        // Decompress them in parallel
        let meta = &self.meta;
        let read = parallel::try_map_owned(chunks, &|number, chunk| {
            unpack(chunk, meta, (indices.start + number) * block_rows)
        })?;
        Ok(kept.into_iter().chain(read).collect())
    }

    /// Reads the compressed block `index`.
    fn chunk(&mut self, index: usize) -> ExrResult<Chunk> {
        self.file.seek(SeekFrom::Start(self.block_offsets[index]))?;
        Chunk::read(&mut peekable(&mut self.file), &self.meta)
    }

    /// Copies the values of `rows` from the blocks that contain them.
    fn gather(&self, blocks: &[UncompressedBlock], rows: &Range<usize>) -> Vec<Samples<'static>> {
        let header = self.header();
        let value_count = rows.len() * header.layer_size.width();
        let mut planes: Vec<Samples> = self
            .channels
            .iter()
            .map(|channel| match channel.sample {
                SampleType::Uint => Samples::from(Vec::<u32>::with_capacity(value_count)),
                SampleType::Half | SampleType::Float => Samples::from(Vec::<f32>::with_capacity(value_count)),
            })
            .collect();
        for line in blocks.iter().flat_map(|block| block.lines(&header.channels)) {
            if rows.contains(&line.location.position.y()) {
                let channel = line.location.channel;
                append(&mut planes[channel], self.channels[channel].sample, line.value);
            }
        }
        planes
    }
}

/// Appends the values of `bytes`, in native byte order, to a channel.
fn append(plane: &mut Samples, sample: SampleType, bytes: &[u8]) {
    match plane {
        Samples::Integers(values) => {
            let (words, _) = bytes.as_chunks();
            values
                .to_mut()
                .extend(words.iter().map(|&word| u32::from_ne_bytes(word)));
        }
        Samples::Floats(values) if sample == SampleType::Half => {
            let (halves, _) = bytes.as_chunks();
            let floats = halves.iter().map(|&half| f16::from_ne_bytes(half).to_f32());
            values.to_mut().extend(floats);
        }
        Samples::Floats(values) => {
            let (words, _) = bytes.as_chunks();
            values
                .to_mut()
                .extend(words.iter().map(|&word| f32::from_ne_bytes(word)));
        }
    }
}

/// Decompresses a block and checks that it begins at `first_row`.
fn unpack(chunk: Chunk, meta: &MetaData, first_row: usize) -> ExrResult<UncompressedBlock> {
    let block = UncompressedBlock::decompress_chunk(chunk, meta, false)?;
    if block.index.pixel_position != Vec2(0, first_row) {
        return Err(Error::Invalid("its block table points to other rows".into()));
    }
    Ok(block)
}

/// Reads the headers and the offset table of the blocks.
fn read_head(file: &mut BufReader<File>) -> ExrResult<(MetaData, Vec<u64>)> {
    let mut file = peekable(file);
    magic_number::validate_exr(&mut file)?;
    let requirements = Requirements::read(&mut file)?;
    requirements.validate()?;
    let headers = Header::read_all(&mut file, &requirements, false)?;
    MetaData::validate(&headers, false)?;
    let meta = MetaData {
        requirements,
        headers,
    };
    check_kind(&meta)?;
    let tables = MetaData::read_offset_tables(&mut file, &meta.headers)?;
    let block_offsets = tables.into_iter().next().unwrap_or_default();
    Ok((meta, block_offsets))
}

/// Wraps a file in the reader type that the `exr` crate uses for whole images, so that its code is compiled for one
/// type.
fn peekable(file: &mut BufReader<File>) -> PeekRead<Tracking<&mut BufReader<File>>> {
    PeekRead::new(Tracking::new(file))
}

/// Rejects files that are not one part of scan lines with every channel in every pixel.
fn check_kind(meta: &MetaData) -> ExrResult<()> {
    let refuse = |fault: &'static str| Err(Error::NotSupported(fault.into()));
    let [header] = &meta.headers[..] else {
        return refuse("it has several parts");
    };
    if header.deep || header.blocks != BlockDescription::ScanLines {
        return refuse("it is not made of scan lines");
    }
    if header
        .channels
        .list
        .iter()
        .any(|channel| channel.sampling != Vec2(1, 1))
    {
        return refuse("it has channels with fewer values than pixels");
    }
    let row_bytes = header.layer_size.width() as u64 * header.channels.bytes_per_pixel as u64;
    if row_bytes.saturating_mul(header.compression.scan_lines_per_block() as u64) > MAX_BLOCK_BYTES {
        return refuse("its rows are too long");
    }
    Ok(())
}

/// Returns the error for a file that could not be read.
fn read_error(path: &Path, error: &dyn std::fmt::Display) -> ImageError {
    ImageError::Read {
        path: path.to_owned(),
        message: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::Attribute;
    use super::super::{Compression, ExrLayout, ExrScanlineWriter};
    use super::*;

    const ALL: [Compression; 5] = [
        Compression::None,
        Compression::Rle,
        Compression::Zips,
        Compression::Zip,
        Compression::Piz,
    ];

    /// Returns the layout of a cropped image with each kind of channel, unsorted.
    fn layout(compression: Compression) -> ExrLayout<'static> {
        ExrLayout {
            data_window: RowWindow {
                origin: [-3, 40],
                size: [13, 75],
            },
            display_window: RowWindow::of_size([200, 150]),
            channels: vec![
                ExrChannel::new("sum.upper", SampleType::Uint),
                ExrChannel::new("a", SampleType::Half),
                ExrChannel::new("depth.Z", SampleType::Float),
            ],
            compression,
            notes: &[
                Attribute {
                    name: "whit.plan",
                    text: "shadow on\n",
                },
                Attribute {
                    name: "whit.frame",
                    text: "7",
                },
            ],
        }
    }

    /// Returns integers and floats of uniform bit patterns, including NaN and infinities, and exact halves.
    fn noise(count: usize) -> (Vec<u32>, Vec<f32>, Vec<f32>) {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state ^ (state >> 15)
        };
        let integers: Vec<u32> = (0..count).map(|_| next()).collect();
        let halves = (0..count).map(|i| (i % 2048) as f32 / 8.0).collect();
        let floats = (0..count).map(|_| f32::from_bits(next())).collect();
        (integers, halves, floats)
    }

    fn bits(samples: &Samples) -> Vec<u32> {
        match samples {
            Samples::Integers(values) => values.to_vec(),
            Samples::Floats(values) => values.iter().map(|value| value.to_bits()).collect(),
        }
    }

    /// Writes noise in pieces of unequal heights.
    fn write(path: &Path, compression: Compression) -> (Vec<u32>, Vec<f32>, Vec<f32>) {
        let (integers, halves, floats) = noise(13 * 75);
        let mut writer = ExrScanlineWriter::create(path, &layout(compression)).unwrap();
        let mut start = 0;
        for rows in [1, 30, 0, 33, 11] {
            let range = 13 * start..13 * (start + rows);
            let pieces = [
                Samples::from(&integers[range.clone()]),
                Samples::from(&halves[range.clone()]),
                Samples::from(&floats[range]),
            ];
            writer.write_rows(&pieces).unwrap();
            start += rows;
            assert_eq!(writer.rows_written() as usize, start);
        }
        assert!(!path.exists());
        writer.finish().unwrap();
        (integers, halves, floats)
    }

    #[test]
    fn rows_round_trip_exactly_for_all_compressions_and_pieces() {
        let folder = tempfile::tempdir().unwrap();
        for compression in ALL {
            let path = folder.path().join(format!("{compression:?}.exr"));
            let (integers, halves, floats) = write(&path, compression);
            let mut reader = ExrScanlineReader::open(&path).unwrap();
            let names: Vec<&str> = reader
                .channels()
                .iter()
                .map(|channel| &channel.name[..])
                .collect();
            assert_eq!(names, ["a", "depth.Z", "sum.upper"]);
            for rows in [0..75, 0..1, 1..33, 32..64, 33..34, 34..34, 70..75, 5..6] {
                let range = 13 * rows.start as usize..13 * rows.end as usize;
                let read = reader.read_rows(rows.clone()).unwrap();
                let expected = [
                    Samples::from(&halves[range.clone()]),
                    Samples::from(&floats[range.clone()]),
                    Samples::from(&integers[range]),
                ];
                for (read, expected) in read.iter().zip(&expected) {
                    assert_eq!(bits(read), bits(expected), "{compression:?} {rows:?}");
                }
            }
        }
    }

    #[test]
    fn image_region_keeps_its_window_and_metadata() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("part.exr");
        write(&path, Compression::Zip);
        let reader = ExrScanlineReader::open(&path).unwrap();
        let expected = layout(Compression::Zip);
        assert_eq!(reader.data_window(), expected.data_window);
        assert_eq!(reader.display_window(), expected.display_window);
        assert_eq!(reader.rows_per_block(), 16);
        assert_eq!(reader.note("whit.plan").unwrap(), "shadow on\n");
        assert_eq!(reader.note("whit.frame").unwrap(), "7");
        assert_eq!(reader.note("whit.none"), None);
    }

    #[test]
    fn equal_rows_give_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            write(&path, Compression::Piz);
            std::fs::read(path).unwrap()
        };
        // Attributes are stored in a hash map, whose order differs in each of these.
        let first = file("0.exr");
        for again in 1..8 {
            assert_eq!(file(&format!("{again}.exr")), first);
        }
    }

    #[test]
    fn missing_rows_are_rejected_with_the_file_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("part.exr");
        write(&path, Compression::None);
        let mut reader = ExrScanlineReader::open(&path).unwrap();
        let said = reader.read_rows(70..76).unwrap_err().to_string();
        assert!(
            said.starts_with(&format!("could not read {}", path.display())),
            "{said}"
        );
        assert!(said.contains("it has no rows 70 to 76, only 75"), "{said}");
    }

    #[test]
    fn scan_line_files_of_other_writers_are_read() {
        use exr::prelude::{Encoding, Image, Layer, LayerAttributes, SpecificChannels, WritableImage};
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.exr");
        for encoding in [Encoding::FAST_LOSSLESS, Encoding::UNCOMPRESSED] {
            let channels = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, at.y() as f32, 0.5f32));
            let layer = Layer::new((4, 3), LayerAttributes::default(), encoding, channels);
            Image::from_layer(layer).write().to_file(&path).unwrap();
            match (ExrScanlineReader::open(&path), encoding.blocks) {
                (Ok(mut reader), exr::prelude::Blocks::ScanLines) => {
                    let rows = reader.read_rows(2..3).unwrap();
                    assert_eq!(rows[1], Samples::from(vec![2.0f32; 4]));
                }
                (Err(error), exr::prelude::Blocks::Tiles(_)) => {
                    assert!(error.to_string().contains("not made of scan lines"), "{error}");
                }
                (_, blocks) => panic!("{blocks:?}"),
            }
        }
    }

    #[test]
    fn truncated_or_corrupt_exr_never_panics() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("part.exr");
        let read = |bytes: &[u8]| {
            let damaged = folder.path().join("damaged.exr");
            std::fs::write(&damaged, bytes).unwrap();
            ExrScanlineReader::open(&damaged).and_then(|mut reader| {
                let height = reader.data_window().size[1];
                reader.read_rows(height.saturating_sub(9)..height)
            })
        };
        for compression in ALL {
            write(&path, compression);
            let whole = std::fs::read(&path).unwrap();
            std::fs::remove_file(&path).unwrap();
            read(&whole).unwrap();
            for length in (0..whole.len()).step_by(37) {
                let _ = read(&whole[..length]);
            }
            read(&whole[..whole.len() / 2]).unwrap_err();
            for at in (0..whole.len()).step_by(11) {
                let mut bytes = whole.clone();
                bytes[at] ^= 0xff;
                let _ = read(&bytes);
            }
        }
    }
}
