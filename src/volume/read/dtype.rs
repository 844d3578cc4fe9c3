//! Scalar types of files, their byte order, and the memory layout (strides) of arrays.

use exr::prelude::f16;
use schemars::JsonSchema;
use serde::Deserialize;

use super::fault::{SAVE_AGAIN, THREE_AXES, VolumeFault, too_big};
use crate::volume::GridSamples;

/// Scalar type of a file's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Element {
    /// Unsigned 8-bit integers, stored unchanged.
    U8,
    /// Signed 8-bit integers, stored as f32.
    I8,
    /// Unsigned 16-bit integers, stored unchanged.
    U16,
    /// Signed 16-bit integers, stored as f32.
    I16,
    /// Unsigned 32-bit integers, rounded to f32 like all wider types.
    U32,
    /// Signed 32-bit integers, rounded to f32.
    I32,
    /// Unsigned 64-bit integers, rounded to f32.
    U64,
    /// Signed 64-bit integers, rounded to f32.
    I64,
    /// IEEE half precision (binary16), stored as f32.
    F16,
    /// IEEE single precision (binary32), stored unchanged.
    F32,
    /// IEEE double precision (binary64), rounded to f32.
    F64,
}

/// Byte order (endianness) of a file's numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ByteOrder {
    /// Least significant byte first (little-endian).
    #[default]
    Little,
    /// Most significant byte first (big-endian).
    Big,
}

/// Strided layout of an array in a file; strides are counted in numbers, not bytes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ArrayLayout {
    pub(super) element: Element,
    pub(super) order: ByteOrder,
    /// Numbers of samples along x, y, z.
    pub(super) size: [usize; 3],
    pub(super) channels: usize,
    /// Distances from one sample to the next along x, y, z.
    pub(super) strides: [usize; 3],
    /// Distance from one channel to the next.
    pub(super) channel_stride: usize,
}

/// Largest number of channels: red, green, blue and density.
const MAX_CHANNELS: usize = 4;

impl Element {
    /// Returns the bytes of one number in the file.
    pub fn bytes(self) -> u64 {
        match self {
            Element::U8 | Element::I8 => 1,
            Element::U16 | Element::I16 | Element::F16 => 2,
            Element::U32 | Element::I32 | Element::F32 => 4,
            Element::U64 | Element::I64 | Element::F64 => 8,
        }
    }

    /// Returns the bytes of one number in memory, as a [`GridSamples`] stores it.
    fn stored_bytes(self) -> u64 {
        match self {
            Element::U8 => 1,
            Element::U16 => 2,
            _ => 4,
        }
    }
}

/// Role of an array's axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ArrayAxis {
    X,
    Y,
    Z,
    Channel,
}

impl ArrayLayout {
    /// Creates the layout of an array whose axes have these roles and lengths, the fastest first. Each of x, y, z is
    /// among them.
    pub(super) fn new(
        element: Element,
        order: ByteOrder,
        axes: &[(ArrayAxis, u64)],
    ) -> Result<ArrayLayout, VolumeFault> {
        let mut layout = ArrayLayout {
            element,
            order,
            size: [1; 3],
            channels: 1,
            strides: [0; 3],
            channel_stride: 0,
        };
        let mut stride = 1u64;
        // Reject products of lengths that overflow
        for &(axis, length) in axes {
            let numbers = stride.checked_mul(length);
            let bytes = numbers.and_then(|numbers| numbers.checked_mul(8));
            // Limit to i64::MAX bytes, also for the widest type, so that nothing below can overflow.
            let (Some(numbers), true) = (numbers, bytes.is_some_and(|bytes| bytes <= i64::MAX as u64)) else {
                return Err(VolumeFault::new(
                    "declares more numbers than memory can hold",
                    SAVE_AGAIN,
                ));
            };
            if length == 0 {
                return Err(VolumeFault::new("has an axis of length 0", THREE_AXES));
            }
            // Assign length and stride by the axis's role
            match axis {
                ArrayAxis::Channel => {
                    layout.channels = length as usize;
                    layout.channel_stride = stride as usize;
                }
                _ => {
                    layout.size[axis as usize] = length as usize;
                    layout.strides[axis as usize] = stride as usize;
                }
            }
            stride = numbers;
        }
        if layout.channels > MAX_CHANNELS {
            return Err(VolumeFault::new(
                format!("has {} channels", layout.channels),
                THREE_AXES,
            ));
        }
        Ok(layout)
    }

