//! Streaming scanline writer for EXR files: the header, a placeholder for the offset table, the blocks, then the table.
//!
//! A block is the number of rows that the compression packs together. Blocks are buffered until some megabytes of them
//! can be compressed by several threads; memory is bounded by that. Attributes are written in the order of their names,
//! so that equal images give identical bytes.

use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::slice;

use exr::block::chunk::Chunk;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::meta::attribute;
use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData, magic_number, sequence_end};
use exr::prelude::{AttributeValue, ChannelDescription, LayerAttributes, LineOrder, Text, Vec2, f16};

use super::super::atomic_file::{AtomicFile, write_error};
use super::super::{Attribute, ImageError, SOFTWARE};
use super::{ExrLayout, Samples};
use crate::parallel;

/// Bytes of uncompressed blocks that are buffered for parallel compression.
const WAITING_BYTES: usize = 1 << 24;

/// Bytes of a block's header: its first row and its length.
const BLOCK_HEAD_BYTES: u64 = 8;

/// Writer of an EXR file row by row, from top to bottom.
///
/// The file appears when [`ExrScanlineWriter::finish`] returns; dropped before that, the writer leaves no file. It
/// buffers some 16 MiB, or one block if that is larger, besides the rows of the current call.
#[derive(Debug)]
pub struct ExrScanlineWriter {
    path: PathBuf,
    encoder: RowEncoder<AtomicFile>,
}

impl ExrScanlineWriter {
    /// Creates a temporary file beside `path` and writes the header.
    ///
    /// # Errors
    ///
    /// If the folder is not writable, or the layout is invalid: no pixels, no channels or one twice, names that EXR
    /// reserves.
    pub fn create(path: &Path, layout: &ExrLayout) -> Result<ExrScanlineWriter, ImageError> {
        let encoder = AtomicFile::create(path).and_then(|file| RowEncoder::new(file, layout));
        Ok(ExrScanlineWriter {
            path: path.to_owned(),
            encoder: encoder.map_err(|error| write_error(path, &error))?,
        })
    }

    /// Appends the next rows: for each channel of the layout, in its order, one value per pixel of the rows.
    ///
    /// # Errors
    ///
    /// If channels are missing or of another type, rows are incomplete or exceed the image's height, or the disk is
    /// full.
    pub fn write_rows(&mut self, channels: &[Samples]) -> Result<(), ImageError> {
        self.encoder
            .write_rows(channels)
            .map_err(|error| write_error(&self.path, &error))
    }

    /// Returns the number of rows written so far.
    pub fn rows_written(&self) -> u32 {
        self.encoder.next_row as u32
    }

    /// Completes the file, syncs it to disk and renames it to its final path.
    ///
    /// # Errors
    ///
    /// If rows are missing or the disk is full.
    pub fn finish(self) -> Result<(), ImageError> {
        let file = self.encoder.finish();
        file.and_then(AtomicFile::commit)
            .map_err(|error| write_error(&self.path, &error))
    }
}

/// Implementation of [`ExrScanlineWriter`] for any output stream.
#[derive(Debug)]
struct RowEncoder<W> {
    out: W,
    header: Header,
    /// Index of the caller's channel for each channel of the file.
    sources: Vec<usize>,
    /// Index of the next row.
    next_row: usize,
    /// Rows of the block that is not complete.
    block: Vec<u8>,
    /// Complete blocks that are not compressed yet.
    pending: Vec<UncompressedBlock>,
    /// Offset of the table of blocks in the file.
    table_offset: u64,
    /// Offset of each block that is written.
    block_offsets: Vec<u64>,
    /// Offset of the next block in the file.
    position: u64,
}

