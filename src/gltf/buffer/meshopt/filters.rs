//! Filters of decoded elements: functions of each element, in place.
//!
//! Each follows a formula of appendix B, in f32. The specification leaves one unit in the last place open; this
//! module divides and takes roots exactly and rounds halfway cases to even, as the SIMD versions of meshoptimizer do
//! where they divide exactly. What the specification leaves undefined, such as a scale of zero, gives some bytes.

use std::f32::consts::SQRT_2;

use super::{ElementFilter, StreamLayout};

/// Number that moves a fraction's units into the lowest bits of an f32 when added: 1.5 * 2^23.
///
/// Numbers from 2^23 to 2^24 have a spacing of one, so the sum is rounded, halfway cases to even. The half keeps sums
/// with negative numbers above 2^23.
const ROUNDING_OFFSET: f32 = 12_582_912.0;

/// Exponent bias of f32.
const EXPONENT_BIAS: i32 = 127;

/// Number of mantissa bits of f32 that are stored.
const MANTISSA_BITS: u32 = 23;

/// Applies the layout's filter to all elements.
#[inline(always)]
pub(super) fn apply(layout: &StreamLayout, elements: &mut [u8]) {
    match (layout.filter, layout.stride) {
        (ElementFilter::None, _) => {}
        (ElementFilter::Octahedral, 4) => map_words(elements, octahedral_8),
        (ElementFilter::Octahedral, _) => map_long_words(elements, octahedral_16),
        (ElementFilter::Quaternion, _) => map_quaternions(elements),
        (ElementFilter::Exponential, _) => map_words(elements, exponential),
        (ElementFilter::Color, 4) => map_words(elements, color_8),
        (ElementFilter::Color, _) => map_long_words(elements, color_16),
    }
}

/// Replaces each four bytes by a function of them; words let the compiler work on several at once.
#[inline(always)]
fn map_words(elements: &mut [u8], function: impl Fn(u32) -> u32) {
    for element in elements.as_chunks_mut().0 {
        *element = function(u32::from_le_bytes(*element)).to_le_bytes();
    }
}

/// Replaces each eight bytes by a function of them.
#[inline(always)]
fn map_long_words(elements: &mut [u8], function: impl Fn(u64) -> u64) {
    for element in elements.as_chunks_mut().0 {
        *element = function(u64::from_le_bytes(*element)).to_le_bytes();
    }
}

/// Returns the nearest integer modulo 2^16; halfway cases go to the even one.
#[inline(always)]
fn round(value: f32) -> u32 {
    (value + ROUNDING_OFFSET).to_bits() & 0xffff
}

/// Returns the signed byte of a word at a place from the lowest.
#[inline(always)]
fn signed_byte(word: u32, place: u32) -> i32 {
    (word << (24 - 8 * place)) as i32 >> 24
}

/// Returns the signed 16-bit number of a word at a place from the lowest.
#[inline(always)]
fn signed_short(word: u64, place: u32) -> i32 {
    i32::from((word >> (16 * place)) as i16)
}

/// Joins the low bytes of four numbers to a word, the first lowest.
#[inline(always)]
fn word(a: u32, b: u32, c: u32, d: u32) -> u32 {
    a & 0xff | (b & 0xff) << 8 | (c & 0xff) << 16 | d << 24
}

/// Joins four 16-bit numbers to a word, the first lowest.
#[inline(always)]
fn long_word(a: u32, b: u32, c: u32, d: u32) -> u64 {
    u64::from(a | b << 16) | u64::from(c | d << 16) << 32
}

/// Decodes a unit vector of 8-bit components; the fourth is kept.
#[inline(always)]
fn octahedral_8(element: u32) -> u32 {
    let encoded = Octahedral {
        x: signed_byte(element, 0) as f32,
        y: signed_byte(element, 1) as f32,
        one: signed_byte(element, 2) as f32,
    };
    let [x, y, z] = octahedral(encoded, f32::from(i8::MAX));
    word(x, y, z, element >> 24)
}

/// Decodes a unit vector of 16-bit components; the fourth is kept.
#[inline(always)]
fn octahedral_16(element: u64) -> u64 {
    let encoded = Octahedral {
        x: signed_short(element, 0) as f32,
        y: signed_short(element, 1) as f32,
        one: signed_short(element, 2) as f32,
    };
    let [x, y, z] = octahedral(encoded, f32::from(i16::MAX));
    long_word(x, y, z, (element >> 48) as u32)
}

