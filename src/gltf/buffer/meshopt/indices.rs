//! Codec of index sequences: differences from one of two previous indices, each a number of variable length.

use std::hint::select_unpredictable;

use super::varint::{self, VarintFault};
use super::{MeshoptFault, StreamLayout, low_bytes};

/// First byte of a stream of version 1, the only one of the specification.
const HEADER: u8 = 0xd1;

/// Size of the padding at the end of a stream.
const TAIL: usize = 4;

/// Returns the length of the shortest stream of so many indices: one byte each.
pub(super) fn min_length(count: usize) -> usize {
    count.saturating_add(1 + TAIL)
}

/// Returns the indices of a stream that has at least [`min_length`] bytes.
pub(super) fn decode(layout: &StreamLayout, bytes: &[u8]) -> Result<Vec<u8>, MeshoptFault> {
    layout.check_header(bytes, HEADER)?;
    let codes = &bytes[1..bytes.len() - TAIL];
    match layout.stride {
        2 => decode_indices::<2>(layout.count, codes),
        _ => decode_indices::<4>(layout.count, codes),
    }
}

/// Decodes indices of `SIZE` bytes.
fn decode_indices<const SIZE: usize>(count: usize, mut codes: &[u8]) -> Result<Vec<u8>, MeshoptFault> {
    let [mut first, mut second] = [0u32; 2];
    let mut first_fault = None;
    // Indices behind a fault are decoded to anything: an iterator of known length fills memory without checks
    let indices: Vec<[u8; SIZE]> = (0..count)
        .map(|number| {
            let code = varint::read(&mut codes).unwrap_or_else(|fault| {
                first_fault.get_or_insert(fault_of(fault, number));
                0
            });
            // The lowest bit names the previous index, the others are the difference
            let is_second = code & 1 != 0;
            let previous = select_unpredictable(is_second, second, first);
            let index = previous.wrapping_add(varint::unzigzag(code >> 1));
            first = select_unpredictable(is_second, first, index);
            second = select_unpredictable(is_second, index, second);
            low_bytes(index)
        })
        .collect();
    match (first_fault, codes.len()) {
        (Some(fault), _) => Err(fault),
        (None, 0) => Ok(indices.into_flattened()),
        (None, length) => Err(MeshoptFault::Surplus { length }),
    }
}

/// Returns the fault of an index whose code cannot be read.
#[cold]
fn fault_of(fault: VarintFault, number: usize) -> MeshoptFault {
    let item = "index";
    match fault {
        VarintFault::Truncated => MeshoptFault::Truncated { item, number },
        VarintFault::Long => MeshoptFault::LongNumber { item, number },
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ElementFilter, StreamMode, decode};
    use super::*;

    /// Returns what a stream of `count` indices of 4 bytes decodes to.
    fn decoded(count: usize, bytes: &[u8]) -> Result<Vec<u32>, MeshoptFault> {
        let layout = StreamLayout {
            mode: StreamMode::Indices,
            filter: ElementFilter::None,
            count,
            stride: 4,
        };
        let bytes = decode(&layout, bytes)?;
        Ok(bytes
            .as_chunks()
            .0
            .iter()
            .map(|&b| u32::from_le_bytes(b))
            .collect())
    }

    #[test]
    fn differences_are_from_one_of_two_previous_indices() {
        // First: +5 = code 5 << 2; second: +1000 = 4001, in two bytes; first: -2 = (3 << 1) | 0; second: +1 = 5
        let bytes = [0xd1, 20, 0xa1, 0x1f, 6, 5, 0, 0, 0, 0];
        assert_eq!(decoded(4, &bytes), Ok(vec![5, 1000, 3, 1001]));
    }

    #[test]
    fn indices_of_two_bytes_wrap_around() {
        let layout = StreamLayout {
            mode: StreamMode::Indices,
            filter: ElementFilter::None,
            count: 1,
            stride: 2,
        };
        // 0 - 1 = 2^32 - 1
        assert_eq!(decode(&layout, &[0xd1, 2, 0, 0, 0, 0]), Ok(vec![0xff, 0xff]));
    }

    #[test]
    fn codes_fill_the_stream_exactly() {
        assert_eq!(
            decoded(1, &[0xd1, 4, 4, 0, 0, 0, 0]),
            Err(MeshoptFault::Surplus { length: 1 })
        );
        let truncated = MeshoptFault::Truncated {
            item: "index",
            number: 1,
        };
        assert_eq!(decoded(2, &[0xd1, 0x84, 0x01, 0, 0, 0, 0]), Err(truncated));
        // The first of three faults
        let first = MeshoptFault::Truncated {
            item: "index",
            number: 0,
        };
        assert_eq!(decoded(3, &[0xd1, 0x84, 0x84, 0x84, 0, 0, 0, 0]), Err(first));
    }

    #[test]
    fn older_versions_are_refused() {
        let expected = MeshoptFault::Header {
            mode: StreamMode::Indices,
            header: 0xd0,
        };
        assert_eq!(decoded(1, &[0xd0, 4, 0, 0, 0, 0]), Err(expected));
    }
}
