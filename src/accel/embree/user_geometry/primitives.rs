//! User geometry: clusters of spheres, of watertight triangles and of points, and all other shapes and instanced meshes,
//! each one primitive, tested by callbacks from Embree (see `callbacks`). Moving objects are a second user geometry, as
//! Embree traverses trees of moving boxes more slowly than those of static boxes.

use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

use super::point_cluster::{ClusteredClouds, Motion, PlacedPoints, PointClusters};
use super::sphere_cluster::{NumberedSpheres, SphereClusters};
use super::triangle_cluster::{TriangleCluster, TriangleClusters};
use crate::accel::Instancing;
use crate::accel::embree::instance_kind::is_user;
use crate::accel::embree::origin_bound::OriginBound;
use crate::accel::embree::scene::{EmbreeScene, SceneRef};
use crate::accel::shape_query::world_sphere;
use crate::mesh::simd::SimdLimit;
use crate::numeric::{AnimatedTransform, Bounds};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Sphere;

/// All primitives of one Embree scene that are tested by callbacks.
pub(in crate::accel::embree) struct UserGeometry<'s> {
    scene: &'s Scene,
    /// Sphere clusters, which are the first primitives.
    clusters: SphereClusters,
    /// Triangle clusters, which are the next primitives.
    triangle_clusters: TriangleClusters,
    /// Instance index of each primitive after the clusters.
    instances: Vec<u32>,
    /// Clusters of points, which are the last primitives.
    points: PointClusters<'s>,
    /// Scenes of instanced meshes by geometry; `None` for other geometries.
    parts: Arc<[Option<Box<InstancedScene<'s>>>]>,
    /// Number of equal time steps between the boxes for Embree; 0 if nothing moves.
    step_count: u32,
    /// Bound on the origins of rays.
    origin_bound: OriginBound,
    /// Instruction sets of the tests.
    simd: SimdLimit,
    panic_count: AtomicU64,
}

/// Embree scene of an instanced mesh, in object space.
pub(in crate::accel::embree) struct InstancedScene<'s> {
    // Declared first, to be released before the data that its callbacks read.
    pub(in crate::accel::embree) scene: EmbreeScene<'s>,
    /// Triangle clusters of the mesh, unless its triangles are native.
    pub(in crate::accel::embree) triangle_clusters: Option<Arc<UserGeometry<'s>>>,
    /// Object-space box around all transformed rays that may hit the mesh.
    pub(in crate::accel::embree) bounds: Bounds,
}

