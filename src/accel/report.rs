//! Statistics of a built acceleration structure.

use serde::{Deserialize, Serialize};

/// Statistics of a built acceleration structure.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AccelReport {
    /// Bytes in use after the build, without vertex and index arrays shared with the scene.
    pub bytes: u64,
    /// Peak bytes in use at any time of the build.
    pub peak_bytes: u64,
    /// Version and instruction set, if the backend is Embree.
    pub embree: Option<EmbreeIdentity>,
    /// One line for people: kind and size of the structure.
    pub summary: String,
    /// Breakdown of `bytes` by use; the sizes add up to it.
    pub parts: Vec<AccelPart>,
}

/// A part of an acceleration structure, with its memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccelPart {
    /// Memory category: `triangles` or `user-geometry` (shapes and instanced meshes) if the part serves one of them
    /// alone, `tree` if both; `extents` for bounding volumes tested before objects.
    pub holder: &'static str,
    /// Human-readable label of the part.
    pub what: &'static str,
    /// Size of the part in bytes.
    pub bytes: u64,
}

/// Returns the memory category of a tree over this many triangles and this many objects tested as a whole.
pub(crate) fn holder_of_tree(triangle_count: usize, object_count: usize) -> &'static str {
    match (triangle_count, object_count) {
        (_, 0) => "triangles",
        (0, _) => "user-geometry",
        _ => "tree",
    }
}

/// Version and instruction set of an Embree device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmbreeIdentity {
    /// Version number, for example `3.13.5`.
    pub version: String,
    /// Instruction set, for example `avx2`.
    pub isa: String,
}
