//! Images in KTX2 containers with Basis Universal's codecs: `KHR_texture_basisu`, with the feature `basisu` of the
//! build.

use crate::buffer::Buffer;

/// First bytes of every KTX2 file (Khronos Texture File Format 2.0, section 3.1).
const IDENTIFIER: [u8; 12] = *b"\xabKTX 20\xbb\r\n\x1a\n";
/// Offset in bytes of the width, before the height.
const WIDTH_OFFSET: usize = 20;

/// Returns the width and the height of a KTX2 image; `None` for bytes of other formats.
pub(in crate::gltf) fn size(bytes: &[u8]) -> Option<[u32; 2]> {
    let words = bytes
        .strip_prefix(&IDENTIFIER)?
        .get(WIDTH_OFFSET - IDENTIFIER.len()..)?;
    let (words, _) = words.as_chunks::<4>();
    Some([
        u32::from_le_bytes(*words.first()?),
        u32::from_le_bytes(*words.get(1)?),
    ])
}

/// Returns the texels of the largest level of a KTX2 image.
#[cfg(feature = "basisu")]
pub(in crate::gltf) fn texels(bytes: &[u8]) -> Result<Buffer<[u8; 4]>, String> {
    use basisu::{DecodeFlags, TargetFormat, Transcoder};

    use crate::buffer::BufferMut;

    let fault = |error: basisu::Error| format!("{error:?}");
    let transcoder = Transcoder::new(bytes).map_err(fault)?;
    let codes = transcoder
        .transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE)
        .map_err(fault)?;
    let mut texels = BufferMut::zeroed(codes.len() / 4);
    texels.as_flattened_mut().copy_from_slice(&codes);
    Ok(texels.freeze())
}

/// Returns the reason why a KTX2 image cannot be decoded.
#[cfg(not(feature = "basisu"))]
pub(in crate::gltf) fn texels(_: &[u8]) -> Result<Buffer<[u8; 4]>, String> {
    Err("this program was built without the feature `basisu`".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_is_read_from_the_header() {
        let mut bytes = IDENTIFIER.to_vec();
        bytes.extend([0; 8]);
        bytes.extend([0, 1, 0, 0, 3, 0, 0, 0]);
        assert_eq!(size(&bytes), Some([256, 3]));
        for end in 0..bytes.len() {
            assert_eq!(size(&bytes[..end]), None);
        }
        assert_eq!(size(&[0; 64]), None);
    }
}
