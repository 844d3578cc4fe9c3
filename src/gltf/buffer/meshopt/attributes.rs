//! Codec of vertex attributes: differences between the bytes of consecutive elements.
//!
//! A stream is a header, blocks of up to 256 elements, and a tail with the element that the first differences are
//! from. A block holds one plane per byte of the element: the codes of that byte of all its elements, in groups of 16
//! ([`super::byte_plane`]). Four planes are a channel, whose mode says what differences the codes stand for
//! ([`super::channel`]).

use super::byte_plane::{CodePlane, GROUP_SIZE, MAX_COUNT, Stream, Widths};
use super::channel::{AttributeChannel, ChannelMode, ChannelValues};
use super::instruction_set::{self, Computation, InstructionSet};
use super::{MeshoptFault, StreamLayout, StreamMode, filters};

/// Greatest size of an element in bytes.
pub(super) const MAX_STRIDE: usize = 256;

/// Number of bytes of a channel, which is what a channel mode is for.
const CHANNEL_SIZE: usize = 4;

/// Greatest number of decoded bytes of a block: 32 elements of 256 bytes.
const MAX_BLOCK_SIZE: usize = 8192;

/// Version of a stream, from its header.
#[derive(Clone, Copy, PartialEq)]
enum Version {
    /// Planes of codes of 0, 2, 4 or 8 bits.
    V0,
    /// Planes with a mode each, and channels with a mode each.
    V1,
}

impl Version {
    /// Returns the version of a stream.
    fn of(bytes: &[u8]) -> Result<Version, MeshoptFault> {
        match bytes.first() {
            // An empty stream is too short in either version
            None | Some(0xa0) => Ok(Version::V0),
            Some(0xa1) => Ok(Version::V1),
            Some(&header) => Err(MeshoptFault::Header {
                mode: StreamMode::Attributes,
                header,
            }),
        }
    }

    /// Returns the size of the modes of all channels: one byte each in the tail, and likewise in front of each block.
    fn modes_size(self, stride: usize) -> usize {
        match self {
            Version::V0 => 0,
            Version::V1 => stride / CHANNEL_SIZE,
        }
    }

    /// Returns the size of the tail without padding.
    fn tail_size(self, stride: usize) -> usize {
        stride + self.modes_size(stride)
    }

    /// Returns the size of the tail with the padding in front, which the specification sets.
    fn padded_tail_size(self, stride: usize) -> usize {
        let least = match self {
            Version::V0 => 32,
            Version::V1 => 24,
        };
        self.tail_size(stride).max(least)
    }

    /// Returns the size of the shortest block of so many elements.
    fn min_block_size(self, stride: usize, count: usize) -> usize {
        match self {
            // Every group of every plane is zero
            Version::V0 => stride * Stream::header_size(count),
            // Every plane is zero
            Version::V1 => self.modes_size(stride),
        }
    }
}

/// Returns the greatest number of elements of a block.
fn max_block_count(stride: usize) -> usize {
    (MAX_BLOCK_SIZE / stride / GROUP_SIZE * GROUP_SIZE).min(MAX_COUNT)
}

/// Returns the length of the shortest stream of the layout's elements in the version of `bytes`.
pub(super) fn min_length(layout: &StreamLayout, bytes: &[u8]) -> Result<usize, MeshoptFault> {
    let &StreamLayout { count, stride, .. } = layout;
    let version = Version::of(bytes)?;
    let block_count = max_block_count(stride);
    let whole_blocks = (count / block_count).saturating_mul(version.min_block_size(stride, block_count));
    let last_block = match count % block_count {
        0 => 0,
        rest => version.min_block_size(stride, rest),
    };
    Ok(whole_blocks.saturating_add(1 + last_block + version.padded_tail_size(stride)))
}

/// Returns the filtered elements of a stream that has at least [`min_length`] bytes.
pub(super) fn decode(layout: &StreamLayout, bytes: &[u8]) -> Result<Vec<u8>, MeshoptFault> {
    instruction_set::run(AttributeDecoder { layout, bytes })
}

/// Decoder of a stream of attributes.
struct AttributeDecoder<'a> {
    layout: &'a StreamLayout,
    bytes: &'a [u8],
}