impl<W: Write + Seek> RowEncoder<W> {
    /// Writes the header and a placeholder for the offset table.
    fn new(mut out: W, layout: &ExrLayout) -> io::Result<RowEncoder<W>> {
        // Sort channels by name, as EXR requires
        let mut sources: Vec<usize> = (0..layout.channels.len()).collect();
        sources.sort_by(|&a, &b| layout.channels[a].name.cmp(&layout.channels[b].name));
        // Write the header and reserve the table
        let header = header(layout, &sources)?;
        let bytes = header_bytes(&header)?;
        out.write_all(&bytes)?;
        let table = vec![0; header.chunk_count * size_of::<u64>()];
        out.write_all(&table)?;
        Ok(RowEncoder {
            out,
            sources,
            next_row: 0,
            block: Vec::new(),
            pending: Vec::new(),
            table_offset: bytes.len() as u64,
            block_offsets: Vec::with_capacity(header.chunk_count),
            position: (bytes.len() + table.len()) as u64,
            header,
        })
    }

    /// Implements [`ExrScanlineWriter::write_rows`] for the output stream.
    fn write_rows(&mut self, channels: &[Samples]) -> io::Result<()> {
        let row_count = self.row_count(channels)?;
        for row in 0..row_count {
            self.push_row(channels, row);
            let block_rows = self.header.compression.scan_lines_per_block();
            if self.next_row.is_multiple_of(block_rows) || self.next_row == self.header.layer_size.height() {
                self.end_block()?;
            }
        }
        Ok(())
    }

    /// Writes the remaining blocks and the offset table; returns the flushed output.
    fn finish(mut self) -> io::Result<W> {
        let height = self.header.layer_size.height();
        // Check that all rows are present
        if self.next_row < height {
            let fault = format!("only {} of {height} rows are there", self.next_row);
            return Err(io::Error::other(fault));
        }
        // Write the remaining blocks
        self.write_waiting()?;
        if self.block_offsets.len() < self.header.chunk_count {
            return Err(io::Error::other("an earlier failure left rows out of it"));
        }
        // Fill in the offset table
        let table: Vec<u8> = self
            .block_offsets
            .iter()
            .flat_map(|at| at.to_le_bytes())
            .collect();
        self.out.seek(SeekFrom::Start(self.table_offset))?;
        self.out.write_all(&table)?;
        self.out.flush()?;
        Ok(self.out)
    }

    /// Checks the values and returns the number of rows that they form.
    fn row_count(&self, channels: &[Samples]) -> io::Result<usize> {
        let refuse = |fault: String| Err(refusal(fault));
        // Check the number of channels
        let (wanted, given) = (self.sources.len(), channels.len());
        if given != wanted {
            return refuse(format!("values of {given} channels were given for {wanted}"));
        }
        let Vec2(width, height) = self.header.layer_size;
        // Check the length and type of each channel
        let value_count = channels[0].len();
        for (description, &source) in self.header.channels.list.iter().zip(&self.sources) {
            let (name, values) = (&description.name, &channels[source]);
            if values.len() != value_count || !value_count.is_multiple_of(width) {
                let fault = format!("channel {name} has {} values for rows of {width}", values.len());
                return refuse(fault);
            }
            if !values.fits(super::SampleType::of_exr(description.sample_type)) {
                return refuse(format!("channel {name} was given values of another kind"));
            }
        }
        // Check the number of rows
        let row_count = value_count / width;
        if row_count > height - self.next_row {
            return refuse(format!("more than its {height} rows were given"));
        }
        Ok(row_count)
    }

    /// Appends a row to the block, channel by channel.
    fn push_row(&mut self, channels: &[Samples], row: usize) {
        let width = self.header.layer_size.width();
        let range = row * width..(row + 1) * width;
        for (description, &source) in self.header.channels.list.iter().zip(&self.sources) {
            match &channels[source] {
                Samples::Integers(values) => self
                    .block
                    .extend(bytemuck::cast_slice::<u32, u8>(&values[range.clone()])),
                Samples::Floats(values) if description.sample_type == exr::prelude::SampleType::F16 => {
                    let halves = values[range.clone()].iter().map(|&value| f16::from_f32(value));
                    self.block.extend(halves.flat_map(f16::to_ne_bytes));
                }
                Samples::Floats(values) => self
                    .block
                    .extend(bytemuck::cast_slice::<f32, u8>(&values[range.clone()])),
            }
        }
        self.next_row += 1;
    }

