//! Codec of index sequences: differences from one of two previous indices, each a number of variable length.

use super::varint::{self, VarintFault};
use super::{MeshoptFault, StreamLayout};

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
    let mut output = vec![0; layout.count * layout.stride];
    let rest = match layout.stride {
        2 => decode_into::<2>(output.as_chunks_mut().0, codes),
        _ => decode_into::<4>(output.as_chunks_mut().0, codes),
    }?;
    if !rest.is_empty() {
        return Err(MeshoptFault::Surplus { length: rest.len() });
    }
    Ok(output)
}

/// Decodes one index per element of `SIZE` bytes and returns the codes that are left.
fn decode_into<'a, const SIZE: usize>(
    output: &mut [[u8; SIZE]],
    mut codes: &'a [u8],
) -> Result<&'a [u8], MeshoptFault> {
    let mut previous = [0u32; 2];
    for (number, element) in output.iter_mut().enumerate() {
        let code = varint::read(&mut codes).map_err(|fault| fault_of(fault, number))?;
        // The lowest bit names the previous index, the others are the difference
        let previous = &mut previous[(code & 1) as usize];
        *previous = previous.wrapping_add(varint::unzigzag(code >> 1));
        element.copy_from_slice(&previous.to_le_bytes()[..SIZE]);
    }
    Ok(codes)
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
