//! Buffers and buffer views: bytes of the binary chunk, of other files and of data URIs.

pub(super) mod accessor;
pub(super) mod bytes;
mod compressed_view;
mod meshopt;
pub(super) mod whole_file;

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::alphabet;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use memmap2::MmapMut;
use percent_encoding::{percent_decode, percent_decode_str};

use crate::gltf::GltfError;
use crate::gltf::buffer::bytes::Bytes;
use crate::gltf::buffer::whole_file::read_file;
use crate::gltf::document::GltfDocument;
use crate::gltf::error::EXPORT_AGAIN;

/// Bytes of a buffer view.
pub(in crate::gltf) struct BufferWindow<'a> {
    pub(in crate::gltf) bytes: &'a [u8],
    /// Distance between elements in bytes, if the view states one.
    pub(in crate::gltf) stride: Option<usize>,
    /// Mapped file and the offset of the first byte in it.
    pub(in crate::gltf) file: Option<(&'a Arc<MmapMut>, usize)>,
}

/// Range of bytes of a buffer, as the file states it.
#[derive(Clone, Copy)]
pub(in crate::gltf) struct BufferRange {
    pub(in crate::gltf) buffer: usize,
    pub(in crate::gltf) offset: u64,
    pub(in crate::gltf) length: u64,
}

impl<'a> BufferWindow<'a> {
    /// Returns the window without its first `offset` bytes; `None` if it is shorter.
    pub(in crate::gltf) fn skip(self, offset: usize) -> Option<BufferWindow<'a>> {
        Some(BufferWindow {
            bytes: self.bytes.get(offset..)?,
            file: self.file.map(|(map, start)| (map, start + offset)),
            ..self
        })
    }
}

/// Base64 decoder that accepts any padding, as exporters differ in whether they pad.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

impl GltfDocument {
    /// Returns the bytes of a buffer view, checked against its buffer.
    pub(in crate::gltf) fn view(&self, number: usize) -> Result<BufferWindow<'_>, GltfError> {
        let views = &self.root.buffer_views;
        let Some(view) = views.get(number) else {
            return Err(self.missing("buffer view", number, views.len()));
        };
        if let Some(Some(decoded)) = self.decoded_views.get(number) {
            return Ok(BufferWindow {
                bytes: decoded.as_ref().map_err(Clone::clone)?,
                stride: view.byte_stride.map(|s| s.0),
                file: None,
            });
        }
        let range = BufferRange {
            buffer: view.buffer.value(),
            offset: view.byte_offset.map_or(0, |o| o.0),
            length: view.byte_length.0,
        };
        Ok(BufferWindow {
            stride: view.byte_stride.map(|s| s.0),
            ..self.range(range, number)?
        })
    }

    /// Returns the bytes of a range of a buffer, for the buffer view with this number.
    pub(in crate::gltf) fn range(
        &self,
        range: BufferRange,
        view: usize,
    ) -> Result<BufferWindow<'_>, GltfError> {
        let BufferRange { offset, length, .. } = range;
        let buffer = self.buffer(range.buffer)?;
        let window = usize::try_from(offset)
            .ok()
            .zip(usize::try_from(length).ok())
            .and_then(|(offset, length)| Some((offset, buffer.get(offset..offset.checked_add(length)?)?)));
        let Some((offset, bytes)) = window else {
            let fault = format!(
                "spans {length} bytes from {offset} on, past the end of buffer {} ({} bytes)",
                range.buffer,
                buffer.len()
            );
            return Err(self.fault(format!("buffer view {view}"), fault, EXPORT_AGAIN));
        };
        Ok(BufferWindow {
            bytes,
            stride: None,
            file: buffer.file().map(|(map, start)| (map, start + offset)),
        })
    }

    /// Returns the bytes of a buffer, which is opened on first use.
    fn buffer(&self, number: usize) -> Result<&Bytes, GltfError> {
        let Some(slot) = self.buffers.get(number) else {
            return Err(self.missing("buffer", number, self.buffers.len()));
        };
        slot.get_or_init(|| self.open_buffer(number))
            .as_ref()
            .map_err(Clone::clone)
    }

    fn open_buffer(&self, number: usize) -> Result<Bytes, GltfError> {
        let item = format!("buffer {number}");
        let buffer = &self.root.buffers[number];
        let bytes = match (&buffer.uri, &self.binary_chunk) {
            (Some(uri), _) => self.resolve(uri, &item)?,
            // Only the first buffer may be the binary chunk
            (None, Some(chunk)) if number == 0 => chunk.clone(),
            (None, _) => {
                let fault = "has neither a URI nor a binary chunk";
                return Err(self.fault(item, fault, EXPORT_AGAIN));
            }
        };
        // A file may be longer than its buffer, as chunks are padded
        if (bytes.len() as u64) < buffer.byte_length.0 {
            let fault = format!(
                "holds {} bytes of the {} it states",
                bytes.len(),
                buffer.byte_length.0
            );
            return Err(self.fault(item, fault, "copy or export the file again, it is truncated"));
        }
        Ok(bytes)
    }

    /// Returns the bytes of a URI: a data URI's content, or a file relative to this one.
    pub(in crate::gltf) fn resolve(&self, uri: &str, item: &str) -> Result<Bytes, GltfError> {
        // Decode a data URI
        if let Some(data) = uri.strip_prefix("data:") {
            return match decode_data_uri(data) {
                Some(bytes) => Ok(Bytes::Decoded(Arc::new(bytes))),
                None => Err(self.fault(item, "has a data URI that cannot be decoded", EXPORT_AGAIN)),
            };
        }
        // Reject URLs, as nothing is downloaded
        if uri.contains("://") {
            let fault = format!("is at `{}`", truncated_uri(uri));
            return Err(self.fault(item, fault, "download it and put its file name instead"));
        }
        // Read the file, whose name may be percent-encoded
        let Ok(name) = percent_decode_str(uri).decode_utf8() else {
            let fault = format!("has the URI `{}`, which is not UTF-8", truncated_uri(uri));
            return Err(self.fault(item, fault, EXPORT_AGAIN));
        };
        if !self.allows_outside && leaves_folder(Path::new(name.as_ref())) {
            let fault = format!("is in `{}`, outside of the file's folder", truncated_uri(uri));
            let advice = "put it into that folder, or allow others by `--allow-outside`";
            return Err(self.fault(item, fault, advice));
        }
        let folder = self.file.parent().map_or_else(PathBuf::new, PathBuf::from);
        let path = folder.join(name.as_ref());
        let map = read_file(&path).map_err(|e| {
            let fault = match e {
                GltfError::Unreadable { fault, .. } | GltfError::NotGltf { fault, .. } => fault,
                other => other.to_string(),
            };
            let fault = format!("is in `{}`, but {fault}", path.display());
            self.fault(item, fault, "put the file there or correct the URI")
        })?;
        Ok(Bytes::whole(map))
    }
}

