//! Reader for NRRD, "nearly raw raster data" (G. Kindlmann, teem.sourceforge.net/nrrd/format.html): header lines, an
//! empty line, then numbers; or the numbers in a separate file.
//!
//! Supported encodings are raw, gzip and text. Of four axes the first or the last is that of channels.

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;
use glam::{DAffine3, DMat3, DVec3};

use super::dtype::{ArrayAxis, ArrayLayout, ByteOrder, Element};
use super::fault::{ReadError, SAVE_AGAIN, THREE_AXES, VolumeFault, content, too_big};
use super::read_volume::{ReadVolume, bytes_of, grids};
use crate::volume::box_from_cube;

/// Largest header length in bytes that is searched for the empty line.
const MAX_HEADER: usize = 1 << 20;
/// Upper bound on deflate's compression ratio: 1032 to 1, and a little for the last block.
const MAX_DEFLATE_RATIO: u64 = 1033;

/// Encoding of the numbers in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NrrdEncoding {
    Raw,
    Gzip,
    Text,
}

/// Header fields that the reader uses.
#[derive(Debug, Default)]
struct NrrdHeader<'h> {
    element: Option<Element>,
    order: Option<ByteOrder>,
    encoding: Option<NrrdEncoding>,
    sizes: Vec<u64>,
    dimension: Option<usize>,
    spacings: Vec<f64>,
    directions: Vec<Option<DVec3>>,
    origin: Option<DVec3>,
    data_file: Option<&'h str>,
    line_skip: u64,
    /// Bytes before the numbers; `None` if these end the file.
    byte_skip: Option<u64>,
}

/// Reads the file at `path`, and the data file that its header names, if any.
pub(super) fn read(path: &Path, max_bytes: u64) -> Result<ReadVolume, ReadError> {
    let bytes = bytes_of(path, max_bytes)?;
    // Parse the header
    let (text, attached) = split(&bytes).map_err(|fault| content(path, fault))?;
    let header = parse(text).map_err(|fault| content(path, fault))?;
    let layout = header.layout().map_err(|fault| content(path, fault))?;
    let detached;
    // Load the detached data file, if there is one
    let (data_path, data) = match header.data_file {
        None => (path.to_owned(), attached),
        Some(name) => {
            let data_path = path.parent().unwrap_or(Path::new("")).join(name);
            detached = bytes_of(&data_path, max_bytes)?;
            (data_path, detached.as_slice())
        }
    };
    // Decode the numbers and build grids
    let numbers = header.numbers(&layout, data, max_bytes);
    let (layout, numbers) = numbers.map_err(|fault| content(&data_path, fault))?;
    grids(
        &data_path,
        &layout,
        &numbers,
        max_bytes,
        header.placement(&layout),
    )
}

/// Splits a file into the header's text and the bytes after its empty line.
fn split(bytes: &[u8]) -> Result<(&str, &[u8]), VolumeFault> {
    if !bytes.starts_with(b"NRRD000") {
        return Err(VolumeFault::new(
            "is not an NRRD file",
            "give a file that begins with NRRD000",
        ));
    }
    let mut end = 0;
    for line in bytes[..bytes.len().min(MAX_HEADER)].split_inclusive(|&byte| byte == b'\n') {
        end += line.len();
        if line == b"\n" || line == b"\r\n" {
            break;
        }
    }
    let text = std::str::from_utf8(&bytes[..end]);
    let text = text.map_err(|_| VolumeFault::new("has a header that is not text", SAVE_AGAIN))?;
    Ok((text, &bytes[end..]))
}

/// Parses the lines of the header after the magic line.
fn parse(text: &str) -> Result<NrrdHeader<'_>, VolumeFault> {
    let mut header = NrrdHeader {
        byte_skip: Some(0),
        ..NrrdHeader::default()
    };
    for line in text.lines().skip(1) {
        // Skip comments and key-value pairs of other programs.
        if line.starts_with('#') || line.contains(":=") {
            continue;
        }
        if let Some((field, value)) = line.split_once(": ") {
            let field = field.trim().to_ascii_lowercase();
            header.set(&field, value.trim())?;
        }
    }
    Ok(header)
}

