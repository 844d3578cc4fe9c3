//! Buffer views that meshoptimizer's codecs compressed: vertex attributes, triangles, and sequences of indices.
//!
//! A view's mode names the codec, and its filter a function of each decoded element. Sources: the specifications of
//! the glTF extensions `EXT_meshopt_compression` and `KHR_meshopt_compression` (Khronos Group), appendix A for the
//! codecs and appendix B for the filters. Both extensions share these streams; version 1 of the vertex codec and the
//! filter for colours came with the second.
//!
//! Every codec has a shortest encoding of a given number of elements. A stream that is shorter is refused before
//! memory is allocated for its elements, so that a small file cannot request more than 1024 times its size.

mod attributes;
mod byte_plane;
mod channel;
mod fault;
mod filters;
mod indices;
mod instruction_set;
mod triangles;
mod varint;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(super) use fault::MeshoptFault;

/// Codec of a compressed buffer view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StreamMode {
    /// Elements of any kind, as differences between the bytes of consecutive elements.
    Attributes,
    /// Indices of a list of triangles.
    Triangles,
    /// Indices of any other order.
    Indices,
}

/// Function that is applied to each element after it was decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ElementFilter {
    /// Elements as they were decoded.
    None,
    /// Unit vectors in octahedral coordinates of variable precision.
    Octahedral,
    /// Unit quaternions without their greatest component.
    Quaternion,
    /// Floating-point numbers with 8 bits of exponent and 24 bits of mantissa.
    Exponential,
    /// Colours as luma, two chroma components and alpha of variable precision.
    Color,
}

/// Shape of a compressed buffer view, as its extension object states it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StreamLayout {
    /// Codec of the stream.
    pub mode: StreamMode,
    /// Function of the decoded elements.
    pub filter: ElementFilter,
    /// Number of elements; of indices, not of triangles.
    pub count: usize,
    /// Size of a decoded element in bytes.
    pub stride: usize,
}

/// Returns the decoded bytes of a compressed buffer view: `count * stride` of them, without gaps.
pub(super) fn decode(layout: &StreamLayout, bytes: &[u8]) -> Result<Vec<u8>, MeshoptFault> {
    layout.check()?;
    layout.check_length(bytes)?;
    match layout.mode {
        StreamMode::Attributes => attributes::decode(layout, bytes),
        StreamMode::Triangles => triangles::decode(layout, bytes),
        StreamMode::Indices => indices::decode(layout, bytes),
    }
}

/// Returns the lowest bytes of an index.
#[inline(always)]
fn low_bytes<const SIZE: usize>(index: u32) -> [u8; SIZE] {
    let bytes = index.to_le_bytes();
    std::array::from_fn(|place| bytes[place])
}

impl StreamLayout {
    /// Checks the stride, the filter and the number of elements against the limits of the specification.
    fn check(&self) -> Result<(), MeshoptFault> {
        let StreamLayout {
            mode,
            filter,
            count,
            stride,
        } = *self;
        if !mode.allows_stride(stride) {
            return Err(MeshoptFault::Stride { mode, stride });
        }
        if mode != StreamMode::Attributes && filter != ElementFilter::None {
            return Err(MeshoptFault::FilterMode { mode, filter });
        }
        if !filter.allows_stride(stride) {
            return Err(MeshoptFault::FilterStride { filter, stride });
        }
        if mode == StreamMode::Triangles && !count.is_multiple_of(3) {
            return Err(MeshoptFault::PartialTriangle { count });
        }
        // A `Vec` holds at most `isize::MAX` bytes
        match count.checked_mul(stride) {
            Some(size) if isize::try_from(size).is_ok() => Ok(()),
            _ => Err(MeshoptFault::TooLarge { count, stride }),
        }
    }

    /// Checks that so many bytes can encode all elements.
    fn check_length(&self, bytes: &[u8]) -> Result<(), MeshoptFault> {
        let least = match self.mode {
            StreamMode::Attributes => attributes::min_length(self, bytes)?,
            StreamMode::Triangles => triangles::min_length(self.count),
            StreamMode::Indices => indices::min_length(self.count),
        };
        if bytes.len() < least {
            return Err(MeshoptFault::TooShort {
                length: bytes.len(),
                count: self.count,
                least,
            });
        }
        Ok(())
    }

    /// Checks the first byte of a codec with a single version.
    fn check_header(&self, bytes: &[u8], expected: u8) -> Result<(), MeshoptFault> {
        match bytes.first() {
            Some(&header) if header != expected => Err(MeshoptFault::Header {
                mode: self.mode,
                header,
            }),
            _ => Ok(()),
        }
    }
}

