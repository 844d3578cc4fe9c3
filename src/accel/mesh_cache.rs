//! Cache of per-mesh build results across scenes: between the frames of an animation most meshes stay unchanged.
//!
//! It keeps Embree's watertight triangle clusters, which take most of the time of a build; trees are built anew. An
//! entry is a function of its mesh alone, so no result depends on whether it was cached.

#[cfg(feature = "embree")]
use super::embree::{BuiltMeshes, TriangleClusters};
use super::mesh_counts::MeshCounts;

/// Store of triangle clusters that lives from one build to the next.
#[derive(Default)]
pub struct MeshCache {
    #[cfg(feature = "embree")]
    pub(super) patches: BuiltMeshes<TriangleClusters>,
}

impl MeshCache {
    /// Evicts the meshes that the scenes built last did not contain.
    pub fn evict_unused(&self) {
        #[cfg(feature = "embree")]
        self.patches.evict_unused();
    }

    /// Returns the number of lookups and cache hits.
    pub fn counts(&self) -> MeshCounts {
        #[cfg(feature = "embree")]
        return self.patches.counts();
        #[cfg(not(feature = "embree"))]
        MeshCounts::default()
    }

    /// Returns the number of bytes held by all entries.
    pub fn byte_count(&self) -> u64 {
        #[cfg(feature = "embree")]
        return self.patches.byte_count(TriangleClusters::byte_count);
        #[cfg(not(feature = "embree"))]
        0
    }
}
