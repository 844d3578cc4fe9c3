//! Packets of the network protocol of the image viewer tev (Thomas Müller, github.com/Tom94/tev: "Over the Network" in
//! its README, and `src/Ipc.cpp`, which defines exactly what is parsed).
//!
//! A packet consists of its own length in bytes (including these four), one byte that names the operation, and the
//! arguments of the operation. Numbers are little-endian; names are UTF-8 and end with a zero; a flag is a byte.
//!
//! ```text
//! close  2  name
//! create 4  grab-focus name  width height count (32-bit)  names of channels
//! update 6  grab-focus name  count  names of channels  x y width height (32-bit)
//!           offset of each channel, stride of each channel (64-bit, in floats)  floats
//! ```
//!
//! Updates had operation 3 (one channel) and 5 (several channels, one plane after another) before 6, which states the
//! offset and stride of each channel; tev still accepts all three. Pixels are sent interleaved, one after another, as
//! tev's Python client does.

use super::rectangle::Rectangle;

const CLOSE: u8 = 2;
const CREATE: u8 = 4;
const UPDATE: u8 = 6;

/// Largest number of bytes of pixels in one packet: tev reads one MiB at a time, and the timeout of a slow connection
/// counts packets.
const MAX_BYTES: usize = 1 << 18;

/// Packet that is being assembled.
struct Packet(Vec<u8>);

impl Packet {
    fn new(operation: u8) -> Packet {
        // The first four bytes are replaced by the length in `finish`.
        Packet(vec![0, 0, 0, 0, operation])
    }

    fn flag(mut self, on: bool) -> Packet {
        self.0.push(on.into());
        self
    }

    /// Appends a name; a zero inside it would end it and is replaced by U+FFFD.
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
        // The length fits: names come from command lines, and `MAX_BYTES` bounds the pixels.
        let length = u32::try_from(self.0.len()).unwrap_or(u32::MAX);
        self.0[..4].copy_from_slice(&length.to_le_bytes());
        self.0
    }
}

/// Returns the packet that closes the image `name`.
pub(super) fn close(name: &str) -> Vec<u8> {
    Packet::new(CLOSE).name(name).finish()
}

/// Returns the packet that creates or re-creates the image `name` and shows it.
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

/// Returns the packets that update a rectangle of an image, each with a part of the rectangle that fits into it.
///
/// `planes` hold the rectangle of each channel, row by row; there is at least one, and all have the rectangle's size.
pub(super) fn update<'a>(
    name: &'a str,
    whole: Rectangle,
    channels: &'a [&'a str],
    planes: &'a [&'a [f32]],
) -> impl Iterator<Item = Vec<u8>> + 'a {
    pieces(whole, planes.len()).map(move |piece| {
        let count = planes.len() as u64;
        // Write the operation, the image and its channels
        let packet = Packet::new(UPDATE)
            .flag(false)
            .name(name)
            .numbers(&[planes.len() as u32]);
        // Describe interleaved pixels: channel i starts at float i, and the stride is the channel count
        let mut packet = channels
            .iter()
            .fold(packet, |packet, channel| packet.name(channel))
            .numbers(&[piece.x, piece.y, piece.width, piece.height])
            .long_numbers(0..count)
            .long_numbers(planes.iter().map(|_| count));
        // Interleave the planes row by row
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

/// Returns the parts of a rectangle that fit into one packet each: runs of rows, or parts of a row where rows are long.
fn pieces(whole: Rectangle, channel_count: usize) -> impl Iterator<Item = Rectangle> {
    let max_pixels = (MAX_BYTES / (size_of::<f32>() * channel_count)).max(1) as u32;
    let width = whole.width.min(max_pixels).max(1);
    let height = (max_pixels / width).max(1);
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
    fn packet_starts_with_its_length_and_operation() {
        // 4 bytes of length, 1 of the operation, 2 of the name, 1 of its terminator.
        assert_eq!(close("ab"), [8, 0, 0, 0, 2, b'a', b'b', 0]);
        assert_eq!(close("a\0b").len(), 5 + 1 + 3 + 1 + 1);
    }

    #[test]
    fn create_packet_has_size_and_channels() {
        let bytes = create("é", [258, 3], &["R", "Z"]);
        let rest = [
            4, 1, 0xc3, 0xa9, 0, 2, 1, 0, 0, 3, 0, 0, 0, 2, 0, 0, 0, b'R', 0, b'Z', 0,
        ];
        assert_eq!(bytes[..4], [25, 0, 0, 0]);
        assert_eq!(bytes[4..], rest);
    }

    #[test]
    fn pieces_tile_rectangles_of_any_shape() {
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