    /// Moves the complete block to the waiting ones, and writes these if they exceed the buffer size.
    fn end_block(&mut self) -> io::Result<()> {
        let Vec2(width, _) = self.header.layer_size;
        let block_rows = self.header.compression.scan_lines_per_block();
        let first_row = (self.next_row - 1) / block_rows * block_rows;
        let bytes = self.block.len();
        self.pending.push(UncompressedBlock {
            index: BlockIndex {
                layer: 0,
                pixel_position: Vec2(0, first_row),
                pixel_size: Vec2(width, self.next_row - first_row),
                level: Vec2(0, 0),
            },
            data: std::mem::replace(&mut self.block, Vec::with_capacity(bytes)),
        });
        if self.pending.len() * bytes >= WAITING_BYTES {
            self.write_waiting()?;
        }
        Ok(())
    }

    /// Compresses the waiting blocks in parallel and writes them in order.
    fn write_waiting(&mut self) -> io::Result<()> {
        let pending = std::mem::take(&mut self.pending);
        let header = slice::from_ref(&self.header);
        let chunks: Vec<Chunk> =
            parallel::try_map_owned(pending, &|_, block| block.compress_to_chunk(header))
                .map_err(io_error)?;
        for chunk in chunks {
            let exr::block::chunk::CompressedBlock::ScanLine(lines) = &chunk.compressed_block else {
                return Err(io::Error::other("a block of rows became a block of another kind"));
            };
            let bytes = BLOCK_HEAD_BYTES + lines.compressed_pixels_le.len() as u64;
            chunk.write(&mut self.out, 1).map_err(io_error)?;
            self.block_offsets.push(self.position);
            self.position += bytes;
        }
        Ok(())
    }
}

/// Returns the header of a file with the layout's channels in the order of `sources`.
fn header(layout: &ExrLayout, sources: &[usize]) -> io::Result<Header> {
    if sources.is_empty() || layout.data_window.size.contains(&0) || layout.display_window.size.contains(&0) {
        return Err(refusal("it has no pixels or no channels".into()));
    }
    let channel = |&source: &usize| {
        let channel = &layout.channels[source];
        Ok(ChannelDescription::new(
            name(&channel.name)?,
            channel.sample.to_exr(),
            false,
        ))
    };
    let channels: Vec<ChannelDescription> = sources.iter().map(channel).collect::<io::Result<_>>()?;
    let data = layout.data_window.bounds();
    Ok(Header::new(Text::from(""), data.size, channels.into())
        .with_encoding(
            layout.compression.to_exr(),
            BlockDescription::ScanLines,
            LineOrder::Increasing,
        )
        .with_display_window(layout.display_window.bounds())
        .with_attributes(attributes(layout.notes)?.with_position(data.position)))
}

/// Returns the attributes of a file, including the name of the software.
fn attributes(notes: &[Attribute]) -> io::Result<LayerAttributes> {
    let mut attributes = LayerAttributes {
        software_name: Some(Text::from(SOFTWARE)),
        ..LayerAttributes::default()
    };
    for note in notes {
        let ascii = note.text.replace(|c: char| !c.is_ascii(), "?");
        let text = AttributeValue::Text(Text::from(&ascii[..]));
        attributes.other.insert(name(note.name)?, text);
    }
    Ok(attributes)
}

/// Returns a valid name of a channel or of an attribute; rejects names that are empty or not ASCII.
fn name(name: &str) -> io::Result<Text> {
    Text::new_or_none(name)
        .filter(|_| name.is_ascii() && !name.is_empty())
        .ok_or_else(|| {
            refusal(format!(
                "`{name}` cannot be a name in this file: use ASCII letters"
            ))
        })
}

/// Returns the error for invalid input of the caller.
fn refusal(fault: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, fault)
}

