//! Raw numbers, which somebody else must say the meaning of.

use std::path::Path;

use super::dtype::{Axis, ByteOrder, Element, Layout};
use super::{Fault, ReadError, ReadVolume, bytes_of, content, grids};

/// What a file of raw numbers holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawHeader {
    /// Samples along x, y, z; x runs fastest.
    pub size: [usize; 3],
    /// Numbers a sample, one after the other: 1 to 4.
    pub channels: usize,
    /// The type of each number.
    pub element: Element,
    /// The order of its bytes.
    pub order: ByteOrder,
    /// Bytes before the first number.
    pub skip: u64,
}

/// Reads the numbers at `path` as `header` says. Neither they nor the file may take more than `max_bytes` of memory.
pub fn read_raw(path: &Path, header: &RawHeader, max_bytes: u64) -> Result<ReadVolume, ReadError> {
    let [x, y, z] = header.size.map(|side| side as u64);
    let axes = [
        (Axis::Channel, header.channels as u64),
        (Axis::X, x),
        (Axis::Y, y),
        (Axis::Z, z),
    ];
    let layout = Layout::new(header.element, header.order, &axes).map_err(|fault| content(path, fault))?;
    let bytes = bytes_of(path, max_bytes)?;
    let skip = usize::try_from(header.skip).ok();
    let Some(data) = skip.and_then(|skip| bytes.get(skip..)) else {
        let fault = format!("is shorter than the {} bytes to skip", header.skip);
        return Err(content(
            path,
            Fault::new(fault, "give the number of bytes before the first sample"),
        ));
    };
    grids(path, &layout, data, max_bytes, None)
}
