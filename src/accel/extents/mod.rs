//! Bounding volumes around objects, tested before the objects themselves.
//!
//! * [`BoxExtent`] is the bounding box of the object, [`SphereExtent`] a bounding sphere: the centroid sphere, whose
//!   centre is the centroid of the vertices, or the smallest one ([`Ball`]).
//! * [`ExtentKind::Chosen`] takes for every object the volume that measured costs make cheapest, or none.
//! * [`ProjectionExtents`] are screen-space bounding boxes: a camera ray cannot hit an object whose box does not
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

pub use ball::Ball;
pub use list::{ListAccel, Tally};
pub use projection::{FilmBox, ProjectionExtents};
pub use shape::{BoxExtent, SphereExtent};
pub use tiles::{ListLimits, ProjectedAccel};

use self::choice::Costs;
use self::guard::Guard;
use self::hull::Hull;
use self::rays::{Lanes, RayLanes};
use self::shape::Extent;
use crate::mesh::simd::SimdLevel;
use crate::numeric::Bounds;
use crate::parallel;
use crate::scene::{Geometry, Instance, Scene};

/// Kind of bounding volume for objects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExtentKind {
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

impl ExtentKind {
    /// All kinds, in the order of their declaration.
    pub const ALL: [ExtentKind; 5] = [
        ExtentKind::None,
        ExtentKind::Box,
        ExtentKind::CentroidSphere,
        ExtentKind::TightSphere,
        ExtentKind::Chosen,
    ];
}

