//! What was built for the meshes of scenes before, for those that are built next: from frame to frame of a film most
//! meshes stay as they are.
//!
//! Embree's watertight triangles are kept, which take most of the time of a build; trees are built anew. What is kept is
//! a function of a mesh alone, so no answer depends on whether it was.

#[cfg(feature = "embree")]
use super::embree::{BuiltMeshes, TriangleClusters};

/// Where it is kept from one build to the next.
#[derive(Default)]
pub struct MeshCache {
    #[cfg(feature = "embree")]
    pub(super) patches: BuiltMeshes<TriangleClusters>,
}

/// How often meshes were asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshCounts {
    /// In all.
    pub asked: usize,
    /// And were there.
    pub found: usize,
}

impl MeshCache {
    /// Forgets the meshes that the scenes built last did not have.
    pub fn evict_unused(&self) {
        #[cfg(feature = "embree")]
        self.patches.evict_unused();
    }

    /// Of how many meshes anything was asked for, and there.
    pub fn counts(&self) -> MeshCounts {
        #[cfg(feature = "embree")]
        return self.patches.counts();
        #[cfg(not(feature = "embree"))]
        MeshCounts::default()
    }

    /// Bytes of all that is kept.
    pub fn byte_count(&self) -> u64 {
        #[cfg(feature = "embree")]
        return self.patches.byte_count(TriangleClusters::byte_count);
        #[cfg(not(feature = "embree"))]
        0
    }
}
