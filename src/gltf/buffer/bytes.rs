//! Bytes of a buffer, read from a file or decoded, and decoded contents of buffer views and accessors.

use std::ops::{Deref, Range};
use std::sync::Arc;

use gltf::json::accessor::{ComponentType, Type};
use memmap2::MmapMut;

use crate::gltf::GltfError;

/// Bytes of a buffer, read from a file or decoded.
#[derive(Clone, Debug)]
pub(in crate::gltf) enum Bytes {
    File { map: Arc<MmapMut>, range: Range<usize> },
    Decoded(Arc<Vec<u8>>),
}

impl Bytes {
    /// Returns the bytes of a whole file.
    pub(in crate::gltf) fn whole(map: Arc<MmapMut>) -> Bytes {
        let range = 0..map.len();
        Bytes::File { map, range }
    }

    /// Returns the bytes of the whole file and the offset of the first of these; `None` for decoded bytes.
    pub(in crate::gltf) fn file(&self) -> Option<(&Arc<MmapMut>, usize)> {
        match self {
            Bytes::File { map, range } => Some((map, range.start)),
            Bytes::Decoded(_) => None,
        }
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            // The range was checked against the map when it was made.
            Bytes::File { map, range } => &map[range.clone()],
            Bytes::Decoded(bytes) => bytes,
        }
    }
}

/// Decoded bytes of a buffer view, or the reason why they cannot be decoded; `None` if the view is not compressed.
pub(in crate::gltf) type DecodedView = Option<Result<Bytes, GltfError>>;

/// Decoded contents of an accessor, packed.
pub(in crate::gltf) struct DecodedAccessor {
    pub(in crate::gltf) bytes: Vec<u8>,
    pub(in crate::gltf) count: usize,
    pub(in crate::gltf) component: ComponentType,
    pub(in crate::gltf) type_: Type,
}