/// Returns the bytes of the file before the offset table.
fn header_bytes(header: &Header) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut write = || {
        let requirements = MetaData::validate(slice::from_ref(header), true)?;
        magic_number::write(&mut bytes)?;
        requirements.write(&mut bytes)?;
        // Sort attributes by name, so that the bytes do not depend on a hash map
        let mut attributes: Vec<_> = header.all_named_attributes().collect();
        attributes.sort_by_key(|(name, _)| *name);
        for (name, value) in attributes {
            attribute::write(name, &value, &mut bytes)?;
        }
        sequence_end::write(&mut bytes)
    };
    write().map_err(io_error)?;
    Ok(bytes)
}

/// Converts an error of the `exr` crate; errors of the operating system are passed through.
fn io_error(error: exr::error::Error) -> io::Error {
    match error {
        exr::error::Error::Io(error) => error,
        other => io::Error::other(other),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Compression, ExrChannel, SampleType};
    use super::*;

    fn layout() -> ExrLayout<'static> {
        ExrLayout {
            compression: Compression::Zips,
            ..ExrLayout::of_size([4, 3], vec![ExrChannel::new("Y", SampleType::Float)])
        }
    }

    fn names_in(folder: &Path) -> Vec<String> {
        let names = std::fs::read_dir(folder).unwrap();
        names
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn unfinished_file_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let begun = || {
            let mut writer = ExrScanlineWriter::create(&path, &layout()).unwrap();
            writer.write_rows(&[Samples::from(vec![0.5f32; 8])]).unwrap();
            writer
        };
        drop(begun());
        let said = begun().finish().unwrap_err().to_string();
        assert!(said.ends_with("only 2 of 3 rows are there"), "{said}");
        assert_eq!(names_in(folder.path()), Vec::<String>::new());
    }

    #[test]
    fn mismatched_rows_are_rejected_without_change() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let mut writer = ExrScanlineWriter::create(&path, &layout()).unwrap();
        let mut said = |channels: &[Samples]| writer.write_rows(channels).unwrap_err().to_string();
        let refused = [
            (said(&[]), "values of 0 channels were given for 1"),
            (
                said(&[vec![0.0f32; 7].into()]),
                "channel Y has 7 values for rows of 4",
            ),
            (
                said(&[vec![0u32; 4].into()]),
                "channel Y was given values of another kind",
            ),
            (
                said(&[vec![0.0f32; 16].into()]),
                "more than its 3 rows were given",
            ),
        ];
        for (said, expected) in refused {
            assert_eq!(said, format!("could not write {}: {expected}", path.display()));
        }
        writer.write_rows(&[vec![0.5f32; 12].into()]).unwrap();
        writer.finish().unwrap();
        assert_eq!(names_in(folder.path()), ["a.exr"]);
    }

    #[test]
    fn invalid_layouts_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let channel = |name: &str| ExrChannel::new(name, SampleType::Float);
        // Layouts without pixels or with invalid names, and one that is too large
        let layouts = [
            ExrLayout::of_size([4, 3], Vec::new()),
            ExrLayout::of_size([0, 3], vec![channel("Y")]),
            ExrLayout::of_size([4, 3], vec![channel("Y"), channel("Y")]),
            ExrLayout::of_size([4, 3], vec![channel("Ü")]),
            ExrLayout::of_size([4, 3], vec![channel("")]),
            ExrLayout::of_size([4, u32::MAX], vec![channel("Y")]),
            ExrLayout {
                notes: &[Attribute {
                    name: "☂",
                    text: "rain",
                }],
                ..layout()
            },
            ExrLayout {
                notes: &[Attribute {
                    name: "dataWindow",
                    text: "all of it",
                }],
                ..layout()
            },
        ];
        for layout in layouts {
            let path = folder.path().join("a.exr");
            let said = ExrScanlineWriter::create(&path, &layout).unwrap_err().to_string();
            assert!(said.starts_with("could not write"), "{said}");
        }
        assert_eq!(names_in(folder.path()), Vec::<String>::new());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn full_disk_is_a_system_error() {
        // This device is always full.
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let error = RowEncoder::new(full, &layout()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    }
}
