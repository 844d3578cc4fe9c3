//! Objects of a scene, each with its bounding volume.

use super::candidates::Candidates;
use super::choice::Costs;
use super::hull::{HullPoints, hulls_of};
use super::kind::{BoundingVolumeCounts, BoundingVolumeKind};
use super::object::BoundedObject;
use super::shape::BoundingVolume;
use crate::parallel;
use crate::scene::Scene;

/// The objects of a scene without planes, each with its bounding volume.
pub(crate) struct BoundingVolumes {
    objects: Vec<BoundedObject>,
    origin_factor: f32,
    counts: BoundingVolumeCounts,
}

impl BoundingVolumes {
    /// Computes volumes of one kind for all objects that may have one. [`BoundingVolumeKind::Chosen`] takes some milliseconds
    /// to measure.
    pub(crate) fn new(scene: &Scene, kind: BoundingVolumeKind) -> BoundingVolumes {
        BoundingVolumes::of_hulls(scene, &hulls_of(scene), kind)
    }

    /// Computes volumes of one kind from known hulls, one per geometry.
    pub(super) fn of_hulls(
        scene: &Scene,
        hulls: &[Option<HullPoints>],
        kind: BoundingVolumeKind,
    ) -> BoundingVolumes {
        // Measure the costs of tests if the kind is to be chosen
        let costs = (kind == BoundingVolumeKind::Chosen).then(|| Costs::measure(scene, hulls));
        // Compute the volume of each instance
        let object = |index: usize| -> Option<(BoundedObject, BoundingVolumeKind, f64)> {
            let instance = &scene.instances[index];
            let hull = hulls[instance.geometry as usize].as_ref()?;
            let without = BoundedObject {
                instance: index as u32,
                extent: BoundingVolume::None,
            };
            let candidates = if kind == BoundingVolumeKind::None {
                None
            } else {
                Candidates::of(scene, instance, hull)
            };
            let Some((candidates, guard)) = candidates else {
                return Some((without, BoundingVolumeKind::None, 0.0));
            };
            let kind = costs
                .as_ref()
                .map_or(kind, |costs| costs.cheapest(instance.geometry, &candidates));
            let extent = candidates.of_kind(kind);
            Some((BoundedObject { extent, ..without }, kind, guard.origin_factor))
        };
        // Collect the objects and the largest error factor of ray origins
        let objects = parallel::map(scene.instances.len(), &object);
        let mut extents = BoundingVolumes {
            objects: Vec::with_capacity(objects.len()),
            origin_factor: 0.0,
            counts: BoundingVolumeCounts::default(),
        };
        for (object, kind, origin_factor) in objects.into_iter().flatten() {
            extents.objects.push(object);
            extents.origin_factor = extents.origin_factor.max((origin_factor as f32).next_up());
            extents.counts.add(kind);
        }
        extents
    }

    /// Returns the objects, in the order of their instances.
    pub(crate) fn objects(&self) -> &[BoundedObject] {
        &self.objects
    }

    /// Returns the numbers of objects by kind of volume.
    pub(crate) fn counts(&self) -> BoundingVolumeCounts {
        self.counts
    }

    /// Returns the largest error factor of ray origins, for [`RayLanes::new`].
    pub(crate) fn origin_factor(&self) -> f32 {
        self.origin_factor
    }
}