impl<'h> NrrdHeader<'h> {
    /// Stores the value of one header field; unused fields are ignored.
    fn set(&mut self, field: &str, value: &'h str) -> Result<(), VolumeFault> {
        let wrong = || VolumeFault::new(format!("has the field {field}: {value:?}"), SAVE_AGAIN);
        let number = |word: &str| word.parse::<f64>().ok();
        match field {
            // Fields that determine the layout
            "type" => self.element = Some(element(value).ok_or_else(wrong)?),
            "dimension" => self.dimension = Some(value.parse().map_err(|_| wrong())?),
            "sizes" => {
                let sizes = value.split_whitespace().map(|size| size.parse().ok());
                self.sizes = sizes.collect::<Option<_>>().ok_or_else(wrong)?;
            }
            "endian" => {
                self.order = Some(match value {
                    "little" => ByteOrder::Little,
                    "big" => ByteOrder::Big,
                    _ => return Err(wrong()),
                });
            }
            "encoding" => {
                self.encoding = Some(match value.to_ascii_lowercase().as_str() {
                    "raw" => NrrdEncoding::Raw,
                    "gzip" | "gz" => NrrdEncoding::Gzip,
                    "text" | "txt" | "ascii" => NrrdEncoding::Text,
                    _ => {
                        let fault = format!("has the encoding {value:?}");
                        return Err(VolumeFault::new(fault, "save it as raw, gzip or text"));
                    }
                });
            }
            // Fields that determine the placement
            "spacings" => {
                let spacings = value.split_whitespace().map(number);
                self.spacings = spacings.collect::<Option<_>>().ok_or_else(wrong)?;
            }
            "space directions" => self.directions = directions(value).ok_or_else(wrong)?,
            "space origin" => self.origin = vector(value),
            // Fields that locate the numbers
            "data file" | "datafile" => {
                if value.starts_with("LIST") || value.contains('%') {
                    let fault = "spreads its numbers over several files";
                    return Err(VolumeFault::new(fault, "save it as one file"));
                }
                self.data_file = Some(value);
            }
            "line skip" | "lineskip" => self.line_skip = value.parse().map_err(|_| wrong())?,
            "byte skip" | "byteskip" => {
                self.byte_skip = match value {
                    "-1" => None,
                    _ => Some(value.parse().map_err(|_| wrong())?),
                };
            }
            // Ignore units, centres and axis names.
            _ => {}
        }
        Ok(())
    }

    /// Returns the layout of the numbers, from the required fields.
    fn layout(&self) -> Result<ArrayLayout, VolumeFault> {
        let missing = |field: &str| VolumeFault::new(format!("lacks the field {field:?}"), SAVE_AGAIN);
        let element = self.element.ok_or_else(|| missing("type"))?;
        let encoding = self.encoding.ok_or_else(|| missing("encoding"))?;
        let dimension = self.dimension.ok_or_else(|| missing("dimension"))?;
        if self.sizes.len() != dimension {
            return Err(missing("sizes"));
        }
        if self.order.is_none() && element.bytes() > 1 && encoding != NrrdEncoding::Text {
            return Err(missing("endian"));
        }
        // Assign roles to axes by their number and lengths
        let roles: &[ArrayAxis] = match self.sizes[..] {
            [_, _, _] => &[ArrayAxis::X, ArrayAxis::Y, ArrayAxis::Z],
            [1..=4, _, _, _] => &[ArrayAxis::Channel, ArrayAxis::X, ArrayAxis::Y, ArrayAxis::Z],
            [_, _, _, _] => &[ArrayAxis::X, ArrayAxis::Y, ArrayAxis::Z, ArrayAxis::Channel],
            _ => return Err(VolumeFault::new(format!("has {dimension} axes"), THREE_AXES)),
        };
        let axes: Vec<_> = roles.iter().copied().zip(self.sizes.iter().copied()).collect();
        ArrayLayout::new(element, self.order.unwrap_or_default(), &axes)
    }

    /// Decodes the numbers, and returns them with their layout after decoding.
    fn numbers<'d>(
        &self,
        layout: &ArrayLayout,
        data: &'d [u8],
        max_bytes: u64,
    ) -> Result<(ArrayLayout, std::borrow::Cow<'d, [u8]>), VolumeFault> {
        layout.check_memory(max_bytes)?;
        let mut data = data;
        // Skip leading lines
        for _ in 0..self.line_skip {
            let line = data.iter().position(|&byte| byte == b'\n');
            let Some(line) = line else {
                return Err(VolumeFault::new(
                    "has fewer lines than the header skips",
                    SAVE_AGAIN,
                ));
            };
            data = &data[line + 1..];
        }
        // Decode by encoding
        match self.encoding {
            Some(NrrdEncoding::Gzip) => {
                let bytes = inflate(layout, data, self.byte_skip.unwrap_or(0), max_bytes)?;
                Ok((layout.clone(), bytes.into()))
            }
            Some(NrrdEncoding::Text) => {
                let bytes = from_text(layout, data)?;
                let layout = ArrayLayout {
                    element: Element::F64,
                    order: ByteOrder::Little,
                    ..layout.clone()
                };
                Ok((layout, bytes.into()))
            }
            _ => {
                let at_end = (data.len() as u64).saturating_sub(layout.bytes());
                let skip = self.byte_skip.unwrap_or(at_end).min(data.len() as u64);
                Ok((layout.clone(), data[skip as usize..].into()))
            }
        }
    }

    /// Returns the placement of the cube [-1, 1]³, from directions and origin, or else from spacings.
    fn placement(&self, layout: &ArrayLayout) -> Option<DAffine3> {
        let mut steps: Vec<DVec3> = self.directions.iter().copied().flatten().collect();
        if steps.is_empty() {
            let spacings = self.spacings.iter().filter(|spacing| spacing.is_finite());
            let axes = [DVec3::X, DVec3::Y, DVec3::Z];
            steps = spacings
                .zip(axes)
                .map(|(&spacing, axis)| spacing * axis)
                .collect();
        }
        let [x, y, z] = steps[..] else {
            return None;
        };
        let [nx, ny, nz] = layout.size.map(|side| side as f64);
        // The origin is the centre of the first sample.
        let corner = self.origin.unwrap_or(0.5 * (x + y + z)) - 0.5 * (x + y + z);
        let world_from_box =
            DAffine3::from_mat3_translation(DMat3::from_cols(nx * x, ny * y, nz * z), corner);
        Some(world_from_box * box_from_cube()).filter(|map| map.is_finite())
    }
}