    /// Returns the number of scalars, over all samples and channels.
    pub(super) fn count(&self) -> u64 {
        self.size.iter().map(|&side| side as u64).product::<u64>() * self.channels as u64
    }

    /// Returns the bytes of all numbers in the file.
    pub(super) fn bytes(&self) -> u64 {
        self.count() * self.element.bytes()
    }

    /// Checks that the file's `available` bytes hold all numbers, and that these fit into `max_bytes` of memory.
    pub(super) fn check(&self, available: u64, max_bytes: u64) -> Result<(), VolumeFault> {
        if self.bytes() > available {
            let [x, y, z] = self.size;
            let fault = format!(
                "is truncated: {x} x {y} x {z} samples of {} channels take {} bytes, and {available} are there",
                self.channels,
                self.bytes()
            );
            return Err(VolumeFault::new(fault, SAVE_AGAIN));
        }
        self.check_memory(max_bytes)
    }

    /// Checks that the decoded numbers fit into `max_bytes` of memory.
    pub(super) fn check_memory(&self, max_bytes: u64) -> Result<(), VolumeFault> {
        // A grid stores an axis of one sample twice.
        let stored = self.size.map(|side| side.max(2) as u128);
        let kept =
            stored.iter().product::<u128>() * self.channels as u128 * u128::from(self.element.stored_bytes());
        if kept > u128::from(max_bytes) {
            return Err(too_big(u64::try_from(kept).unwrap_or(u64::MAX), max_bytes));
        }
        Ok(())
    }

    /// Decodes one channel of `data`, which has passed [`ArrayLayout::check`].
    pub(super) fn decode(&self, channel: usize, data: &[u8]) -> GridSamples {
        match self.element {
            Element::U8 => GridSamples::Bytes(self.numbers(channel, data, |[byte]: [u8; 1]| byte)),
            Element::U16 => GridSamples::Words(self.numbers(channel, data, u16::from_le_bytes)),
            Element::I8 => self.floats(channel, data, |b| f32::from(i8::from_le_bytes(b))),
            Element::I16 => self.floats(channel, data, |b| f32::from(i16::from_le_bytes(b))),
            Element::U32 => self.floats(channel, data, |b| u32::from_le_bytes(b) as f32),
            Element::I32 => self.floats(channel, data, |b| i32::from_le_bytes(b) as f32),
            Element::U64 => self.floats(channel, data, |b| u64::from_le_bytes(b) as f32),
            Element::I64 => self.floats(channel, data, |b| i64::from_le_bytes(b) as f32),
            Element::F16 => self.floats(channel, data, |b| f16::from_le_bytes(b).to_f32()),
            Element::F32 => self.floats(channel, data, f32::from_le_bytes),
            Element::F64 => self.floats(channel, data, |b| f64::from_le_bytes(b) as f32),
        }
    }

    /// Decodes one channel to f32.
    fn floats<const BYTES: usize>(
        &self,
        channel: usize,
        data: &[u8],
        from_little: impl Fn([u8; BYTES]) -> f32,
    ) -> GridSamples {
        GridSamples::Floats(self.numbers(channel, data, from_little))
    }

