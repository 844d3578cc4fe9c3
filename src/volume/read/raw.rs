//! Reader for raw numbers without a header, described by the caller.

use std::path::Path;

use super::dtype::{ArrayAxis, ArrayLayout, ByteOrder, Element};
use super::fault::{ReadError, VolumeFault, content};
use super::read_volume::{ReadVolume, bytes_of, grids};

/// Description of a file of raw numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawHeader {
    /// Numbers of samples along x, y, z; x runs fastest.
    pub size: [usize; 3],
    /// Interleaved channels of a sample: 1 to 4.
    pub channels: usize,
    /// Scalar type of each number.
    pub element: Element,
    /// Byte order of each number.
    pub order: ByteOrder,
    /// Number of bytes before the first number.
    pub skip: u64,
}

/// Reads the numbers at `path` in the format of `header`. Neither they nor the file may take more than `max_bytes` of
/// memory.
pub fn read_raw(path: &Path, header: &RawHeader, max_bytes: u64) -> Result<ReadVolume, ReadError> {
    let [x, y, z] = header.size.map(|side| side as u64);
    let axes = [
        (ArrayAxis::Channel, header.channels as u64),
        (ArrayAxis::X, x),
        (ArrayAxis::Y, y),
        (ArrayAxis::Z, z),
    ];
    let layout =
        ArrayLayout::new(header.element, header.order, &axes).map_err(|fault| content(path, fault))?;
    let bytes = bytes_of(path, max_bytes)?;
    // Skip the bytes before the first number
    let skip = usize::try_from(header.skip).ok();
    let Some(data) = skip.and_then(|skip| bytes.get(skip..)) else {
        let fault = format!("is shorter than the {} bytes to skip", header.skip);
        return Err(content(
            path,
            VolumeFault::new(fault, "give the number of bytes before the first sample"),
        ));
    };
    grids(path, &layout, data, max_bytes, None)
}
