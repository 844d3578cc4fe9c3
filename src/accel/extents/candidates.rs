//! Candidate bounding volumes of an object, and the spheres around shapes in a tree.

use super::guard::HitError;
use super::hull::HullPoints;
use super::kind::BoundingVolumeKind;
use super::shape::{BoundingVolume, BoxVolume, SphereVolume};
use crate::parallel;
use crate::scene::{Geometry, Instance, Scene};

/// Use of smallest enclosing spheres around shapes in a tree, tested before the shapes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spheres {
    /// No shape has a sphere.
    Never,
    /// All shapes have a sphere.
    Always,
}

/// Candidate bounding volumes of one object.
pub(crate) struct Candidates {
    pub(super) bounds: BoxVolume,
    pub(super) centroid: SphereVolume,
    pub(super) tight: SphereVolume,
}

impl Candidates {
    /// Computes the candidates of an instance; `None` if no volume is safe.
    pub(super) fn of(
        scene: &Scene,
        instance: &Instance,
        hull: &HullPoints,
    ) -> Option<(Candidates, HitError)> {
        let geometry = &scene.geometries[instance.geometry as usize];
        let guard = HitError::of(instance, geometry, hull.object_bounds())?;
        // Enclose the transformed points and widen by the error bound
        let map = instance.world_from_object();
        let balls = hull.world_balls(&map);
        let bounds = hull.world_bounds(&map, instance.world_bounds(geometry, hull.object_bounds()));
        let candidates = Candidates {
            bounds: BoxVolume::new(&bounds, &guard),
            centroid: SphereVolume::new(&balls.centroid, &guard),
            tight: SphereVolume::new(&balls.tight, &guard),
        };
        Some((candidates, guard))
    }

    /// Returns the volume of a kind; none for [`BoundingVolumeKind::Chosen`], which must be resolved before.
    pub(super) fn of_kind(&self, kind: BoundingVolumeKind) -> BoundingVolume {
        match kind {
            BoundingVolumeKind::None | BoundingVolumeKind::Chosen => BoundingVolume::None,
            BoundingVolumeKind::Box => BoundingVolume::Box(self.bounds),
            BoundingVolumeKind::CentroidSphere => BoundingVolume::Sphere(self.centroid),
            BoundingVolumeKind::TightSphere => BoundingVolume::Sphere(self.tight),
        }
    }
}

/// Returns the smallest spheres around shapes, by instance, for a tree that tests them; `None` where none is safe, and
/// for meshes and point clouds.
///
/// A cell of a tree contains several shapes, so many rays that reach a cell miss a shape in it.
pub(crate) fn shape_spheres(scene: &Scene) -> Vec<Option<SphereVolume>> {
    let hulls = parallel::map(scene.geometries.len(), &|index| {
        let geometry = &scene.geometries[index];
        match geometry {
            Geometry::Shape(_) => HullPoints::of(geometry),
            Geometry::Mesh(_) | Geometry::Points(_) => None,
        }
    });
    let sphere_of = |index: usize| {
        let instance = &scene.instances[index];
        let hull = hulls[instance.geometry as usize].as_ref()?;
        Some(Candidates::of(scene, instance, hull)?.0.tight)
    };
    parallel::map(scene.instances.len(), &sphere_of)
}
