//! Channels of vertex attributes: four bytes of consecutive elements, as differences from the previous element.

use super::byte_plane::{CodePlane, MAX_COUNT};

/// Kind of the differences of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ChannelMode {
    /// Zigzag codes of the differences of four bytes.
    Bytes,
    /// Zigzag codes of the differences of two 16-bit numbers.
    Words,
    /// Exclusive or of 32-bit numbers, rotated left by a number of bits.
    Xor { rotation: u32 },
}

impl ChannelMode {
    /// Returns the mode that a byte of the tail stands for; `None` if it is not defined.
    pub(super) fn from_byte(byte: u8) -> Option<ChannelMode> {
        match (byte & 0xf, byte >> 4) {
            (0, 0) => Some(ChannelMode::Bytes),
            (1, 0) => Some(ChannelMode::Words),
            (2, rotation) => Some(ChannelMode::Xor {
                rotation: u32::from(rotation),
            }),
            _ => None,
        }
    }
}

/// Values of one channel of all elements of a block.
pub(super) type ChannelValues = [u32; MAX_COUNT];

/// State of a channel between two blocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct AttributeChannel {
    pub(super) mode: ChannelMode,
    /// Last value, or the one that the first difference is from.
    pub(super) previous: u32,
}

/// Sets the values to those that begin behind `previous` and have the differences of the lowest `count` codes.
#[inline(always)]
pub(super) fn sum(
    mode: ChannelMode,
    previous: u32,
    planes: &[CodePlane; 4],
    count: usize,
    values: &mut ChannelValues,
) {
    interleave(planes, values);
    let codes = &mut values[..count];
    match mode {
        ChannelMode::Bytes => accumulate(codes, previous, unzigzag_lanes::<8>, add_lanes::<8>),
        ChannelMode::Words => accumulate(codes, previous, unzigzag_lanes::<16>, add_lanes::<16>),
        ChannelMode::Xor { rotation } => {
            accumulate(codes, previous, |code| code.rotate_right(rotation), |a, b| a ^ b);
        }
    }
}

/// Replaces each code by the sum of the previous value and the difference that the code stands for.
#[inline(always)]
fn accumulate(
    codes: &mut [u32],
    mut previous: u32,
    difference: impl Fn(u32) -> u32,
    add: impl Fn(u32, u32) -> u32,
) {
    // Several at once, which sums are not for
    codes.iter_mut().for_each(|code| *code = difference(*code));
    for code in codes {
        previous = add(previous, *code);
        *code = previous;
    }
}

/// Joins the planes' bytes to words, the first plane's lowest.
#[inline(always)]
fn interleave([p0, p1, p2, p3]: &[CodePlane; 4], words: &mut [u32]) {
    let planes = p0.iter().zip(p1).zip(p2.iter().zip(p3));
    for (word, ((&b0, &b1), (&b2, &b3))) in words.iter_mut().zip(planes) {
        let low = u16::from_le_bytes([b0, b1]);
        let high = u16::from_le_bytes([b2, b3]);
        *word = u32::from(low) | u32::from(high) << 16;
    }
}

/// Returns a word with the lowest bit of each lane of `BITS` bits.
const fn lowest_bits<const BITS: u32>() -> u32 {
    u32::MAX / ((1 << BITS) - 1)
}

/// Returns the differences that zigzag codes in lanes of `BITS` bits stand for.
#[inline(always)]
fn unzigzag_lanes<const BITS: u32>(codes: u32) -> u32 {
    let lowest = const { lowest_bits::<BITS>() };
    let highest = lowest << (BITS - 1);
    let halves = codes >> 1 & !highest;
    // All bits of a lane whose code is odd: 2^BITS - 1 times its lowest bit
    let odd = codes & lowest;
    let inverted = (odd << BITS).wrapping_sub(odd);
    halves ^ inverted
}

/// Returns the sums of lanes of `BITS` bits, without a carry from lane to lane.
#[inline(always)]
fn add_lanes<const BITS: u32>(a: u32, b: u32) -> u32 {
    let highest = const { lowest_bits::<BITS>() << (BITS - 1) };
    ((a & !highest) + (b & !highest)) ^ ((a ^ b) & highest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns what a channel makes of two codes, at the start of elements of 6 bytes.
    fn integrated(mode: u8, previous: u32, codes: [u32; 2]) -> [u32; 2] {
        let mut planes = [[0; MAX_COUNT]; 4];
        for (place, code) in codes.into_iter().enumerate() {
            for (plane, byte) in planes.iter_mut().zip(code.to_le_bytes()) {
                plane[place] = byte;
            }
        }
        let mode = ChannelMode::from_byte(mode).unwrap();
        let mut values = [0; MAX_COUNT];
        sum(mode, previous, &planes, 2, &mut values);
        [values[0], values[1]]
    }

    #[test]
    fn byte_differences_have_no_carry() {
        // Zigzag 1 = -1, 2 = 1, 0xff = -128, 0xfe = 127
        let values = integrated(0, 0xff00_00ff, [0x02_01_02_01, 0x00_00_ff_fe]);
        assert_eq!(values, [0x00_ff_01_fe, 0x00_ff_81_7d]);
    }

    #[test]
    fn word_differences_have_no_carry() {
        // Zigzag 2 = 1, 1 = -1, 0x0203 = -258
        let values = integrated(1, 0x0000_ffff, [0x0001_0002, 0x0203_0000]);
        assert_eq!(values, [0xffff_0000, 0xfefd_0000]);
    }

    #[test]
    fn exclusive_or_undoes_the_rotation() {
        // Rotated right by 4: 0x10 becomes 0x1, 0x1 becomes 0x1000_0000
        assert_eq!(
            integrated(0x42, 0xf0f0_f0f0, [0x10, 0x01]),
            [0xf0f0_f0f1, 0xe0f0_f0f1]
        );
    }

    #[test]
    fn only_exclusive_or_has_a_rotation() {
        for byte in [0x03, 0x10, 0x21, 0x0f] {
            assert_eq!(ChannelMode::from_byte(byte), None);
        }
        assert_eq!(
            ChannelMode::from_byte(0xf2),
            Some(ChannelMode::Xor { rotation: 15 })
        );
    }
}