impl Computation for AttributeDecoder<'_> {
    type Output = Result<Vec<u8>, MeshoptFault>;

    #[inline(always)]
    fn run<I: InstructionSet>(self, instructions: I) -> Result<Vec<u8>, MeshoptFault> {
        let AttributeDecoder { layout, bytes } = self;
        let &StreamLayout { count, stride, .. } = layout;
        // Find the tail
        let version = Version::of(bytes)?;
        let (_, tail) = bytes.split_at(bytes.len() - version.tail_size(stride));
        let (first, channel_modes) = tail.split_at(stride);
        let mut channels = channels(first, channel_modes)?;
        let tail_size = version.padded_tail_size(stride);
        // Decode each block
        let mut elements = Vec::new();
        elements
            .try_reserve_exact(count * stride)
            .map_err(|_| MeshoptFault::TooLarge { count, stride })?;
        let mut stream = Stream::new(&bytes[1..]);
        let mut block = [0; MAX_BLOCK_SIZE];
        let mut buffers = BlockBuffers {
            planes: [[0; MAX_COUNT]; CHANNEL_SIZE],
            values: [[0; MAX_COUNT]; BATCH_SIZE],
        };
        let block_count = max_block_count(stride);
        for (number, start) in (0..count).step_by(block_count).enumerate() {
            let block = &mut block[..block_count.min(count - start) * stride];
            let decoded = decode_block(
                instructions,
                &mut stream,
                version,
                &mut channels,
                &mut buffers,
                block,
            );
            if decoded.is_none() || stream.len() < tail_size {
                return Err(MeshoptFault::Truncated {
                    item: "vertex block",
                    number,
                });
            }
            filters::apply(layout, block);
            elements.extend_from_slice(block);
        }
        match stream.len() - tail_size {
            0 => Ok(elements),
            length => Err(MeshoptFault::Surplus { length }),
        }
    }
}

/// Returns the channels of an element; no modes stand for bytes in all channels.
fn channels(first: &[u8], modes: &[u8]) -> Result<Vec<AttributeChannel>, MeshoptFault> {
    let (first, _) = first.as_chunks::<CHANNEL_SIZE>();
    let modes = modes.iter().copied().chain(std::iter::repeat(0));
    let channels = first.iter().zip(modes).enumerate();
    channels
        .map(|(channel, (&bytes, mode))| {
            Ok(AttributeChannel {
                mode: ChannelMode::from_byte(mode).ok_or(MeshoptFault::ChannelMode { channel, mode })?,
                previous: u32::from_le_bytes(bytes),
            })
        })
        .collect()
}

/// Greatest number of channels whose values are interleaved at once.
const BATCH_SIZE: usize = 4;

/// Codes and values of a block.
struct BlockBuffers {
    /// Codes of one channel.
    planes: [CodePlane; CHANNEL_SIZE],
    /// Values of some channels.
    values: [ChannelValues; BATCH_SIZE],
}

/// Decodes the elements of one block; returns `None` if the stream ends before.
#[inline(always)]
fn decode_block(
    instructions: impl InstructionSet,
    stream: &mut Stream,
    version: Version,
    channels: &mut [AttributeChannel],
    BlockBuffers { planes, values }: &mut BlockBuffers,
    block: &mut [u8],
) -> Option<()> {
    let stride = channels.len() * CHANNEL_SIZE;
    let count = block.len() / stride;
    let mut modes = stream.take(version.modes_size(stride))?.iter();
    for (number, batch) in channels.chunks_mut(BATCH_SIZE).enumerate() {
        for (channel, values) in batch.iter_mut().zip(&mut *values) {
            // Unpack the channel's planes
            let modes = modes.next();
            for (place, plane) in planes.iter_mut().enumerate() {
                match modes.map(|modes| modes >> (2 * place) & 3) {
                    // Version 0 has no modes
                    None => stream.unpack(instructions, plane, count, Widths::V0)?,
                    Some(0) => stream.unpack(instructions, plane, count, Widths::V1Narrow)?,
                    Some(1) => stream.unpack(instructions, plane, count, Widths::V1Wide)?,
                    Some(2) => plane.fill(0),
                    Some(_) => plane[..count].copy_from_slice(stream.take(count)?),
                }
            }
            // Sum the differences up
            instructions.sum(channel.mode, channel.previous, planes, count, values);
            channel.previous = values[count - 1];
        }
        let start = number * BATCH_SIZE * CHANNEL_SIZE;
        match &values[..batch.len()] {
            [a] => interleave([a], block, stride, start),
            [a, b] => interleave([a, b], block, stride, start),
            [a, b, c] => interleave([a, b, c], block, stride, start),
            [a, b, c, d] => interleave([a, b, c, d], block, stride, start),
            _ => {}
        }
    }
    Some(())
}