/// Returns whether a path relative to a folder leads out of it, by its names: links are not followed.
fn leaves_folder(path: &Path) -> bool {
    let mut depth = 0i32;
    path.components().any(|component| {
        match component {
            Component::Normal(_) => depth += 1,
            Component::ParentDir => depth -= 1,
            Component::CurDir => {}
            // An absolute path leaves at once
            Component::RootDir | Component::Prefix(_) => return true,
        }
        depth < 0
    })
}

/// Decodes a data URI without its `data:`.
fn decode_data_uri(data: &str) -> Option<Vec<u8>> {
    let (kind, content) = data.split_once(',')?;
    if kind.ends_with(";base64") {
        // The base64 text may itself be percent-encoded
        if content.contains('%') {
            let plain: Vec<u8> = percent_decode_str(content).collect();
            return BASE64.decode(plain).ok();
        }
        return BASE64.decode(content).ok();
    }
    Some(percent_decode(content.as_bytes()).collect())
}

/// Returns a URI shortened to a length that fits into a message.
fn truncated_uri(uri: &str) -> String {
    const LENGTH: usize = 80;
    if uri.chars().count() <= LENGTH {
        return uri.into();
    }
    uri.chars().take(LENGTH).chain("...".chars()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_decode_with_and_without_base64_and_padding() {
        for uri in [
            "application/octet-stream;base64,AAEC/w==",
            ";base64,AAEC/w",
            ";base64,AAEC%2Fw%3D%3D",
            ",%00%01%02%ff",
        ] {
            assert_eq!(decode_data_uri(uri), Some(vec![0, 1, 2, 255]), "{uri}");
        }
        assert_eq!(decode_data_uri("image/png;base64"), None);
        assert_eq!(decode_data_uri(";base64,***"), None);
    }

    #[test]
    fn paths_with_more_steps_up_than_down_leave_the_folder() {
        for inside in ["a.bin", "./a.bin", "b/../a.bin", "b/c/../../a.bin", "..a/b"] {
            assert!(!leaves_folder(Path::new(inside)), "{inside}");
        }
        for outside in [
            "../a.bin",
            "b/../../a.bin",
            "/etc/passwd",
            "./../a",
            "b/../../b/a",
        ] {
            assert!(leaves_folder(Path::new(outside)), "{outside}");
        }
    }

    #[test]
    fn long_uri_is_cut_between_characters() {
        assert_eq!(truncated_uri(&"é".repeat(200)).chars().count(), 83);
    }
}
