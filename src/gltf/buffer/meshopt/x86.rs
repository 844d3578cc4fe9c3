//! Codec of vertex attributes for processors with AVX2.

use std::arch::x86_64::__m128i;

use bytemuck::cast;
use pulp::NullaryFnOnce;
use pulp::x86::V3;

use super::byte_plane::{CodePlane, GROUP_SIZE, GroupBytes, Widths};
use super::channel::{ChannelMode, ChannelValues};
use super::instruction_set::{Computation, InstructionSet};

/// How a group's codes of one width are unpacked.
///
/// All widths go through the same instructions: the width of the next group can often not be predicted. A group of 8
/// bits a code is unpacked as codes of no bits that are all escapes.
struct GroupFormat {
    /// Place of the byte that each code is in. The two of a pair of codes are equal.
    spread: [u8; GROUP_SIZE],
    /// Factors that move each pair's first code to the lowest bits of a third byte.
    first_factors: [u16; GROUP_SIZE / 2],
    /// Factors that move each pair's second code to the lowest bits of the second byte.
    second_factors: [u16; GROUP_SIZE / 2],
    /// The escape: all bits of a code. If there are no escapes, 1, where all codes are 0.
    escape: [u8; GROUP_SIZE],
    /// Lowest bits of all codes that may be escapes, as they are packed.
    lowest_bits: u64,
    /// Distances to move packed codes by one after the other, so that each time the bits of a code that are set there
    /// and before are found; then the lowest bit of a code says whether all are set.
    shifts: [u8; 2],
    /// Number of bytes in front of the literals.
    literals_start: u8,
    /// Number of bytes of a group without escapes.
    size: u8,
}

impl GroupFormat {
    /// Returns the format of codes of so many bits.
    const fn new(bits: u8) -> GroupFormat {
        let mut format = GroupFormat {
            spread: [0; GROUP_SIZE],
            first_factors: [0; GROUP_SIZE / 2],
            second_factors: [0; GROUP_SIZE / 2],
            escape: [1; GROUP_SIZE],
            lowest_bits: 0,
            shifts: [0; 2],
            literals_start: 0,
            size: 0,
        };
        match bits {
            0 => return format,
            8 => {
                format.escape = [0; GROUP_SIZE];
                format.size = GROUP_SIZE as u8;
                return format;
            }
            1 => {}
            2 => format.shifts = [1, 0],
            _ => format.shifts = [1, 2],
        }
        // Literals follow the codes
        format.literals_start = 2 * bits;
        format.size = 2 * bits;
        let codes_per_byte = 8 / bits as usize;
        let mut place = 0;
        while place < GROUP_SIZE {
            format.spread[place] = (place / codes_per_byte) as u8;
            format.escape[place] = (1 << bits) - 1;
            let number = place % codes_per_byte;
            // Codes of 1 bit begin with the lowest bit of a byte, others with the highest
            let shift = match bits {
                1 => number,
                _ => 8 - (number + 1) * bits as usize,
            };
            let factors = match place % 2 {
                0 => &mut format.first_factors,
                _ => &mut format.second_factors,
            };
            factors[place / 2] = 1 << (8 - shift);
            format.lowest_bits |= 1 << (bits as usize * place);
            place += 1;
        }
        format
    }
}

/// Formats of all widths.
static FORMATS: [[GroupFormat; 4]; 3] = {
    let [a, b, c] = [Widths::V0.bits(), Widths::V1Narrow.bits(), Widths::V1Wide.bits()];
    [formats(a), formats(b), formats(c)]
};

/// Returns the formats of four widths.
const fn formats([a, b, c, d]: [u8; 4]) -> [GroupFormat; 4] {
    [
        GroupFormat::new(a),
        GroupFormat::new(b),
        GroupFormat::new(c),
        GroupFormat::new(d),
    ]
}

/// Index that stands for a zero in a shuffle.
const NO_BYTE: u8 = 0x80;

/// Rank of each place of eight among those of a set; [`NO_BYTE`] of others.
static RANKS: [[u8; 8]; 256] = {
    let mut table = [[NO_BYTE; 8]; 256];
    let mut set = 0;
    while set < table.len() {
        let mut rank = 0;
        let mut place = 0;
        while place < 8 {
            if set >> place & 1 != 0 {
                table[set][place] = rank;
                rank += 1;
            }
            place += 1;
        }
        set += 1;
    }
    table
};

