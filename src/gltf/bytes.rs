//! Bytes of a buffer, read from a file or decoded, and decoded contents of buffer views and accessors.

use std::ops::{Deref, Range};
use std::sync::Arc;

use gltf::json::accessor::{ComponentType, Type};
use memmap2::MmapMut;

use super::GltfError;

/// Bytes of a buffer, read from a file or decoded.
#[derive(Clone, Debug)]
pub(super) enum Bytes {
    File { map: Arc<MmapMut>, range: Range<usize> },
    Decoded(Arc<Vec<u8>>),
}

impl Bytes {
    /// Returns the bytes of a whole file.
    pub(super) fn whole(map: Arc<MmapMut>) -> Bytes {
        let range = 0..map.len();
        Bytes::File { map, range }
    }

    /// Returns the bytes of the whole file and the offset of the first of these; `None` for decoded bytes.
    pub(super) fn file(&self) -> Option<(&Arc<MmapMut>, usize)> {
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
pub(super) type DecodedView = Option<Result<Bytes, GltfError>>;

/// Decoded contents of an accessor, packed.
pub(super) struct DecodedAccessor {
    pub(super) bytes: Vec<u8>,
    pub(super) count: usize,
    pub(super) component: ComponentType,
    pub(super) type_: Type,
}