impl StreamMode {
    /// Returns the name that glTF has for the mode.
    fn name(self) -> &'static str {
        match self {
            StreamMode::Attributes => "ATTRIBUTES",
            StreamMode::Triangles => "TRIANGLES",
            StreamMode::Indices => "INDICES",
        }
    }

    /// Returns whether the mode can have elements of this size in bytes.
    fn allows_stride(self, stride: usize) -> bool {
        match self {
            StreamMode::Attributes => {
                (4..=attributes::MAX_STRIDE).contains(&stride) && stride.is_multiple_of(4)
            }
            StreamMode::Triangles | StreamMode::Indices => matches!(stride, 2 | 4),
        }
    }

    /// Returns the strides that the mode allows, in words.
    fn allowed_strides(self) -> &'static str {
        match self {
            StreamMode::Attributes => "a multiple of 4 up to 256",
            StreamMode::Triangles | StreamMode::Indices => "2 or 4",
        }
    }
}

impl ElementFilter {
    /// Returns the name that glTF has for the filter.
    fn name(self) -> &'static str {
        match self {
            ElementFilter::None => "NONE",
            ElementFilter::Octahedral => "OCTAHEDRAL",
            ElementFilter::Quaternion => "QUATERNION",
            ElementFilter::Exponential => "EXPONENTIAL",
            ElementFilter::Color => "COLOR",
        }
    }

    /// Returns whether the filter can have elements of this size in bytes, which the mode allows.
    fn allows_stride(self, stride: usize) -> bool {
        match self {
            ElementFilter::None | ElementFilter::Exponential => true,
            ElementFilter::Octahedral | ElementFilter::Color => matches!(stride, 4 | 8),
            ElementFilter::Quaternion => stride == 8,
        }
    }

    /// Returns the strides that the filter allows, in words.
    fn allowed_strides(self) -> &'static str {
        match self {
            ElementFilter::None | ElementFilter::Exponential => "a multiple of 4",
            ElementFilter::Octahedral | ElementFilter::Color => "4 or 8",
            ElementFilter::Quaternion => "8",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the fault of an empty stream with this layout.
    fn fault(mode: StreamMode, filter: ElementFilter, count: usize, stride: usize) -> MeshoptFault {
        let layout = StreamLayout {
            mode,
            filter,
            count,
            stride,
        };
        decode(&layout, &[]).unwrap_err()
    }

    #[test]
    fn strides_are_limited_by_the_mode() {
        for (mode, stride) in [
            (StreamMode::Attributes, 0),
            (StreamMode::Attributes, 6),
            (StreamMode::Attributes, 260),
            (StreamMode::Triangles, 1),
            (StreamMode::Triangles, 8),
            (StreamMode::Indices, 3),
        ] {
            assert_eq!(
                fault(mode, ElementFilter::None, 3, stride),
                MeshoptFault::Stride { mode, stride }
            );
        }
    }

    #[test]
    fn strides_are_limited_by_the_filter() {
        for (filter, stride) in [
            (ElementFilter::Octahedral, 12),
            (ElementFilter::Color, 16),
            (ElementFilter::Quaternion, 4),
        ] {
            let expected = MeshoptFault::FilterStride { filter, stride };
            assert_eq!(fault(StreamMode::Attributes, filter, 1, stride), expected);
        }
    }

    #[test]
    fn only_attributes_have_filters() {
        let mode = StreamMode::Indices;
        let filter = ElementFilter::Exponential;
        assert_eq!(
            fault(mode, filter, 1, 4),
            MeshoptFault::FilterMode { mode, filter }
        );
    }

    #[test]
    fn triangles_have_three_indices_each() {
        let fault = fault(StreamMode::Triangles, ElementFilter::None, 4, 2);
        assert_eq!(fault, MeshoptFault::PartialTriangle { count: 4 });
    }

    #[test]
    fn sizes_beyond_the_address_space_are_refused() {
        for count in [usize::MAX, usize::MAX / 16 + 2, usize::MAX / 32 + 1] {
            let fault = fault(StreamMode::Attributes, ElementFilter::None, count, 16);
            assert_eq!(fault, MeshoptFault::TooLarge { count, stride: 16 });
        }
    }

    #[test]
    fn streams_shorter_than_any_encoding_are_refused() {
        // 30 indices: header, 10 triangle codes, table of 16 bytes
        let layout = StreamLayout {
            mode: StreamMode::Triangles,
            filter: ElementFilter::None,
            count: 30,
            stride: 4,
        };
        let expected = MeshoptFault::TooShort {
            length: 26,
            count: 30,
            least: 27,
        };
        assert_eq!(decode(&layout, &[0xe1; 26]), Err(expected));
    }
}