impl InstructionSet for V3 {
    /// Source of the method: meshoptimizer (Arseny Kapoulkine), `decodeBytesGroupSimd` in `vertexcodec.cpp`.
    #[inline(always)]
    fn unpack_group(
        self,
        bytes: &GroupBytes,
        widths: Widths,
        header_bits: u8,
        group: &mut [u8; GROUP_SIZE],
    ) -> Option<usize> {
        let V3 { sse2, ssse3, .. } = self;
        let format = &FORMATS[widths as usize][usize::from(header_bits & 3)];
        let packed = u64::from_le_bytes(*bytes.first_chunk()?);
        // Count the escapes apart from the rest: the next group waits for the place where it begins
        let ones = packed & packed >> format.shifts[0];
        let escape_bits = (ones & format.lowest_bits) & ones >> format.shifts[1];
        let length = usize::from(format.size) + escape_bits.count_ones() as usize;
        // Give each code a copy of its byte, and move the code to the lowest bits
        let pairs = ssse3._mm_shuffle_epi8(cast([packed, 0]), cast(format.spread));
        let first = sse2._mm_mulhi_epu16(pairs, cast(format.first_factors));
        let second = sse2._mm_mullo_epi16(pairs, cast(format.second_factors));
        let second = sse2._mm_and_si128(second, sse2._mm_set1_epi16(i16::from_ne_bytes([0, 0xff])));
        let escape = cast(format.escape);
        let codes = sse2._mm_and_si128(sse2._mm_or_si128(first, second), escape);
        // Find which literal each escape stands for
        let is_escape = sse2._mm_cmpeq_epi8(codes, escape);
        let set = sse2._mm_movemask_epi8(is_escape) as usize;
        let (low, high) = (set & 0xff, set >> 8 & 0xff);
        let low_count = u64::from(low.count_ones()) * u64::from_ne_bytes([1; 8]);
        let ranks = [
            u64::from_le_bytes(RANKS[low]),
            u64::from_le_bytes(RANKS[high]) + low_count,
        ];
        // Put the literals in place of the escapes
        let literals: &[u8; GROUP_SIZE] = bytes.get(usize::from(format.literals_start)..)?.first_chunk()?;
        let literals = ssse3._mm_shuffle_epi8(cast(*literals), cast(ranks));
        let codes = sse2._mm_andnot_si128(is_escape, codes);
        *group = cast(sse2._mm_or_si128(codes, literals));
        Some(length)
    }

    #[inline(always)]
    fn sum(
        self,
        mode: ChannelMode,
        previous: u32,
        planes: &[CodePlane; 4],
        count: usize,
        values: &mut ChannelValues,
    ) {
        let sse2 = self.sse2;
        let zero = sse2._mm_setzero_si128();
        // Zigzag codes alternate in sign: even ones are positive
        match mode {
            ChannelMode::Bytes => {
                let difference = |codes| {
                    let halves =
                        sse2._mm_and_si128(sse2._mm_srli_epi16::<1>(codes), sse2._mm_set1_epi8(0x7f));
                    let odd = sse2._mm_and_si128(codes, sse2._mm_set1_epi8(1));
                    sse2._mm_xor_si128(halves, sse2._mm_sub_epi8(zero, odd))
                };
                let add = |a, b| sse2._mm_add_epi8(a, b);
                accumulate(self, previous, planes, count, values, difference, add);
            }
            ChannelMode::Words => {
                let difference = |codes| {
                    let halves = sse2._mm_srli_epi16::<1>(codes);
                    let odd = sse2._mm_and_si128(codes, sse2._mm_set1_epi16(1));
                    sse2._mm_xor_si128(halves, sse2._mm_sub_epi16(zero, odd))
                };
                let add = |a, b| sse2._mm_add_epi16(a, b);
                accumulate(self, previous, planes, count, values, difference, add);
            }
            ChannelMode::Xor { rotation } => {
                let right = cast([u64::from(rotation), 0]);
                let left = cast([u64::from(u32::BITS - rotation), 0]);
                let difference = |codes| {
                    let low = sse2._mm_srl_epi32(codes, right);
                    sse2._mm_or_si128(low, sse2._mm_sll_epi32(codes, left))
                };
                let add = |a, b| sse2._mm_xor_si128(a, b);
                accumulate(self, previous, planes, count, values, difference, add);
            }
        }
    }
}