    /// Decodes one channel, x fastest; `from_little` converts the bytes of one number in little-endian order.
    fn numbers<T, const BYTES: usize>(
        &self,
        channel: usize,
        data: &[u8],
        from_little: impl Fn([u8; BYTES]) -> T,
    ) -> Vec<T> {
        let (elements, _) = data.as_chunks::<BYTES>();
        let [nx, ny, nz] = self.size;
        let mut numbers = Vec::with_capacity(nx * ny * nz);
        for z in 0..nz {
            for y in 0..ny {
                let row = channel * self.channel_stride + z * self.strides[2] + y * self.strides[1];
                for x in 0..nx {
                    let mut bytes = elements[row + x * self.strides[0]];
                    if self.order == ByteOrder::Big {
                        bytes.reverse();
                    }
                    numbers.push(from_little(bytes));
                }
            }
        }
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_types_are_read_in_both_byte_orders() {
        let axes = [(ArrayAxis::X, 1), (ArrayAxis::Y, 1), (ArrayAxis::Z, 1)];
        let cases: [(Element, &[u8], f32); 12] = [
            (Element::U8, &[200], 200.0),
            (Element::I8, &[200], -56.0),
            (Element::U16, &[0x34, 0x92], 37428.0),
            (Element::I16, &[0x34, 0x92], -28108.0),
            (Element::U32, &[0, 0, 0, 0x80], 2_147_483_648.0),
            (Element::I32, &[0, 0, 0, 0x80], -2_147_483_648.0),
            (Element::U64, &[0, 0, 0, 0, 1, 0, 0, 0x80], 9.223_372e18),
            (Element::I64, &[0xff; 8], -1.0),
            (Element::F16, &[0x00, 0xc0], -2.0),
            (Element::F16, &[0x01, 0x00], 5.960_464_5e-8),
            (Element::F32, &[0, 0, 0xc0, 0x3f], 1.5),
            (Element::F64, &[0, 0, 0, 0, 0, 0, 0xf8, 0x3f], 1.5),
        ];
        for (element, little, value) in cases {
            let big: Vec<u8> = little.iter().rev().copied().collect();
            for (order, data) in [(ByteOrder::Little, little), (ByteOrder::Big, &big)] {
                let layout = ArrayLayout::new(element, order, &axes).unwrap();
                assert_eq!(layout.bytes(), data.len() as u64);
                assert_eq!(layout.decode(0, data).get(0), value, "{element:?} {order:?}");
            }
        }
    }

    #[test]
    fn axes_follow_the_array_order() {
        // Order of axes: z fastest, then y, then x, then two channels.
        let axes = [
            (ArrayAxis::Z, 2),
            (ArrayAxis::Y, 2),
            (ArrayAxis::X, 3),
            (ArrayAxis::Channel, 2),
        ];
        let layout = ArrayLayout::new(Element::U8, ByteOrder::Little, &axes).unwrap();
        let data: Vec<u8> = (0..24).collect();
        let GridSamples::Bytes(second) = layout.decode(1, &data) else {
            panic!("bytes stay bytes");
        };
        assert_eq!(second, [12, 16, 20, 14, 18, 22, 13, 17, 21, 15, 19, 23]);
    }

    #[test]
    fn overflowing_or_oversized_arrays_are_rejected_early() {
        let refused =
            |axes: &[(ArrayAxis, u64)]| ArrayLayout::new(Element::U8, ByteOrder::Little, axes).is_err();
        assert!(refused(&[
            (ArrayAxis::X, u64::MAX),
            (ArrayAxis::Y, 2),
            (ArrayAxis::Z, 1)
        ]));
        assert!(refused(&[
            (ArrayAxis::X, 1 << 30),
            (ArrayAxis::Y, 1 << 30),
            (ArrayAxis::Z, 1)
        ]));
        assert!(refused(&[
            (ArrayAxis::X, 1),
            (ArrayAxis::Y, 0),
            (ArrayAxis::Z, 1)
        ]));
        assert!(refused(&[
            (ArrayAxis::Channel, 5),
            (ArrayAxis::X, 1),
            (ArrayAxis::Y, 1),
            (ArrayAxis::Z, 1)
        ]));
        let axes = [(ArrayAxis::X, 4), (ArrayAxis::Y, 4), (ArrayAxis::Z, 4)];
        let layout = ArrayLayout::new(Element::F64, ByteOrder::Little, &axes).unwrap();
        assert!(layout.check(512, 256).is_ok());
        assert!(layout.check(511, 256).is_err());
        assert!(layout.check(512, 255).is_err());
    }
}