/// Writes the values of `N` channels that follow each other to elements of `stride` bytes, from their place `start` on.
#[inline(always)]
fn interleave<const N: usize>(values: [&ChannelValues; N], block: &mut [u8], stride: usize, start: usize) {
    let size = N * CHANNEL_SIZE;
    if stride == size {
        // The compiler works on several elements at once, since none has other bytes
        let (words, _) = block.as_chunks_mut::<CHANNEL_SIZE>();
        let (elements, _) = words.as_chunks_mut::<N>();
        for (number, element) in elements.iter_mut().take(MAX_COUNT).enumerate() {
            for (word, values) in element.iter_mut().zip(values) {
                *word = values[number].to_le_bytes();
            }
        }
    } else {
        for (number, element) in block.chunks_exact_mut(stride).take(MAX_COUNT).enumerate() {
            let (words, _) = element[start..start + size].as_chunks_mut::<CHANNEL_SIZE>();
            for (word, values) in words.iter_mut().zip(values) {
                *word = values[number].to_le_bytes();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ElementFilter, decode};
    use super::*;

    fn layout(count: usize, stride: usize) -> StreamLayout {
        StreamLayout {
            mode: StreamMode::Attributes,
            filter: ElementFilter::None,
            count,
            stride,
        }
    }

    /// Normals of a box, four per side, as an exporter wrote them in version 0.
    const BOX_NORMALS: [u8; 62] = [
        0xa0, 0x05, 0x00, 0x00, 0xc0, 0xc0, 0xfe, 0xfd, 0xc0, 0xc0, 0x00, 0x00, 0xfd, 0x03, 0x05, 0x00, 0xc0,
        0xc0, 0xc0, 0xfd, 0xfe, 0xfe, 0xc0, 0xc0, 0x00, 0x00, 0xfd, 0xfe, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
        0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
        0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00, 0x7f, 0x00,
    ];

    /// Returns a stream of version 1 with one channel of this mode, which begins with zeros.
    fn one_channel(block: &[u8], mode: u8) -> Vec<u8> {
        [&[0xa1], block, &[0; 23], &[mode]].concat()
    }

    #[test]
    fn normals_of_a_box_are_decoded() {
        let layout = StreamLayout {
            filter: ElementFilter::Octahedral,
            ..layout(24, 4)
        };
        let sides = [
            [0, 0, 127],
            [0, -127, 0],
            [127, 0, 0],
            [0, 127, 0],
            [-127, 0, 0],
            [0, 0, -127],
        ];
        let decoded = decode(&layout, &BOX_NORMALS).unwrap();
        let normals = decoded
            .as_chunks()
            .0
            .iter()
            .map(|&[x, y, z, _]| [x, y, z].map(|c: u8| c as i8));
        assert!(normals.eq(sides.into_iter().flat_map(|side| [side; 4])));
    }

    #[test]
    fn planes_have_a_mode_each_in_version_1() {
        // Planes: literals; zeros; codes of 1 bit, both escapes; codes of 8 bits
        let mut block = vec![0b01_00_10_11, 2, 4];
        block.extend([0b01, 0b11, 0, 6, 8]);
        block.push(0b11);
        block.extend([1, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        // Zigzag codes 2 4, 6 8 and 1 3 are differences 1 2, 3 4 and -1 -2
        let decoded = decode(&layout(2, 4), &one_channel(&block, 0));
        assert_eq!(decoded, Ok(vec![1, 0, 3, 0xff, 3, 0, 7, 0xfd]));
    }

    #[test]
    fn blocks_continue_each_other() {
        // 257 elements: 256 literals of 2 (difference 1) in the first byte, then one more
        let mut block = vec![0b10_10_10_11];
        block.extend([2; 256]);
        block.extend([0b10_10_10_11, 4]);
        let decoded = decode(&layout(257, 4), &one_channel(&block, 1)).unwrap();
        assert_eq!(decoded[4 * 255..], [0, 1, 0, 0, 2, 1, 0, 0]);
    }

    #[test]
    fn streams_are_used_up_exactly() {
        let zeros = 0b10_10_10_10;
        assert_eq!(decode(&layout(16, 4), &one_channel(&[zeros], 0)), Ok(vec![0; 64]));
        let surplus = decode(&layout(16, 4), &one_channel(&[zeros, 0, 0], 0));
        assert_eq!(surplus, Err(MeshoptFault::Surplus { length: 2 }));
        // The last block's literals would be bytes of the tail, or behind it
        for (count, number) in [(2, 0), (300, 1)] {
            let block = [&[zeros][..number], &[0b10_10_10_11]].concat();
            let expected = MeshoptFault::Truncated {
                item: "vertex block",
                number,
            };
            assert_eq!(decode(&layout(count, 4), &one_channel(&block, 0)), Err(expected));
        }
    }

    #[test]
    fn undefined_channel_modes_and_versions_are_refused() {
        let expected = MeshoptFault::ChannelMode { channel: 0, mode: 3 };
        assert_eq!(decode(&layout(1, 4), &one_channel(&[0xaa], 3)), Err(expected));
        let expected = MeshoptFault::Header {
            mode: StreamMode::Attributes,
            header: 0xa2,
        };
        assert_eq!(decode(&layout(1, 4), &[0xa2; 99]), Err(expected));
    }

    #[test]
    fn shortest_streams_have_only_zeros() {
        // Version 1: a header, a byte per block of 256 elements, a tail of 24 bytes
        assert_eq!(min_length(&layout(1 << 20, 4), &[0xa1]), Ok(1 + 4096 + 24));
        // Version 0: four bytes per plane of 256 elements; of 32 elements of 256 bytes, one
        assert_eq!(min_length(&layout(1 << 20, 4), &[0xa0]), Ok(1 + 4096 * 16 + 32));
        assert_eq!(min_length(&layout(33, 256), &[0xa0]), Ok(1 + 2 * 256 + 256));
        let shortest = one_channel(&[0xaa], 0);
        assert_eq!(min_length(&layout(256, 4), &shortest), Ok(shortest.len()));
    }
}
