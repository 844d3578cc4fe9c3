//! The packets of the network protocol of tev, a viewer of pictures (Thomas Müller, github.com/Tom94/tev: "Over the
//! Network" in its README, and `src/Ipc.cpp`, which spells out what is read).
//!
//! A packet is its own length in bytes, these four included, a byte that names the operation, and what the operation
//! takes. Numbers are little-endian; names are UTF-8 and end with a zero; a flag is a byte.
//!
//! ```text
//! close  2  name
//! create 4  grab-focus name  width height count (32-bit)  names of channels
//! update 6  grab-focus name  count  names of channels  x y width height (32-bit)
//!           offset of each channel, stride of each channel (64-bit, in floats)  floats
//! ```
//!
//! Updates were 3 (one channel) and 5 (several, one plane after the other) before they were 6, which says itself where
//! each channel is; tev still takes all three. Pixels are sent whole, one after the other, as tev's client for Python
//! does.

use super::tev::Rectangle;

const CLOSE: u8 = 2;
const CREATE: u8 = 4;
const UPDATE: u8 = 6;

/// Bytes of pixels that one packet holds at most: tev reads a mebibyte at once, and a slow line is given up on by
/// packets.
const MAX_BYTES: usize = 1 << 18;

/// A packet in the making.
struct Packet(Vec<u8>);

impl Packet {
    fn new(operation: u8) -> Packet {
        // The length comes last.
        Packet(vec![0, 0, 0, 0, operation])
    }

    fn flag(mut self, on: bool) -> Packet {
        self.0.push(on.into());
        self
    }

    /// A name, in which a zero would be its end.
    fn name(mut self, name: &str) -> Packet {
        self.0.extend(name.replace('\0', "\u{fffd}").bytes());
        self.0.push(0);
        self
    }

    fn numbers(mut self, numbers: &[u32]) -> Packet {
        self.0
            .extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self
    }

    fn long_numbers(mut self, numbers: impl Iterator<Item = u64>) -> Packet {
        self.0.extend(numbers.flat_map(u64::to_le_bytes));
        self
    }

    fn finish(mut self) -> Vec<u8> {
        // Names come from command lines, and pixels are few.
        let length = u32::try_from(self.0.len()).unwrap_or(u32::MAX);
        self.0[..4].copy_from_slice(&length.to_le_bytes());
        self.0
    }
}

/// Closes a picture.
pub(super) fn close(name: &str) -> Vec<u8> {
    Packet::new(CLOSE).name(name).finish()
}

/// Makes a picture, or makes it anew, and shows it.
pub(super) fn create(name: &str, [width, height]: [u32; 2], channels: &[&str]) -> Vec<u8> {
    let packet = Packet::new(CREATE)
        .flag(true)
        .name(name)
        .numbers(&[width, height, channels.len() as u32]);
    channels
        .iter()
        .fold(packet, |packet, channel| packet.name(channel))
        .finish()
}

/// Changes a rectangle of a picture, by as many packets as it takes: each with its part of the rectangle.
///
/// `planes` hold the rectangle of each channel, row by row; there is at least one, and all have its size.
pub(super) fn update<'a>(
    name: &'a str,
    whole: Rectangle,
    channels: &'a [&'a str],
    planes: &'a [&'a [f32]],
) -> impl Iterator<Item = Vec<u8>> + 'a {
    pieces(whole, planes.len()).map(move |piece| {
        let count = planes.len() as u64;
        let packet = Packet::new(UPDATE)
            .flag(false)
            .name(name)
            .numbers(&[planes.len() as u32]);
        let mut packet = channels
            .iter()
            .fold(packet, |packet, channel| packet.name(channel))
            .numbers(&[piece.x, piece.y, piece.width, piece.height])
            .long_numbers(0..count)
            .long_numbers(planes.iter().map(|_| count));
        for y in piece.y - whole.y..piece.y - whole.y + piece.height {
            let first = y as usize * whole.width as usize + (piece.x - whole.x) as usize;
            for pixel in first..first + piece.width as usize {
                let values = planes.iter().flat_map(|plane| plane[pixel].to_le_bytes());
                packet.0.extend(values);
            }
        }
        packet.finish()
    })
}

/// Parts of a rectangle that fit into a packet each: rows, or parts of them where rows are long.
fn pieces(whole: Rectangle, channel_count: usize) -> impl Iterator<Item = Rectangle> {
    let most_pixels = (MAX_BYTES / (size_of::<f32>() * channel_count)).max(1) as u32;
    let width = whole.width.min(most_pixels).max(1);
    let height = (most_pixels / width).max(1);
    let rows = (0..whole.height).step_by(height as usize);
    rows.flat_map(move |y| {
        (0..whole.width).step_by(width as usize).map(move |x| Rectangle {
            x: whole.x + x,
            y: whole.y + y,
            width: width.min(whole.width - x),
            height: height.min(whole.height - y),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packet_begins_with_its_length_and_its_operation() {
        // 4 of the length, 1 of the operation, 2 of the name, 1 of its end.
        assert_eq!(close("ab"), [8, 0, 0, 0, 2, b'a', b'b', 0]);
        assert_eq!(close("a\0b").len(), 5 + 1 + 3 + 1 + 1);
    }

    #[test]
    fn a_picture_is_made_with_its_size_and_its_channels() {
        let bytes = create("é", [258, 3], &["R", "Z"]);
        let rest = [
            4, 1, 0xc3, 0xa9, 0, 2, 1, 0, 0, 3, 0, 0, 0, 2, 0, 0, 0, b'R', 0, b'Z', 0,
        ];
        assert_eq!(bytes[..4], [25, 0, 0, 0]);
        assert_eq!(bytes[4..], rest);
    }

    #[test]
    fn pieces_tile_a_rectangle_of_any_shape() {
        for (width, height) in [(1, 1), (7, 5), (1920, 1080), (300_000, 2), (1, 100_000), (0, 5)] {
            let whole = Rectangle {
                x: 3,
                y: 4,
                width,
                height,
            };
            let area = |r: &Rectangle| u64::from(r.width) * u64::from(r.height);
            let all: Vec<_> = pieces(whole, 3).collect();
            assert_eq!(all.iter().map(area).sum::<u64>(), area(&whole), "{whole:?}");
            assert!(
                all.iter()
                    .all(|piece| whole.holds(piece) && 12 * area(piece) <= MAX_BYTES as u64)
            );
        }
    }
}
