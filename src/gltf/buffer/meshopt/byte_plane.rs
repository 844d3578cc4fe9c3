//! Planes of vertex attributes: the code of one byte of all elements of a block, in groups of 16.
//!
//! A group has 16 codes of 0, 1, 2, 4 or 8 bits. The greatest code of 1, 2 or 4 bits is an escape: the group's next
//! literal, one of the bytes behind the codes, stands in its place.

use super::instruction_set::InstructionSet;

/// Number of elements of a group.
pub(super) const GROUP_SIZE: usize = 16;

/// Number of elements of the four groups that a byte of a plane's header is for.
const QUAD_SIZE: usize = 4 * GROUP_SIZE;

/// Greatest number of elements of a block.
pub(super) const MAX_COUNT: usize = 256;

/// Codes of one byte of all elements of a block.
pub(super) type CodePlane = [u8; MAX_COUNT];

/// Greatest number of bytes of a group: 16 codes of 4 bits and as many literals.
const MAX_GROUP_BYTES: usize = 24;

/// Bytes from a group's start on, of which it takes the first.
pub(super) type GroupBytes = [u8; MAX_GROUP_BYTES];

/// Numbers of bits of a code that a plane can have.
#[derive(Clone, Copy)]
pub(super) enum Widths {
    /// Widths in streams of version 0.
    V0,
    /// Widths in streams of version 1 for small codes.
    V1Narrow,
    /// Widths in streams of version 1 for large codes.
    V1Wide,
}

impl Widths {
    /// Returns the number of bits per value of a group's two header bits.
    pub(super) const fn bits(self) -> [u8; 4] {
        match self {
            Widths::V0 => [0, 2, 4, 8],
            Widths::V1Narrow => [0, 1, 2, 4],
            Widths::V1Wide => [1, 2, 4, 8],
        }
    }
}

/// Bytes of a stream that were not read yet.
pub(super) struct Stream<'a>(&'a [u8]);

impl<'a> Stream<'a> {
    /// Returns a stream of bytes that are read from the first on.
    pub(super) fn new(bytes: &'a [u8]) -> Stream<'a> {
        Stream(bytes)
    }

    /// Returns the number of bytes that were not read yet.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns the size of a plane's header: two bits per group, for so many elements.
    pub(super) fn header_size(count: usize) -> usize {
        count.div_ceil(QUAD_SIZE)
    }

    /// Reads bytes as they are; returns `None` if they are too few.
    #[inline(always)]
    pub(super) fn take(&mut self, size: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(size)?;
        self.0 = rest;
        Some(bytes)
    }

    /// Reads the codes of `count` elements, and of those that fill up the last group.
    ///
    /// The longest group must fit into the stream from each group's start on. The tail of a stream is long enough.
    #[inline(always)]
    pub(super) fn unpack(
        &mut self,
        instructions: impl InstructionSet,
        plane: &mut CodePlane,
        count: usize,
        widths: Widths,
    ) -> Option<()> {
        let header = self.take(Stream::header_size(count))?;
        let mut bytes = self.0;
        let mut groups_left = count.div_ceil(GROUP_SIZE);
        for (&header, quad) in header.iter().zip(plane.as_chunks_mut::<QUAD_SIZE>().0) {
            match (header, widths.bits()) {
                // Many quads have zeros only, or no escapes
                (0, [0, ..]) => *quad = [0; QUAD_SIZE],
                (0xff, [.., 8]) if groups_left >= 4 => {
                    let (literals, rest) = bytes.split_first_chunk()?;
                    *quad = *literals;
                    bytes = rest;
                }
                _ => {
                    let (groups, _) = quad.as_chunks_mut::<GROUP_SIZE>();
                    for (place, group) in groups.iter_mut().take(groups_left).enumerate() {
                        let header_bits = header >> (2 * place) & 3;
                        let window = bytes.first_chunk()?;
                        let length = instructions.unpack_group(window, widths, header_bits, group)?;
                        bytes = bytes.get(length..)?;
                    }
                }
            }
            groups_left = groups_left.saturating_sub(4);
        }
        self.0 = bytes;
        Some(())
    }
}

/// Unpacks the codes of a group of `width` bits each and returns the number of bytes that they take.
#[inline(always)]
pub(super) fn unpack_group(bytes: &GroupBytes, width: u8, group: &mut [u8; GROUP_SIZE]) -> Option<usize> {
    match width {
        0 => {
            *group = [0; GROUP_SIZE];
            Some(0)
        }
        1 => unpack_codes::<1>(bytes, group),
        2 => unpack_codes::<2>(bytes, group),
        4 => unpack_codes::<4>(bytes, group),
        _ => {
            group.copy_from_slice(&bytes[..GROUP_SIZE]);
            Some(GROUP_SIZE)
        }
    }
}

/// Unpacks codes of `BITS` bits, with literals in place of escapes, and returns the number of bytes that they take.
///
/// Works on the bytes of 64-bit words, without a branch: where escapes are cannot be predicted.
#[inline(always)]
fn unpack_codes<const BITS: usize>(
    bytes: &[u8; MAX_GROUP_BYTES],
    group: &mut [u8; GROUP_SIZE],
) -> Option<usize> {
    // Find codes and escapes of either half
    let packed = u64::from_le_bytes(*bytes.first_chunk()?);
    let codes = [packed, packed >> (LANES * BITS)].map(spread::<BITS>);
    let escapes = codes.map(|codes| (codes + EACH_LANE) >> BITS & EACH_LANE);
    let counts = escapes.map(|escapes| (escapes.wrapping_mul(EACH_LANE) >> HIGHEST_LANE) as usize);
    // Move either half's literals to its escapes
    let start = 2 * BITS;
    let middle = start + counts[0];
    let starts = [start, middle];
    for (half, place) in group.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let literals = u64::from_le_bytes(*bytes.get(starts[half]..)?.first_chunk()?);
        let literals = expand(literals, escapes[half]);
        // All bits of the bytes that are escapes
        let mask = (escapes[half] << 8).wrapping_sub(escapes[half]);
        *place = (codes[half] ^ (codes[half] ^ literals) & mask).to_le_bytes();
    }
    Some(middle + counts[1])
}