/// Octahedral coordinates of a direction, and what 1 is in their units.
struct Octahedral {
    x: f32,
    y: f32,
    one: f32,
}

/// Returns the unit vector of a direction, times `scale`.
#[inline(always)]
fn octahedral(Octahedral { x, y, one }: Octahedral, scale: f32) -> [u32; 3] {
    let z = one - (x.abs() + y.abs());
    // Fold the lower half of the octahedron back
    let fold = z.min(0.0);
    let x = x - fold.copysign(x);
    let y = y - fold.copysign(y);
    let factor = scale / (x * x + (y * y + z * z)).sqrt();
    [round(x * factor), round(y * factor), round(z * factor)]
}

/// Decodes unit quaternions of 16-bit components.
#[inline(always)]
fn map_quaternions(elements: &mut [u8]) {
    let (elements, _) = elements.as_chunks_mut::<8>();
    for batch in elements.chunks_mut(QUATERNION_BATCH) {
        // Rotation is apart, since it is not for several at once
        let mut rotations = [0; QUATERNION_BATCH];
        for (element, rotation) in batch.iter_mut().zip(&mut rotations) {
            let encoded = u64::from_le_bytes(*element);
            *rotation = 16 * (encoded >> 48 & 3) as u32;
            *element = quaternion(encoded).to_le_bytes();
        }
        for (element, rotation) in batch.iter_mut().zip(rotations) {
            *element = u64::from_le_bytes(*element).rotate_left(rotation).to_le_bytes();
        }
    }
}

/// Number of quaternions that are decoded before they are rotated: few enough to stay in the nearest cache.
const QUATERNION_BATCH: usize = 64;

/// Returns the greatest component of a quaternion, which is not encoded, and then the other three.
#[inline(always)]
fn quaternion(encoded: u64) -> u64 {
    let x = signed_short(encoded, 0) as f32;
    let y = signed_short(encoded, 1) as f32;
    let z = signed_short(encoded, 2) as f32;
    // The lowest two bits are the place of the greatest component
    let one = (signed_short(encoded, 3) | 3) as f32;
    let rest = one * (one + one) - (x * x + (y * y + z * z));
    let w = rest.max(0.0).sqrt();
    // The components are in units of the greatest that is not the greatest of four, which is 1/sqrt(2)
    let factor = f32::from(i16::MAX) / SQRT_2 / one;
    long_word(
        round(w * factor),
        round(x * factor),
        round(y * factor),
        round(z * factor),
    )
}

/// Decodes a number of 8 bits of exponent and 24 bits of mantissa to an f32.
#[inline(always)]
fn exponential(element: u32) -> u32 {
    let exponent = element as i32 >> 24;
    let mantissa = (element << 8) as i32 >> 8;
    let power = f32::from_bits(((exponent + EXPONENT_BIAS) as u32) << MANTISSA_BITS);
    (power * mantissa as f32).to_bits()
}

/// Decodes a colour of 8-bit components.
#[inline(always)]
fn color_8(element: u32) -> u32 {
    let encoded = EncodedColor {
        y: (element & 0xff) as i32,
        co: signed_byte(element, 1),
        cg: signed_byte(element, 2),
        alpha: (element >> 24) as i32,
    };
    let [r, g, b, a] = color(encoded, f32::from(u8::MAX));
    word(r, g, b, a)
}

/// Decodes a colour of 16-bit components.
#[inline(always)]
fn color_16(element: u64) -> u64 {
    let encoded = EncodedColor {
        y: (element & 0xffff) as i32,
        co: signed_short(element, 1),
        cg: signed_short(element, 2),
        alpha: (element >> 48) as i32,
    };
    let [r, g, b, a] = color(encoded, f32::from(u16::MAX));
    long_word(r, g, b, a)
}

/// Colour as luma, chroma (orange against blue, green against purple), and alpha, whose highest bit is the precision.
struct EncodedColor {
    y: i32,
    co: i32,
    cg: i32,
    alpha: i32,
}

