//! Bytes of a buffer, mapped or decoded, and decoded contents of buffer views and accessors.

use std::ops::{Deref, Range};
use std::sync::Arc;

use gltf::json::accessor::{ComponentType, Type};
use memmap2::Mmap;

use super::GltfError;

/// Bytes of a buffer, mapped or decoded.
#[derive(Clone, Debug)]
pub(super) enum Bytes {
    Mapped { map: Arc<Mmap>, range: Range<usize> },
    Decoded(Arc<Vec<u8>>),
}

impl Bytes {
    /// Returns the bytes of a whole mapped file.
    pub(super) fn whole(map: Arc<Mmap>) -> Bytes {
        let range = 0..map.len();
        Bytes::Mapped { map, range }
    }

    /// Returns the mapped file and the offset of the first byte in it; `None` for decoded bytes.
    pub(super) fn mapped(&self) -> Option<(&Arc<Mmap>, usize)> {
        match self {
            Bytes::Mapped { map, range } => Some((map, range.start)),
            Bytes::Decoded(_) => None,
        }
    }
}

impl Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            // The range was checked against the map when it was made.
            Bytes::Mapped { map, range } => &map[range.clone()],
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