/// Number of codes that a word holds, one a byte.
const LANES: usize = 8;

/// Lowest bit of each byte of a word. A product with it has the sum of all bytes in the highest.
const EACH_LANE: u64 = 0x0101_0101_0101_0101;

/// Place of the highest byte's lowest bit.
const HIGHEST_LANE: u32 = 56;

/// Factor that moves the lowest bits of eight bytes into the highest byte, in their order.
const GATHER: u64 = 0x0102_0408_1020_4080;

/// Spreads the lowest eight codes of `BITS` bits to a byte each, the first code to the lowest byte.
///
/// The first code of a byte has the lowest bit of codes of 1 bit, but the highest bits of others.
#[inline(always)]
fn spread<const BITS: usize>(packed: u64) -> u64 {
    match BITS {
        1 => {
            // In each byte its own bit of a copy, and then the carry into the highest bit
            let bits = (packed & 0xff).wrapping_mul(EACH_LANE) & 0x8040_2010_0804_0201;
            (bits + 0x7f7f_7f7f_7f7f_7f7f) >> 7 & EACH_LANE
        }
        2 => {
            let fours = packed & 0xff | (packed & 0xff00) << 24;
            let pairs = fours >> 4 & 0x0000_000f_0000_000f | fours << 16 & 0x000f_0000_000f_0000;
            pairs >> 2 & 0x0003_0003_0003_0003 | pairs << 8 & 0x0300_0300_0300_0300
        }
        _ => {
            let fours = packed & 0xffff | (packed & 0xffff_0000) << 16;
            let pairs = (fours | fours << 8) & 0x00ff_00ff_00ff_00ff;
            pairs >> 4 & 0x000f_000f_000f_000f | pairs << 8 & 0x0f00_0f00_0f00_0f00
        }
    }
}

/// Moves the lowest bytes of a word to the bytes that are escapes, in order; the other bytes are arbitrary.
///
/// Source of the method: Warren, Hacker's Delight, section 7-5 ("expand"), with its moves in a table.
#[inline(always)]
fn expand(literals: u64, escapes: u64) -> u64 {
    let [by_4, by_2, by_1] = &MOVES[(escapes.wrapping_mul(GATHER) >> HIGHEST_LANE) as usize];
    let mut bytes = literals;
    bytes ^= (bytes ^ bytes << 32) & by_4;
    bytes ^= (bytes ^ bytes << 16) & by_2;
    bytes ^= (bytes ^ bytes << 8) & by_1;
    bytes
}