/// Sets the values to the sums of all differences so far and `previous`.
///
/// Four words at a time are added up in three steps: no sum waits for more than the last one of the four before.
#[inline(always)]
fn accumulate(
    V3 { sse2, .. }: V3,
    previous: u32,
    [a, b, c, d]: &[CodePlane; 4],
    count: usize,
    values: &mut ChannelValues,
    difference: impl Fn(__m128i) -> __m128i,
    add: impl Fn(__m128i, __m128i) -> __m128i,
) {
    // Take sixteen codes of each plane at a time
    let (a, b) = (a.as_chunks::<GROUP_SIZE>().0, b.as_chunks::<GROUP_SIZE>().0);
    let (c, d) = (c.as_chunks::<GROUP_SIZE>().0, d.as_chunks::<GROUP_SIZE>().0);
    let groups = a
        .iter()
        .zip(b)
        .zip(c.iter().zip(d))
        .take(count.div_ceil(GROUP_SIZE));
    let mut last = sse2._mm_set1_epi32(previous as i32);
    for (values, ((a, b), (c, d))) in values.as_chunks_mut::<GROUP_SIZE>().0.iter_mut().zip(groups) {
        // Join the planes' bytes to words
        let (a, b, c, d) = (cast(*a), cast(*b), cast(*c), cast(*d));
        let (low_ab, high_ab) = (sse2._mm_unpacklo_epi8(a, b), sse2._mm_unpackhi_epi8(a, b));
        let (low_cd, high_cd) = (sse2._mm_unpacklo_epi8(c, d), sse2._mm_unpackhi_epi8(c, d));
        let codes = [
            sse2._mm_unpacklo_epi16(low_ab, low_cd),
            sse2._mm_unpackhi_epi16(low_ab, low_cd),
            sse2._mm_unpacklo_epi16(high_ab, high_cd),
            sse2._mm_unpackhi_epi16(high_ab, high_cd),
        ];
        for (four, codes) in values.as_chunks_mut::<4>().0.iter_mut().zip(codes) {
            // Add to each word the one before, then the sum of the two before those, then that before the four
            let sums = difference(codes);
            let sums = add(sums, sse2._mm_slli_si128::<4>(sums));
            let sums = add(sums, sse2._mm_slli_si128::<8>(sums));
            let sums = add(sums, last);
            last = sse2._mm_shuffle_epi32::<0b11_11_11_11>(sums);
            *four = cast(sums);
        }
    }
}

/// Runs a computation with AVX2 if the processor has it, or else returns the computation.
pub(super) fn try_run<T: Computation>(computation: T) -> Result<T::Output, T> {
    struct Compiled<T>(V3, T);

    impl<T: Computation> NullaryFnOnce for Compiled<T> {
        type Output = T::Output;

        #[inline(always)]
        fn call(self) -> T::Output {
            self.1.run(self.0)
        }
    }
    match V3::try_new() {
        Some(instructions) => Ok(instructions.vectorize(Compiled(instructions, computation))),
        None => Err(computation),
    }
}

#[cfg(test)]
mod tests {
    use super::super::byte_plane::MAX_COUNT;
    use super::super::instruction_set::Portable;
    use super::*;

    /// Returns bytes of a sequence that looks random (an xorshift generator), many of which have the highest bits set.
    fn bytes<const N: usize>(state: &mut u32) -> [u8; N] {
        std::array::from_fn(|_| {
            *state ^= *state << 13;
            *state ^= *state >> 17;
            *state ^= *state << 5;
            let [a, b, c, _] = state.to_le_bytes();
            if c < 0x80 { a | b } else { a }
        })
    }

    #[test]
    fn groups_are_unpacked_as_by_any_processor() {
        let Some(avx2) = V3::try_new() else { return };
        let mut state = 1;
        for _ in 0..1000 {
            let window = bytes(&mut state);
            for widths in [Widths::V0, Widths::V1Narrow, Widths::V1Wide] {
                for header_bits in 0..4 {
                    let (mut group, mut expected) = ([1; GROUP_SIZE], [2; GROUP_SIZE]);
                    let length = avx2.unpack_group(&window, widths, header_bits, &mut group);
                    let expected_length = Portable.unpack_group(&window, widths, header_bits, &mut expected);
                    assert_eq!((group, length), (expected, expected_length));
                }
            }
        }
    }

    #[test]
    fn differences_are_summed_as_by_any_processor() {
        let Some(avx2) = V3::try_new() else { return };
        let mut state = 2;
        for mode in (0..=0xff).filter_map(ChannelMode::from_byte) {
            let planes = [(); 4].map(|()| bytes(&mut state));
            for count in [1, 2, 15, 16, 17, 255, 256] {
                let (mut values, mut expected) = ([1; MAX_COUNT], [2; MAX_COUNT]);
                avx2.sum(mode, 0x8765_4321, &planes, count, &mut values);
                Portable.sum(mode, 0x8765_4321, &planes, count, &mut expected);
                assert_eq!(values[..count], expected[..count]);
            }
        }
    }
}
