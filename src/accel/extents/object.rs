//! Object of a scene behind its bounding volume.

use super::rays::{LaneValues, RayLanes};
use super::shape::BoundingVolume;
use crate::mesh::simd::SimdLevel;

/// An instance and the volume that is tested before it.
pub(crate) struct BoundedObject {
    pub(crate) instance: u32,
    pub(crate) extent: BoundingVolume,
}

impl BoundedObject {
    /// Returns the mask of lanes that may hit the object before `t_far`.
    #[inline(always)]
    pub(crate) fn hit_mask(&self, isa: impl SimdLevel, rays: &RayLanes, t_far: &LaneValues) -> u32 {
        match &self.extent {
            BoundingVolume::None => u32::MAX,
            BoundingVolume::Box(extent) => rays.hit_box_mask(isa, extent, t_far),
            BoundingVolume::Sphere(extent) => rays.hit_sphere_mask(isa, extent, t_far),
        }
    }

    /// Returns whether the object has a bounding volume.
    #[inline(always)]
    pub(crate) fn has_volume(&self) -> bool {
        self.extent != BoundingVolume::None
    }
}