/// Returns red, green, blue and alpha, times `scale`.
#[inline(always)]
fn color(EncodedColor { y, co, cg, alpha }: EncodedColor, scale: f32) -> [u32; 4] {
    // Set all bits below the highest
    let mut one = alpha;
    for shift in [1, 2, 4, 8] {
        one |= one >> shift;
    }
    // Drop the highest bit of alpha and repeat the lowest
    let alpha = (alpha << 1) & one | alpha & 1;
    let factor = scale / one as f32;
    [
        round((y + co - cg) as f32 * factor),
        round((y + cg) as f32 * factor),
        round((y - co - cg) as f32 * factor),
        round(alpha as f32 * factor),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::StreamMode;
    use super::*;

    /// Applies a filter to one element of four 16-bit components.
    fn filtered(filter: ElementFilter, components: [i32; 4]) -> [i32; 4] {
        let [a, b, c, d] = components.map(|component| component as u32 & 0xffff);
        let mut bytes = long_word(a, b, c, d).to_le_bytes();
        apply(&layout(filter, 8), &mut bytes);
        std::array::from_fn(|place| signed_short(u64::from_le_bytes(bytes), place as u32))
    }

    fn layout(filter: ElementFilter, stride: usize) -> StreamLayout {
        StreamLayout {
            mode: StreamMode::Attributes,
            filter,
            count: 1,
            stride,
        }
    }

    #[test]
    fn octahedral_coordinates_fold_to_the_lower_half() {
        for (encoded, expected) in [
            ([0, 0, 127, 5], [0, 0, 127, 5]),
            ([127, 0, 127, 6], [127, 0, 0, 6]),
            // 127 - 127 - 127 = -127; 127 - 127 = 0
            ([127, 129, 127, 7], [0, 0, 129, 7]),
            // 4 bits: 7 - 3 - 4 = 0; (3, 4) / 5 * 127 = (76.2, 101.6)
            ([3, 4, 7, 8], [76, 102, 0, 8]),
        ] {
            let mut bytes = encoded;
            apply(&layout(ElementFilter::Octahedral, 4), &mut bytes);
            assert_eq!(bytes, expected);
        }
        // 10 bits: (3, -4) / 5 * 32767 = (19660.2, -26213.6)
        assert_eq!(
            filtered(ElementFilter::Octahedral, [219, -292, 511, -9]),
            [19660, -26214, 0, -9]
        );
    }

    #[test]
    fn quaternions_regain_their_greatest_component() {
        // All others are 0
        assert_eq!(
            filtered(ElementFilter::Quaternion, [0, 0, 0, 0x7ffc | 2]),
            [0, 0, 32767, 0]
        );
        // 1/sqrt(2) * 32767 = 23169.8 in the place behind the greatest
        assert_eq!(
            filtered(ElementFilter::Quaternion, [-32767, 0, 0, 0x7ffc | 3]),
            [-23170, 0, 0, 23170]
        );
    }

    #[test]
    fn exponential_numbers_are_exact() {
        for (exponent, mantissa, expected) in [(-1i32, 3, 1.5f32), (4, -5, -80.0), (-100, 1, 2f32.powi(-100))]
        {
            let mut bytes = ((exponent << 24) | (mantissa & 0x00ff_ffff)).to_le_bytes();
            apply(&layout(ElementFilter::Exponential, 4), &mut bytes);
            assert_eq!(f32::from_le_bytes(bytes), expected);
        }
    }

    #[test]
    fn colors_have_the_precision_of_their_alpha() {
        // 4 bits: r = 5 + 2 + 1, g = 5 - 1, b = 5 - 2 + 1, each times 255 / 15; alpha 0b010 is 0b0100
        let mut bytes = [5, 2, 0xff, 0b1010];
        apply(&layout(ElementFilter::Color, 4), &mut bytes);
        assert_eq!(bytes, [8 * 17, 4 * 17, 4 * 17, 4 * 17]);
        // 8 bits in 16: times 65535 / 255 = 257; alpha 0b111_1111 is 255
        let color = filtered(ElementFilter::Color, [100, 0, 0, 0xff]);
        assert_eq!(color, [25700, 25700, 25700, -1]);
    }

    #[test]
    fn undefined_input_gives_some_bytes() {
        for filter in [
            ElementFilter::Octahedral,
            ElementFilter::Quaternion,
            ElementFilter::Exponential,
            ElementFilter::Color,
        ] {
            for component in [0, -1, -32768, 32767] {
                filtered(filter, [component; 4]);
            }
        }
    }
}