/// Decompresses as many numbers as `layout` has from a gzip stream, after its first `skip` bytes.
fn inflate(layout: &ArrayLayout, data: &[u8], skip: u64, max_bytes: u64) -> Result<Vec<u8>, VolumeFault> {
    // Reject sizes that the packed bytes cannot reach, before allocating
    let (wanted, packed) = (layout.bytes(), data.len() as u64);
    let max_inflated = packed.saturating_mul(MAX_DEFLATE_RATIO);
    if wanted.saturating_add(skip) > max_inflated {
        let fault = format!("is truncated: {packed} packed bytes cannot hold {wanted}");
        return Err(VolumeFault::new(fault, SAVE_AGAIN));
    }
    if wanted > max_bytes {
        return Err(too_big(wanted, max_bytes));
    }
    // Decompress, discarding the skipped bytes
    let damaged =
        |error: std::io::Error| VolumeFault::new(format!("has damaged gzip data ({error})"), SAVE_AGAIN);
    let mut stream = MultiGzDecoder::new(data);
    std::io::copy(&mut stream.by_ref().take(skip), &mut std::io::sink()).map_err(damaged)?;
    let mut bytes = Vec::new();
    stream.take(wanted).read_to_end(&mut bytes).map_err(damaged)?;
    Ok(bytes)
}

/// Parses the numbers of a text and returns them as little-endian bytes of f64.
fn from_text(layout: &ArrayLayout, data: &[u8]) -> Result<Vec<u8>, VolumeFault> {
    let count = layout.count();
    // Each number takes at least a digit and a separator.
    if count > data.len() as u64 / 2 + 1 {
        let fault = format!(
            "is truncated: {} bytes of text cannot hold {count} numbers",
            data.len()
        );
        return Err(VolumeFault::new(fault, SAVE_AGAIN));
    }
    let text = std::str::from_utf8(data)
        .map_err(|_| VolumeFault::new("has numbers that are not text", SAVE_AGAIN))?;
    let mut bytes = Vec::new();
    let words = text.split(|c: char| c.is_whitespace() || c == ',');
    for word in words.filter(|word| !word.is_empty()).take(count as usize) {
        let number = word.parse::<f64>();
        let number =
            number.map_err(|_| VolumeFault::new(format!("has {word:?} in place of a number"), SAVE_AGAIN))?;
        bytes.extend(number.to_le_bytes());
    }
    Ok(bytes)
}

/// Parses vectors in parentheses; `none` marks an axis that is not spatial.
fn directions(value: &str) -> Option<Vec<Option<DVec3>>> {
    let mut found = Vec::new();
    let mut rest = value.trim();
    while !rest.is_empty() {
        let after = if let Some(after) = rest.strip_prefix("none") {
            found.push(None);
            after
        } else {
            let (inside, after) = rest.strip_prefix('(')?.split_once(')')?;
            found.push(Some(components(inside)?));
            after
        };
        rest = after.trim_start();
    }
    Some(found)
}

/// Parses one vector in parentheses.
fn vector(value: &str) -> Option<DVec3> {
    components(value.strip_prefix('(')?.strip_suffix(')')?)
}

/// Parses three finite numbers separated by commas.
fn components(inside: &str) -> Option<DVec3> {
    let mut numbers = inside.split(',').map(|word| word.trim().parse::<f64>().ok());
    let vector = DVec3::new(numbers.next()??, numbers.next()??, numbers.next()??);
    (numbers.next().is_none() && vector.is_finite()).then_some(vector)
}

/// Returns the scalar type for any of its NRRD names.
fn element(name: &str) -> Option<Element> {
    Some(match name.to_ascii_lowercase().as_str() {
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Element::U8,
        "signed char" | "int8" | "int8_t" => Element::I8,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Element::U16,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Element::I16,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Element::U32,
        "int" | "signed int" | "int32" | "int32_t" => Element::I32,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => Element::U64,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => Element::I64,
        "half" | "float16" => Element::F16,
        "float" => Element::F32,
        "double" => Element::F64,
        _ => return None,
    })
}