/// Content of one primitive of the user geometry.
pub(super) enum Primitive<'a> {
    /// Cluster of spheres in world space.
    Spheres(NumberedSpheres<'a>),
    /// Cluster of watertight triangles.
    TriangleCluster(TriangleCluster<'a>),
    /// One instance, with its index.
    Instance(u32, &'a Instance),
    /// Cluster of points of one cloud.
    Points(PlacedPoints<'a>),
}

/// Splits `instances` into world-space spheres, each with its instance index, and the indices of all others.
fn split_spheres(scene: &Scene, instances: &[(u32, &Instance)]) -> (Vec<(u32, Sphere)>, Vec<u32>) {
    let (mut spheres, mut others) = (Vec::new(), Vec::new());
    for &(index, instance) in instances {
        let sphere = match &scene.geometries[instance.geometry as usize] {
            Geometry::Shape(shape) => world_sphere(&instance.pose(0.0), shape),
            Geometry::Mesh(_) | Geometry::Points(_) => None,
        };
        match sphere {
            Some(sphere) => spheres.push((index, sphere)),
            None => others.push(index),
        }
    }
    (spheres, others)
}

impl<'s> UserGeometry<'s> {
    /// Creates the user geometries of static and of moving objects for ray origins within `origin_bound`; `parts` holds a
    /// committed scene for every mesh with a transformed instance, and `triangle_clusters` the world triangles that are not
    /// native.
    pub(in crate::accel::embree) fn pair(
        (scene, origin_bound): (&'s Scene, OriginBound),
        simd: SimdLimit,
        parts: Vec<Option<InstancedScene<'s>>>,
        triangle_clusters: TriangleClusters,
        instancing: Instancing,
    ) -> [UserGeometry<'s>; 2] {
        // Split the instances into static and moving ones
        let instances = (0u32..)
            .zip(&scene.instances)
            .filter(|(_, instance)| is_user(scene, instance, instancing));
        let (moving, others): (Vec<_>, Vec<_>) = instances.partition(|(_, instance)| instance.is_moving());
        // Cluster the spheres among the static instances
        let (spheres, mut still) = split_spheres(scene, &others);
        let (clusters, unclustered) = SphereClusters::of(&spheres);
        still.extend(unclustered);
        // Use the largest number of time steps of all motions
        let clouds = ClusteredClouds::of(scene);
        let moving_points = PointClusters::of(scene, &clouds, Motion::Moving);
        let moved = moving.iter().map(|(_, instance)| *instance);
        let motions = moved
            .chain(moving_points.instances())
            .filter_map(Instance::motion);
        let step_count = motions.map(AnimatedTransform::step_count).max().unwrap_or(0);
        let parts: Arc<[_]> = parts.into_iter().map(|part| part.map(Box::new)).collect();
        let still = UserGeometry {
            clusters,
            instances: still,
            points: PointClusters::of(scene, &clouds, Motion::Static),
            parts: parts.clone(),
            origin_bound,
            ..UserGeometry::of_triangle_clusters(scene, simd, triangle_clusters)
        };
        let moving = UserGeometry {
            instances: moving.iter().map(|(index, _)| *index).collect(),
            points: moving_points,
            parts,
            step_count,
            origin_bound,
            ..UserGeometry::of_triangle_clusters(scene, simd, TriangleClusters::default())
        };
        [still, moving]
    }

    /// Creates a user geometry of triangle clusters alone.
    pub(in crate::accel::embree) fn of_triangle_clusters(
        scene: &'s Scene,
        simd: SimdLimit,
        triangle_clusters: TriangleClusters,
    ) -> UserGeometry<'s> {
        UserGeometry {
            scene,
            clusters: SphereClusters::default(),
            triangle_clusters,
            instances: Vec::new(),
            points: PointClusters::default(),
            parts: Arc::new([]),
            step_count: 0,
            origin_bound: OriginBound::default(),
            simd,
            panic_count: AtomicU64::new(0),
        }
    }

    /// Returns the instruction sets that callbacks may use.
    #[inline(always)]
    pub(super) fn simd(&self) -> SimdLimit {
        self.simd
    }

    /// Returns the number of equal time steps between the boxes of a primitive; 0 if nothing moves.
    pub(in crate::accel::embree) fn step_count(&self) -> u32 {
        self.step_count
    }

    /// Returns the number of shapes, instanced meshes and points.
    pub(in crate::accel::embree) fn object_count(&self) -> usize {
        self.clusters.sphere_count() + self.instances.len() + self.points.point_count()
    }

    /// Returns the number of triangle clusters.
    pub(in crate::accel::embree) fn triangle_cluster_count(&self) -> usize {
        self.triangle_clusters.len()
    }

    /// Returns the number of primitives for Embree, each of which has a box.
    pub(in crate::accel::embree) fn primitive_count(&self) -> usize {
        self.clusters.len() + self.triangle_clusters.len() + self.instances.len() + self.points.len()
    }

    /// Returns a primitive by its index.
    #[inline(always)]
    pub(super) fn primitive(&self, number: usize) -> Option<Primitive<'_>> {
        if let Some(spheres) = self.clusters.get(number) {
            return Some(Primitive::Spheres(spheres));
        }
        let number = number.checked_sub(self.clusters.len())?;
        if let Some(patch) = self.triangle_clusters.get(number) {
            return Some(Primitive::TriangleCluster(patch));
        }
        let number = number.checked_sub(self.triangle_clusters.len())?;
        let Some(&index) = self.instances.get(number) else {
            return self
                .points
                .get(number - self.instances.len())
                .map(Primitive::Points);
        };
        Some(Primitive::Instance(
            index,
            self.scene.instances.get(index as usize)?,
        ))
    }

    /// Returns the geometry of an instance by its index.
    #[inline(always)]
    pub(super) fn geometry(&self, number: u32) -> &'s Geometry {
        &self.scene.geometries[number as usize]
    }

    /// Returns the padded world-space box of a primitive at a time step.
    ///
    /// Embree interpolates boxes in f32, with a fraction of a step that is off by 2^-24 of all steps, over which a box
    /// moves by twice the largest coordinate at most.
    pub(super) fn bounds(&self, primitive: usize, step: u32) -> Option<([f32; 3], [f32; 3])> {
        // Clusters have boxes of their own
        let instance = match self.primitive(primitive)? {
            Primitive::Spheres(spheres) => {
                let world = spheres.cluster.bounds();
                return Some(padded(&world, self.padding(&world)));
            }
            Primitive::TriangleCluster(_) => {
                return self.triangle_clusters.embree_box(primitive - self.clusters.len());
            }
            Primitive::Points(points) => return Some(self.bounds_of_points(points, step)),
            Primitive::Instance(_, instance) => instance,
        };
        let geometry = &self.scene.geometries[instance.geometry as usize];
        let object = match (&self.parts[instance.geometry as usize], geometry) {
            (Some(part), _) => part.bounds,
            (None, shape) => shape.bounds(),
        };
        // Static box
        if self.step_count == 0 {
            let world = instance.world_bounds(geometry, &object);
            return Some(padded(&world, self.padding(&world)));
        }
        // Box at one time step, with extra padding for Embree's interpolation
        let now = instance.step_bounds(geometry, &object, [step, self.step_count]);
        let always = instance.world_bounds(geometry, &object).magnitude();
        Some(self.padded_in_motion(&now, always))
    }

    /// Returns the padded world-space box of a cluster of points at a time step.
    fn bounds_of_points(&self, points: PlacedPoints, step: u32) -> ([f32; 3], [f32; 3]) {
        let world = points.world_bounds();
        if self.step_count == 0 {
            return padded(&world, self.padding(&world));
        }
        self.padded_in_motion(&points.step_bounds(step, self.step_count), world.magnitude())
    }

    /// Returns the box `now` with extra padding for Embree's interpolation between steps; `magnitude` is the largest
    /// coordinate at all times.
    fn padded_in_motion(&self, now: &Bounds, magnitude: f64) -> ([f32; 3], [f32; 3]) {
        let interpolation = UNIT * f64::from(2 * self.step_count + 4);
        padded(
            now,
            self.padding(now) + (PLACEMENT_PADDING + interpolation) * magnitude,
        )
    }

    /// Returns the padding of a box on all sides.
    fn padding(&self, world: &Bounds) -> f64 {
        let placement = PLACEMENT_PADDING * world.magnitude() + NEAR_PADDING * world.extent().max_element();
        placement.max(self.origin_bound.padding(world))
    }

    /// Returns the bytes of its own records and those of its mesh scenes, without triangle clusters.
    pub(in crate::accel::embree) fn byte_count(&self) -> u64 {
        let parts = self.parts.iter().flatten().count() * size_of::<InstancedScene>();
        self.own_byte_count() + (size_of_val(&*self.parts) + parts) as u64
    }

    /// Returns the bytes of its own records, without triangle clusters.
    pub(in crate::accel::embree) fn own_byte_count(&self) -> u64 {
        size_of_val(&*self.instances) as u64 + self.clusters.byte_count() + self.points.byte_count()
    }

    /// Returns the bytes of its triangle clusters and those of its mesh scenes.
    pub(in crate::accel::embree) fn triangle_cluster_byte_count(&self) -> u64 {
        let of_parts = self
            .mesh_cluster_geometries()
            .map(|part| part.triangle_clusters.byte_count());
        self.triangle_clusters.byte_count() + of_parts.sum::<u64>()
    }

    /// Returns the number of panicked callbacks, including those of its mesh scenes.
    pub(in crate::accel::embree) fn panic_count(&self) -> u64 {
        let of_parts = self.mesh_cluster_geometries().map(|part| part.own_panic_count());
        self.own_panic_count() + of_parts.sum::<u64>()
    }

    /// Returns the number of panicked callbacks of this geometry alone.
    pub(in crate::accel::embree) fn own_panic_count(&self) -> u64 {
        self.panic_count.load(Ordering::Relaxed)
    }

    fn mesh_cluster_geometries(&self) -> impl Iterator<Item = &UserGeometry<'s>> {
        let parts = self.parts.iter().flatten();
        parts.filter_map(|part| part.triangle_clusters.as_deref())
    }

    /// Runs a callback's work and returns whether it completed. No panic may unwind into C: after one, the callback's
    /// lanes have missed.
    pub(super) fn guarded(&self, work: impl FnOnce()) -> bool {
        let done = panic::catch_unwind(AssertUnwindSafe(|| {
            #[cfg(test)]
            maybe_panic();
            work();
        }));
        if done.is_err() {
            self.panic_count.fetch_add(1, Ordering::Relaxed);
        }
        done.is_ok()
    }

    /// Returns the scene of an instanced mesh.
    pub(in crate::accel::embree) fn part(&self, geometry: u32) -> Option<SceneRef<'_>> {
        let part = self.parts.get(geometry as usize)?.as_ref()?;
        Some(part.scene.as_ref())
    }
}

/// Padding relative to a box's largest coordinate: object-space rays are rounded to f32, which moves them against the
/// geometry by a few 2^-24 of the coordinates involved.
const PLACEMENT_PADDING: f64 = 1.0 / (1 << 20) as f64;
/// Unit roundoff of f32: half a unit in the last place at 1.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// Least padding relative to a box's longest edge: rays that start within hundreds of edges hit the box even if their
/// origin is outside the bound of [`OriginBound`].
const NEAR_PADDING: f64 = 1.0 / (1 << 13) as f64;

fn padded(world: &Bounds, by: f64) -> ([f32; 3], [f32; 3]) {
    let padding = DVec3::splat(by);
    Bounds {
        min: world.min - padding,
        max: world.max + padding,
    }
    .to_f32_outward()
}

#[cfg(test)]
thread_local! {
    /// Flag that makes every guarded callback on this thread panic.
    pub(super) static PANIC: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Panics on demand; called inside every guarded callback of a test build.
#[cfg(test)]
fn maybe_panic() {
    assert!(!PANIC.get(), "panic requested");
}
