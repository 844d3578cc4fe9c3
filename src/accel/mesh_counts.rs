//! Lookup statistics of the cache of per-mesh build results.

/// Lookup statistics of the cache.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshCounts {
    /// Number of meshes looked up.
    pub requested: usize,
    /// Number of meshes that were in the cache.
    pub found: usize,
}