/// Places to which bytes move by 4, then by 2, then by 1, for each set of eight places that they go to at last.
static MOVES: [[u64; 3]; 256] = {
    let mut table = [[0; 3]; 256];
    let mut set = 0;
    while set < table.len() {
        let mut rank = 0;
        let mut place = 0;
        while place < LANES {
            if set >> place & 1 != 0 {
                let distance = place - rank;
                let after_4 = rank + (distance & 4);
                let after_2 = after_4 + (distance & 2);
                if distance & 4 != 0 {
                    table[set][0] |= 0xff << (8 * after_4);
                }
                if distance & 2 != 0 {
                    table[set][1] |= 0xff << (8 * after_2);
                }
                if distance & 1 != 0 {
                    table[set][2] |= 0xff << (8 * place);
                }
                rank += 1;
            }
            place += 1;
        }
        set += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::super::instruction_set::Portable;
    use super::*;

    /// Returns the codes of one group of a width, and the number of bytes that it takes.
    fn unpacked(width: u8, bytes: &[u8]) -> ([u8; GROUP_SIZE], usize) {
        let mut window = [0xee; MAX_GROUP_BYTES];
        window[..bytes.len()].copy_from_slice(bytes);
        let mut group = [0xdd; GROUP_SIZE];
        let length = unpack_group(&window, width, &mut group).unwrap();
        (group, length)
    }

    #[test]
    fn codes_of_four_bits_are_those_of_the_specification() {
        let bytes = [0x17, 0x5f, 0xf0, 0xbc, 0x77, 0xa9, 0x21, 0x00, 0x34, 0xb5];
        let codes = [1, 7, 5, 0x34, 0xb5, 0, 11, 12, 7, 7, 10, 9, 2, 1, 0, 0];
        assert_eq!(unpacked(4, &bytes), (codes, 10));
    }

    #[test]
    fn codes_of_two_bits_begin_with_the_highest() {
        // 0b00011011 = 0, 1, 2 and an escape; 0b11000000 = an escape and zeros
        let bytes = [0b0001_1011, 0, 0, 0b1100_0000, 90, 91];
        let codes = [0, 1, 2, 90, 0, 0, 0, 0, 0, 0, 0, 0, 91, 0, 0, 0];
        assert_eq!(unpacked(2, &bytes), (codes, 6));
    }

    #[test]
    fn codes_of_one_bit_begin_with_the_lowest() {
        let codes = [0, 70, 71, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 72];
        assert_eq!(unpacked(1, &[0b0000_0110, 0b1000_0000, 70, 71, 72]), (codes, 5));
    }

    #[test]
    fn codes_of_eight_bits_have_no_escapes() {
        assert_eq!(unpacked(8, &[255; 16]), ([255; 16], 16));
        assert_eq!(unpacked(0, &[]), ([0; 16], 0));
    }

    #[test]
    fn a_group_of_escapes_is_its_literals() {
        let literals: [u8; 16] = std::array::from_fn(|place| 100 + place as u8);
        for width in [1, 2, 4] {
            let size = 2 * usize::from(width);
            let bytes = [&[0xff; 8][..size], &literals].concat();
            assert_eq!(unpacked(width, &bytes), (literals, size + 16));
        }
    }

    #[test]
    fn literals_go_to_any_set_of_escapes() {
        for set in 0..=255u8 {
            let escapes = u64::from_le_bytes(std::array::from_fn(|place| set >> place & 1));
            let bytes = expand(0x0807_0605_0403_0201, escapes).to_le_bytes();
            let expanded: Vec<u8> = (0..8)
                .filter(|place| set >> place & 1 != 0)
                .map(|place| bytes[place])
                .collect();
            assert!(
                expanded.into_iter().eq(1..=set.count_ones() as u8),
                "set {set:#b}"
            );
        }
    }

    #[test]
    fn groups_have_two_header_bits_each() {
        // 20 elements: a group of zeros, and one of 8 bits a code; both fit a group into the stream
        let mut bytes = vec![0b1100];
        bytes.extend(1..=16);
        bytes.resize(40, 0);
        let mut stream = Stream::new(&bytes);
        let mut plane = [9; MAX_COUNT];
        assert_eq!(stream.unpack(Portable, &mut plane, 20, Widths::V0), Some(()));
        assert_eq!(stream.len(), 40 - 17);
        assert_eq!(plane[15..21], [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn streams_that_end_early_have_no_group() {
        let mut plane = [0; MAX_COUNT];
        assert_eq!(
            Stream::new(&[1; 24]).unpack(Portable, &mut plane, 1, Widths::V0),
            None
        );
        assert_eq!(
            Stream::new(&[1; 25]).unpack(Portable, &mut plane, 1, Widths::V0),
            Some(())
        );
        assert_eq!(Stream::new(&[]).take(1), None);
    }
}