impl std::fmt::Display for ExtentKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.pad(match self {
            ExtentKind::None => "none",
            ExtentKind::Box => "box",
            ExtentKind::CentroidSphere => "centroid sphere",
            ExtentKind::TightSphere => "tight sphere",
            ExtentKind::Chosen => "chosen",
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
pub struct ExtentCounts {
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
pub(crate) struct Extents {
    objects: Vec<Object>,
    by_origin: f32,
    counts: ExtentCounts,
}

/// An instance and the volume that is tested before it.
pub(crate) struct Object {
    pub(crate) instance: u32,
    pub(crate) extent: Extent,
}

/// Candidate bounding volumes of one object.
pub(crate) struct Offers {
    bounds: BoxExtent,
    centroid: SphereExtent,
    tight: SphereExtent,
}

impl Offers {
    /// Computes the candidates of an instance; `None` if no volume is safe.
    fn of(scene: &Scene, instance: &Instance, hull: &Hull) -> Option<(Offers, Guard)> {
        let geometry = &scene.geometries[instance.geometry as usize];
        let guard = Guard::of(instance, geometry, hull.object_bounds())?;
        // Enclose the transformed points and widen by the error bound
        let map = instance.world_from_object();
        let balls = hull.world_balls(&map);
        let bounds = hull.world_bounds(&map, instance.world_bounds(geometry, hull.object_bounds()));
        let offers = Offers {
            bounds: BoxExtent::new(&bounds, &guard),
            centroid: SphereExtent::new(&balls.centroid, &guard),
            tight: SphereExtent::new(&balls.tight, &guard),
        };
        Some((offers, guard))
    }

    /// Returns the volume of a kind; none for [`ExtentKind::Chosen`], which must be resolved before.
    fn of_kind(&self, kind: ExtentKind) -> Extent {
        match kind {
            ExtentKind::None | ExtentKind::Chosen => Extent::None,
            ExtentKind::Box => Extent::Box(self.bounds),
            ExtentKind::CentroidSphere => Extent::Sphere(self.centroid),
            ExtentKind::TightSphere => Extent::Sphere(self.tight),
        }
    }
}

impl Extents {
    /// Computes volumes of one kind for all objects that may have one. [`ExtentKind::Chosen`] takes some milliseconds
    /// to measure.
    pub(crate) fn new(scene: &Scene, kind: ExtentKind) -> Extents {
        Extents::of_hulls(scene, &hulls_of(scene), kind)
    }

    /// Computes volumes of one kind from known hulls, one per geometry.
    fn of_hulls(scene: &Scene, hulls: &[Option<Hull>], kind: ExtentKind) -> Extents {
        // Measure the costs of tests if the kind is to be chosen
        let costs = (kind == ExtentKind::Chosen).then(|| Costs::measure(scene, hulls));
        // Compute the volume of each instance
        let object = |index: usize| -> Option<(Object, ExtentKind, f64)> {
            let instance = &scene.instances[index];
            let hull = hulls[instance.geometry as usize].as_ref()?;
            let without = Object {
                instance: index as u32,
                extent: Extent::None,
            };
            let offers = if kind == ExtentKind::None {
                None
            } else {
                Offers::of(scene, instance, hull)
            };
            let Some((offers, guard)) = offers else {
                return Some((without, ExtentKind::None, 0.0));
            };
            let kind = costs
                .as_ref()
                .map_or(kind, |costs| costs.cheapest(instance.geometry, &offers));
            let extent = offers.of_kind(kind);
            Some((Object { extent, ..without }, kind, guard.by_origin))
        };
        // Collect the objects and the largest error factor of ray origins
        let objects = parallel::map(scene.instances.len(), &object);
        let mut extents = Extents {
            objects: Vec::with_capacity(objects.len()),
            by_origin: 0.0,
            counts: ExtentCounts::default(),
        };
        for (object, kind, by_origin) in objects.into_iter().flatten() {
            extents.objects.push(object);
            extents.by_origin = extents.by_origin.max((by_origin as f32).next_up());
            extents.counts.add(kind);
        }
        extents
    }

    /// Returns the objects, in the order of their instances.
    pub(crate) fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// Returns the numbers of objects by kind of volume.
    pub(crate) fn counts(&self) -> ExtentCounts {
        self.counts
    }

    /// Returns the largest error factor of ray origins, for [`RayLanes::new`].
    pub(crate) fn by_origin(&self) -> f32 {
        self.by_origin
    }
}

/// Computes the hulls of all geometries.
fn hulls_of(scene: &Scene) -> Vec<Option<Hull>> {
    parallel::map(scene.geometries.len(), &|index| {
        Hull::of(&scene.geometries[index])
    })
}

/// Returns the smallest spheres around shapes, by instance, for a tree that tests them; `None` where none is safe, and
/// for meshes.
///
/// A cell of a tree contains several shapes, so many rays that reach a cell miss a shape in it.
pub(crate) fn spheres_of_shapes(scene: &Scene) -> Vec<Option<SphereExtent>> {
    let hulls = parallel::map(scene.geometries.len(), &|index| {
        let geometry = &scene.geometries[index];
        match geometry {
            Geometry::Shape(_) => Hull::of(geometry),
            Geometry::Mesh(_) => None,
        }
    });
    let sphere_of = |index: usize| {
        let instance = &scene.instances[index];
        let hull = hulls[instance.geometry as usize].as_ref()?;
        Some(Offers::of(scene, instance, hull)?.0.tight)
    };
    parallel::map(scene.instances.len(), &sphere_of)
}

impl Object {
    /// Returns the mask of lanes that may hit the object before `t_far`.
    #[inline(always)]
    pub(crate) fn meets(&self, isa: impl SimdLevel, rays: &RayLanes, t_far: &Lanes) -> u32 {
        match &self.extent {
            Extent::None => u32::MAX,
            Extent::Box(extent) => rays.meet_box(isa, extent, t_far),
            Extent::Sphere(extent) => rays.meet_sphere(isa, extent, t_far),
        }
    }

    /// Returns whether the object has a bounding volume.
    #[inline(always)]
    pub(crate) fn has_extent(&self) -> bool {
        self.extent != Extent::None
    }
}

impl ExtentCounts {
    fn add(&mut self, kind: ExtentKind) {
        *match kind {
            ExtentKind::None | ExtentKind::Chosen => &mut self.none,
            ExtentKind::Box => &mut self.boxes,
            ExtentKind::CentroidSphere => &mut self.centroid_spheres,
            ExtentKind::TightSphere => &mut self.tight_spheres,
        } += 1;
    }
}

/// Returns the surface area of a box.
fn surface(bounds: &Bounds) -> f64 {
    let e = bounds.extent();
    2.0 * (e.x * e.y + e.y * e.z + e.z * e.x)
}
