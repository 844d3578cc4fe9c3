//! Bounding volumes around objects, tested before the objects themselves.
//!
//! * [`BoxVolume`] is the bounding box of the object, [`SphereVolume`] a bounding sphere: the centroid sphere, whose
//!   centre is the centroid of the vertices, or the smallest one ([`BoundingSphere`]).
//! * [`BoundingVolumeKind::Chosen`] takes for every object the volume that measured costs make cheapest, or none.
//! * [`ScreenBounds`] are screen-space bounding boxes: a camera ray cannot hit an object whose box does not
//!   contain its pixel, so no arithmetic on rays is needed to skip it.
//! * [`ListAccel`] is a list of objects, each behind its bounding volume, with counters of the tests that the volumes
//!   save.
//!
//! A bounding volume changes the time, never a result: [`guard`] bounds the rounding errors of hits, and volumes are
//! that much wider. Planes have none, nor have instance transforms that are too extreme for the bound.

mod ball;
mod choice;
mod guard;
mod hull;
mod list;
mod projection;
mod rays;
mod shape;
mod tiles;

pub use ball::BoundingSphere;
pub use list::{ListAccel, Tally};
pub use projection::{ScreenBounds, ScreenBox};
pub use shape::{BoxVolume, SphereVolume};
pub use tiles::{ListLimits, TileCulledAccel};

use self::choice::Costs;
use self::guard::HitError;
use self::hull::HullPoints;
use self::rays::{Lanes, RayLanes};
use self::shape::BoundingVolume;
use crate::mesh::simd::SimdLevel;
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, Instance, Scene};

/// Kind of bounding volume for objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum BoundingVolumeKind {
    /// No volume: every object is tested.
    None,
    /// Axis-aligned boxes in world space.
    Box,
    /// Centroid spheres, around the mean of the vertices.
    CentroidSphere,
    /// Smallest enclosing spheres of the objects.
    TightSphere,
    /// For every object the cheapest kind by measured costs.
    Chosen,
}

impl BoundingVolumeKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [BoundingVolumeKind; 5] = [
        BoundingVolumeKind::None,
        BoundingVolumeKind::Box,
        BoundingVolumeKind::CentroidSphere,
        BoundingVolumeKind::TightSphere,
        BoundingVolumeKind::Chosen,
    ];
}

impl std::fmt::Display for BoundingVolumeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.pad(match self {
            BoundingVolumeKind::None => "none",
            BoundingVolumeKind::Box => "box",
            BoundingVolumeKind::CentroidSphere => "centroid sphere",
            BoundingVolumeKind::TightSphere => "tight sphere",
            BoundingVolumeKind::Chosen => "chosen",
        })
    }
}

/// Use of smallest enclosing spheres around shapes in a tree, tested before the shapes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spheres {
    /// No shape has a sphere.
    Never,
    /// All shapes have a sphere.
    Always,
}

/// Numbers of objects by kind of bounding volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct BoundingVolumeCounts {
    /// Objects without a bounding volume.
    pub none: u64,
    /// Objects behind a box.
    pub boxes: u64,
    /// Objects behind a centroid sphere.
    pub centroid_spheres: u64,
    /// Objects behind the smallest sphere.
    pub tight_spheres: u64,
}

/// The objects of a scene without planes, each with its bounding volume.
pub(crate) struct BoundingVolumes {
    objects: Vec<Object>,
    origin_factor: f32,
    counts: BoundingVolumeCounts,
}

/// An instance and the volume that is tested before it.
pub(crate) struct Object {
    pub(crate) instance: u32,
    pub(crate) extent: BoundingVolume,
}

/// Candidate bounding volumes of one object.
pub(crate) struct Candidates {
    bounds: BoxVolume,
    centroid: SphereVolume,
    tight: SphereVolume,
}

impl Candidates {
    /// Computes the candidates of an instance; `None` if no volume is safe.
    fn of(scene: &Scene, instance: &Instance, hull: &HullPoints) -> Option<(Candidates, HitError)> {
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
    fn of_kind(&self, kind: BoundingVolumeKind) -> BoundingVolume {
        match kind {
            BoundingVolumeKind::None | BoundingVolumeKind::Chosen => BoundingVolume::None,
            BoundingVolumeKind::Box => BoundingVolume::Box(self.bounds),
            BoundingVolumeKind::CentroidSphere => BoundingVolume::Sphere(self.centroid),
            BoundingVolumeKind::TightSphere => BoundingVolume::Sphere(self.tight),
        }
    }
}

impl BoundingVolumes {
    /// Computes volumes of one kind for all objects that may have one. [`BoundingVolumeKind::Chosen`] takes some milliseconds
    /// to measure.
    pub(crate) fn new(scene: &Scene, kind: BoundingVolumeKind) -> BoundingVolumes {
        BoundingVolumes::of_hulls(scene, &hulls_of(scene), kind)
    }

    /// Computes volumes of one kind from known hulls, one per geometry.
    fn of_hulls(scene: &Scene, hulls: &[Option<HullPoints>], kind: BoundingVolumeKind) -> BoundingVolumes {
        // Measure the costs of tests if the kind is to be chosen
        let costs = (kind == BoundingVolumeKind::Chosen).then(|| Costs::measure(scene, hulls));
        // Compute the volume of each instance
        let object = |index: usize| -> Option<(Object, BoundingVolumeKind, f64)> {
            let instance = &scene.instances[index];
            let hull = hulls[instance.geometry as usize].as_ref()?;
            let without = Object {
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
            Some((Object { extent, ..without }, kind, guard.origin_factor))
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
    pub(crate) fn objects(&self) -> &[Object] {
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

/// Computes the hulls of all geometries.
fn hulls_of(scene: &Scene) -> Vec<Option<HullPoints>> {
    parallel::map(scene.geometries.len(), &|index| {
        HullPoints::of(&scene.geometries[index])
    })
}

/// Returns the smallest spheres around shapes, by instance, for a tree that tests them; `None` where none is safe, and
/// for meshes.
///
/// A cell of a tree contains several shapes, so many rays that reach a cell miss a shape in it.
pub(crate) fn shape_spheres(scene: &Scene) -> Vec<Option<SphereVolume>> {
    let hulls = parallel::map(scene.geometries.len(), &|index| {
        let geometry = &scene.geometries[index];
        match geometry {
            Geometry::Shape(_) => HullPoints::of(geometry),
            Geometry::Mesh(_) => None,
        }
    });
    let sphere_of = |index: usize| {
        let instance = &scene.instances[index];
        let hull = hulls[instance.geometry as usize].as_ref()?;
        Some(Candidates::of(scene, instance, hull)?.0.tight)
    };
    parallel::map(scene.instances.len(), &sphere_of)
}

impl Object {
    /// Returns the mask of lanes that may hit the object before `t_far`.
    #[inline(always)]
    pub(crate) fn hit_mask(&self, isa: impl SimdLevel, rays: &RayLanes, t_far: &Lanes) -> u32 {
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

impl BoundingVolumeCounts {
    fn add(&mut self, kind: BoundingVolumeKind) {
        *match kind {
            BoundingVolumeKind::None | BoundingVolumeKind::Chosen => &mut self.none,
            BoundingVolumeKind::Box => &mut self.boxes,
            BoundingVolumeKind::CentroidSphere => &mut self.centroid_spheres,
            BoundingVolumeKind::TightSphere => &mut self.tight_spheres,
        } += 1;
    }
}

/// Returns the surface area of a box.
fn surface(bounds: &Bounds) -> f64 {
    let e = bounds.extent();
    2.0 * (e.x * e.y + e.y * e.z + e.z * e.x)
}
