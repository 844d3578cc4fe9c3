//! Streaming scanline writer for PNG files, with atomic replacement of the target.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use ::png::StreamWriter;

use super::super::atomic_file::{AtomicFile, write_error};
use super::super::png::{self, PngChannels, PngEncoding, io_error};
use super::super::{Attribute, ImageError};

/// Writer of a PNG row by row, from top to bottom.
///
/// The file appears when [`PngScanlineWriter::finish`] returns; dropped before that, the writer leaves no file.
pub struct PngScanlineWriter {
    path: PathBuf,
    encoding: PngEncoding,
    row_pixels: usize,
    rows_left: u32,
    channels: PngChannels,
    encoder: StreamWriter<'static, png::Sink<'static>>,
    /// Output of the encoder, shared to retrieve the file and its first error.
    output: PngOutput,
}

impl PngScanlineWriter {
    /// Creates a temporary file beside `path` for an image of `size`, width and height, and writes the header.
    ///
    /// # Errors
    ///
    /// If the folder is not writable, there are no pixels, or an attribute's name is invalid in a PNG.
    pub fn create(
        path: &Path,
        size: [u32; 2],
        encoding: PngEncoding,
        notes: &[Attribute],
    ) -> Result<PngScanlineWriter, ImageError> {
        PngScanlineWriter::create_with(path, size, PngChannels::Rgb, encoding, notes)
    }

    /// Creates a file as [`PngScanlineWriter::create`] does, for pixels with these channels.
    ///
    /// # Errors
    ///
    /// If the folder is not writable, there are no pixels, or an attribute's name is invalid in a PNG.
    pub fn create_with(
        path: &Path,
        size: [u32; 2],
        channels: PngChannels,
        encoding: PngEncoding,
        notes: &[Attribute],
    ) -> Result<PngScanlineWriter, ImageError> {
        let begin = || {
            let output = PngOutput::new(AtomicFile::create(path)?);
            let header = encoding.begin(Box::new(output.clone()), size, channels, notes)?;
            Ok((header.into_stream_writer().map_err(io_error)?, output))
        };
        let (encoder, output) = begin().map_err(|error: io::Error| write_error(path, &error))?;
        Ok(PngScanlineWriter {
            path: path.to_owned(),
            encoding,
            row_pixels: size[0] as usize,
            rows_left: size[1],
            channels,
            encoder,
            output,
        })
    }

    /// Appends the next rows, given as linear pixels.
    ///
    /// # Errors
    ///
    /// If rows are incomplete or exceed the image's height, the file has alpha, or the disk is full.
    pub fn write_rows(&mut self, pixels: &[[f32; 3]]) -> Result<(), ImageError> {
        self.write_codes(pixels, PngChannels::Rgb, |encoding| encoding.codes(pixels))
    }

    /// Appends the next rows, given as premultiplied linear pixels and their coverage.
    ///
    /// # Errors
    ///
    /// If rows are incomplete or exceed the image's height, the file has no alpha, or the disk is full.
    pub fn write_rows_with_alpha(&mut self, pixels: &[[f32; 3]], alpha: &[f32]) -> Result<(), ImageError> {
        self.write_codes(pixels, PngChannels::Rgba, |encoding| {
            encoding.codes_with_alpha(pixels, alpha)
        })
    }

    /// Appends the rows of `pixels`, whose sample bytes `codes` returns.
    fn write_codes(
        &mut self,
        pixels: &[[f32; 3]],
        channels: PngChannels,
        codes: impl FnOnce(&PngEncoding) -> Vec<u8>,
    ) -> Result<(), ImageError> {
        let rows = pixels.len() / self.row_pixels;
        // Check that whole rows are given, and no more than are left
        let result = if !pixels.len().is_multiple_of(self.row_pixels) || rows > self.rows_left as usize {
            let (width, left) = (self.row_pixels, self.rows_left);
            let fault = format!(
                "{} pixels were given where {left} rows of {width} are left",
                pixels.len()
            );
            Err(io::Error::new(io::ErrorKind::InvalidInput, fault))
        } else if channels != self.channels {
            let fault = format!("{channels:?} pixels were given for a file of {:?}", self.channels);
            Err(io::Error::new(io::ErrorKind::InvalidInput, fault))
        } else {
            self.rows_left -= rows as u32;
            self.encoder.write_all(&codes(&self.encoding))
        };
        result.map_err(|error| write_error(&self.path, &error))
    }

