//! Faults of compressed buffer views.

use super::{ElementFilter, StreamMode};

/// Reason why a compressed buffer view cannot be decoded: a clause that continues "buffer view 3".
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub(in crate::gltf) enum MeshoptFault {
    /// The distance between elements does not suit the mode.
    #[error("has a stride of {stride} bytes: mode {} takes {}", .mode.name(), .mode.allowed_strides())]
    Stride {
        /// Mode of the view.
        mode: StreamMode,
        /// Stride of the view in bytes.
        stride: usize,
    },
    /// The distance between elements does not suit the filter.
    #[error("has a stride of {stride} bytes: filter {} takes {}", .filter.name(), .filter.allowed_strides())]
    FilterStride {
        /// Filter of the view.
        filter: ElementFilter,
        /// Stride of the view in bytes.
        stride: usize,
    },
    /// The mode has no filters.
    #[error("has filter {}, which mode {} does not allow", .filter.name(), .mode.name())]
    FilterMode {
        /// Mode of the view.
        mode: StreamMode,
        /// Filter of the view.
        filter: ElementFilter,
    },
    /// The number of indices is not a multiple of three.
    #[error("has {count} indices, which is not a whole number of triangles")]
    PartialTriangle {
        /// Number of indices of the view.
        count: usize,
    },
    /// The decoded size is more than can be addressed or allocated.
    #[error("has {count} elements of {stride} bytes, more than fit into memory")]
    TooLarge {
        /// Number of elements of the view.
        count: usize,
        /// Stride of the view in bytes.
        stride: usize,
    },
    /// The bytes are fewer than any encoding of so many elements takes.
    #[error("is truncated: it has {length} bytes, and its {count} elements take at least {least}")]
    TooShort {
        /// Number of compressed bytes.
        length: usize,
        /// Number of elements of the view.
        count: usize,
        /// Least number of bytes for so many elements.
        least: usize,
    },
    /// The first byte is not one of the mode.
    #[error("starts with byte {header:#04x}, which is not a supported version of mode {}", .mode.name())]
    Header {
        /// Mode of the view.
        mode: StreamMode,
        /// First byte of the stream.
        header: u8,
    },
    /// The stream ends inside one of its items.
    #[error("is truncated: its {item} {number} ends early")]
    Truncated {
        /// Kind of the item, for example `vertex block`.
        item: &'static str,
        /// Number of the item, from zero.
        number: usize,
    },
    /// Bytes are left after the last element.
    #[error("has {length} bytes left after its last element")]
    Surplus {
        /// Number of bytes that are left.
        length: usize,
    },
    /// A channel mode byte has no meaning.
    #[error("has channel mode {mode:#04x} in channel {channel}, which is not defined")]
    ChannelMode {
        /// Channel, which is four bytes of an element.
        channel: usize,
        /// Mode byte of the channel.
        mode: u8,
    },
    /// The table of triangle codes has an entry that is not allowed.
    #[error("has {entry:#04x} at place {place} of its triangle code table, which is not allowed")]
    CodeTable {
        /// Place in the table.
        place: usize,
        /// Value of the entry.
        entry: u8,
    },
    /// A triangle refers to an edge or a vertex before the first.
    #[error("refers in triangle {triangle} to an edge or a vertex before the first")]
    UnwrittenEntry {
        /// Number of the triangle, from zero.
        triangle: usize,
    },
    /// A variable-length number has more than five bytes.
    #[error("has a number of more than 5 bytes in {item} {number}")]
    LongNumber {
        /// Kind of the item, `triangle` or `index`.
        item: &'static str,
        /// Number of the item, from zero.
        number: usize,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_continue_a_sentence_about_the_buffer_view() {
        let truncated = MeshoptFault::Truncated {
            item: "vertex block",
            number: 2,
        };
        assert_eq!(
            truncated.to_string(),
            "is truncated: its vertex block 2 ends early"
        );
        let stride = MeshoptFault::Stride {
            mode: StreamMode::Attributes,
            stride: 6,
        };
        assert_eq!(
            stride.to_string(),
            "has a stride of 6 bytes: mode ATTRIBUTES takes a multiple of 4 up to 256"
        );
    }
}
