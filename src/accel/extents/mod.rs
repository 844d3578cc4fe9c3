//! Extents: simple volumes around objects, tested before the objects themselves, as in the lecture.
//!
//! * [`BoxExtent`] is the box of the object, [`SphereExtent`] a sphere around it: the lecture's, whose centre is the
//!   centroid of the vertices, or the smallest one ([`Ball`]).
//! * [`ExtentKind::Chosen`] takes for every object what measured costs make cheapest, or nothing.
//! * [`ProjectionExtents`] are boxes on the film: a camera ray cannot meet an object whose box does not hold its pixel,
//!   so no arithmetic on rays is needed to skip it.
//! * [`ListAccel`] is the lecture's list of objects, each behind its extent, with what the extents save counted.
//!
//! An extent changes the time, never an answer: [`guard`] bounds what rounding does to hits, and extents are that much
//! wider. Planes have none, nor have placements that are too extreme for the bound.

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

/// Which extents objects get.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExtentKind {
    /// None: every object is asked.
    None,
    /// Boxes.
    Box,
    /// The lecture's spheres, around the centroids of the vertices.
    CentroidSphere,
    /// The smallest spheres.
    TightSphere,
    /// For every object the cheapest of these, by measured costs.
    Chosen,
}

impl ExtentKind {
    /// All of them.
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

/// Whether shapes in a tree get the smallest sphere around them, tested before them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spheres {
    /// None has one.
    Never,
    /// All have.
    Always,
}

/// How many objects have which extent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ExtentCounts {
    /// Without one.
    pub none: u64,
    /// Behind a box.
    pub boxes: u64,
    /// Behind the lecture's sphere.
    pub centroid_spheres: u64,
    /// Behind the smallest sphere.
    pub tight_spheres: u64,
}

/// The objects of a scene but its planes, each behind its extent.
pub(crate) struct Extents {
    objects: Vec<Object>,
    by_origin: f32,
    counts: ExtentCounts,
}

/// An instance and what is tested before it.
pub(crate) struct Object {
    pub(crate) instance: u32,
    pub(crate) extent: Extent,
}

/// All extents of one object.
pub(crate) struct Offers {
    bounds: BoxExtent,
    centroid: SphereExtent,
    tight: SphereExtent,
}

impl Offers {
    /// `None` where no extent is safe.
    fn of(scene: &Scene, instance: &Instance, hull: &Hull) -> Option<(Offers, Guard)> {
        let geometry = &scene.geometries[instance.geometry as usize];
        let guard = Guard::of(instance, geometry, hull.object_bounds())?;
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

    /// The extent of a kind that is not chosen.
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
    /// Extents of one kind for all objects that may have one. [`ExtentKind::Chosen`] takes some milliseconds to
    /// measure.
    pub(crate) fn new(scene: &Scene, kind: ExtentKind) -> Extents {
        Extents::of_hulls(scene, &hulls_of(scene), kind)
    }

    /// The same by hulls that are known, one a geometry.
    fn of_hulls(scene: &Scene, hulls: &[Option<Hull>], kind: ExtentKind) -> Extents {
        let costs = (kind == ExtentKind::Chosen).then(|| Costs::measure(scene, hulls));
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

    /// The objects, in the order of their instances.
    pub(crate) fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// How many have which extent.
    pub(crate) fn counts(&self) -> ExtentCounts {
        self.counts
    }

    /// What [`RayLanes`] need to know.
    pub(crate) fn by_origin(&self) -> f32 {
        self.by_origin
    }
}

/// The hulls of all geometries.
fn hulls_of(scene: &Scene) -> Vec<Option<Hull>> {
    parallel::map(scene.geometries.len(), &|index| {
        Hull::of(&scene.geometries[index])
    })
}

/// The smallest spheres around shapes, by instance, for a tree that asks them; absent where none is safe, and for
/// meshes.
///
/// A cell of a tree holds several shapes, so many rays that come to a cell pass a shape by.
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
    /// The lanes that may meet the object before `t_far`.
    #[inline(always)]
    pub(crate) fn meets(&self, isa: impl SimdLevel, rays: &RayLanes, t_far: &Lanes) -> u32 {
        match &self.extent {
            Extent::None => u32::MAX,
            Extent::Box(extent) => rays.meet_box(isa, extent, t_far),
            Extent::Sphere(extent) => rays.meet_sphere(isa, extent, t_far),
        }
    }

    /// Whether there is anything to test.
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

/// The surface of a box.
fn surface(bounds: &Bounds) -> f64 {
    let e = bounds.extent();
    2.0 * (e.x * e.y + e.y * e.z + e.z * e.x)
}