    /// Completes the file, syncs it to disk and renames it to its final path.
    ///
    /// # Errors
    ///
    /// If rows are missing or the disk is full.
    pub fn finish(self) -> Result<(), ImageError> {
        let PngScanlineWriter {
            path,
            rows_left,
            encoder,
            output,
            ..
        } = self;
        let end = || {
            if rows_left > 0 {
                return Err(io::Error::other(format!("{rows_left} rows are missing")));
            }
            // The encoder writes its last chunk when it is dropped and cannot report errors of that: `output` records
            // them.
            encoder.finish().map_err(io_error)?;
            output.close()?.commit()
        };
        end().map_err(|error| write_error(&path, &error))
    }
}

/// Shared output file: gives access to a file that the encoder owns, and to the first error that the encoder may drop.
#[derive(Clone)]
struct PngOutput(Arc<Mutex<(Option<AtomicFile>, Option<io::Error>)>>);

impl PngOutput {
    fn new(file: AtomicFile) -> PngOutput {
        PngOutput(Arc::new(Mutex::new((Some(file), None))))
    }

    /// Returns the file, or the first error of writing to it.
    fn close(self) -> io::Result<AtomicFile> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match (state.0.take(), state.1.take()) {
            (Some(file), None) => Ok(file),
            (_, fault) => Err(fault.unwrap_or_else(|| io::Error::other("it is closed"))),
        }
    }
}

impl Write for PngOutput {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (file, fault) = &mut *state;
        let file = file.as_mut().ok_or_else(|| io::Error::other("it is closed"))?;
        let result = file.write(bytes);
        if let Err(error) = &result
            && error.kind() != io::ErrorKind::Interrupted
        {
            // Record the first error; io::Error is not Clone
            let again = error.raw_os_error().map(io::Error::from_raw_os_error);
            fault.get_or_insert(again.unwrap_or_else(|| io::Error::other(error.to_string())));
        }
        result
    }

    fn flush(&mut self) -> io::Result<()> {
        // The file flushes its buffer when it is committed.
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{LinearImage, PngBits, ToneMap, write_png_with};
    use super::*;

    #[test]
    fn rows_give_the_same_png_as_a_whole_image() {
        let folder = tempfile::tempdir().unwrap();
        let mut image = LinearImage::black(7, 50);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            *pixel = [i as f32 / 350.0, 0.5, 1.5 - i as f32 / 200.0];
        }
        let notes = [Attribute {
            name: "whit.plan",
            text: "shadow on",
        }];
        for bits in [PngBits::Eight, PngBits::Sixteen] {
            let tone = ToneMap { exposure_ev: 0.5 };
            let encoding = PngEncoding {
                tone,
                bits,
                ..PngEncoding::default()
            };
            let [whole, path] = ["whole.png", "rows.png"].map(|name| folder.path().join(name));
            write_png_with(&image, encoding, &notes, &whole).unwrap();
            let mut writer = PngScanlineWriter::create(&path, [7, 50], encoding, &notes).unwrap();
            for pixels in [&image.pixels[..7], &image.pixels[7..7], &image.pixels[7..]] {
                writer.write_rows(pixels).unwrap();
            }
            writer.finish().unwrap();
            let read = |path: &Path| image::open(path).unwrap();
            assert_eq!(read(&path), read(&whole));
            let bytes = std::fs::read(&path).unwrap();
            // Length, name and checksum of the last chunk.
            assert_eq!(bytes[bytes.len() - 12..], *b"\0\0\0\0IEND\xae\x42\x60\x82");
            std::fs::remove_file(path).unwrap();
        }
    }

    #[test]
    fn missing_or_invalid_rows_leave_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let begin = || PngScanlineWriter::create(&path, [3, 2], PngEncoding::default(), &[]).unwrap();
        let mut writer = begin();
        writer.write_rows(&[[0.5; 3]; 3]).unwrap();
        let said = writer.write_rows(&[[0.5; 3]; 4]).unwrap_err().to_string();
        assert!(
            said.ends_with("4 pixels were given where 1 rows of 3 are left"),
            "{said}"
        );
        writer.write_rows(&[[0.5; 3]; 6]).unwrap_err();
        let said = writer.finish().unwrap_err().to_string();
        assert!(said.ends_with("1 rows are missing"), "{said}");
        drop(begin());
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
        assert!(PngScanlineWriter::create(&path, [0, 2], PngEncoding::default(), &[]).is_err());
    }
}
