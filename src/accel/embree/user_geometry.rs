//! The user geometry: clusters of spheres, patches of watertight triangles, and all other shapes and placed meshes, each
//! one primitive, tested by callbacks from Embree (see `callbacks`). What moves is a second one, as Embree walks trees of
//! boxes that move more slowly than those of boxes that do not.

use std::panic::{self, AssertUnwindSafe};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;

use super::build_plan::placed_mesh;
use super::native_instances;
use super::origin_bound::OriginBound;
use super::scene::{EmbreeScene, SceneRef};
use super::sphere_cluster::{MEMBERS, SphereCluster, SphereClusters};
use super::triangle_cluster::{TriangleCluster, TriangleClusters};
use crate::accel::Instancing;
use crate::accel::shape_query::world_sphere;
use crate::numeric::{AnimatedTransform, Bounds};
use crate::scene::{Geometry, Instance, Scene};
use crate::shape::Sphere;

/// Everything that Embree asks our callbacks about in one of its scenes.
pub(super) struct UserGeometry<'s> {
    scene: &'s Scene,
    /// The first primitives: spheres that are asked about together.
    clusters: SphereClusters,
    /// The next ones: triangles that are.
    patches: TriangleClusters,
    /// The instance that each primitive after them is.
    instances: Vec<u32>,
    /// By geometry; absent where it is no placed mesh.
    parts: Arc<[Option<Box<InstancedScene<'s>>>]>,
    /// Equal steps of time between the boxes that Embree is told; 0 where nothing moves.
    step_count: u32,
    /// How far rays come from.
    reach: OriginBound,
    panic_count: AtomicU64,
}

/// A placed mesh in its own space.
pub(super) struct InstancedScene<'s> {
    // Released before what its callbacks read.
    pub(super) scene: EmbreeScene<'s>,
    /// Its triangles, where they are not Embree's own.
    pub(super) patches: Option<Arc<UserGeometry<'s>>>,
    /// A box around all rays, as they are carried there, that may meet it.
    pub(super) bounds: Bounds,
}

/// What one primitive is.
pub(super) enum Primitive<'a> {
    /// Spheres, and the instances that they are.
    Spheres(&'a SphereCluster, &'a [u32; MEMBERS]),
    /// Triangles.
    TriangleCluster(TriangleCluster<'a>),
    /// One instance, with its number.
    Instance(u32, &'a Instance),
}

/// Spheres of the world, each with the number of its instance, and the numbers of all other `instances`.
fn apart(scene: &Scene, instances: &[(u32, &Instance)]) -> (Vec<(u32, Sphere)>, Vec<u32>) {
    let (mut spheres, mut others) = (Vec::new(), Vec::new());
    for &(index, instance) in instances {
        let sphere = match &scene.geometries[instance.geometry as usize] {
            Geometry::Shape(shape) => world_sphere(&instance.pose(0.0), shape),
            Geometry::Mesh(_) => None,
        };
        match sphere {
            Some(sphere) => spheres.push((index, sphere)),
            None => others.push(index),
        }
    }
    (spheres, others)
}

/// Whether an instance is a primitive of the user geometry.
pub(super) fn is_user(scene: &Scene, instance: &Instance, instancing: Instancing) -> bool {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(_) => {
            placed_mesh(scene, instance).is_some() && !native_instances::takes(instance, instancing)
        }
        shape => !shape.is_unbounded(),
    }
}

impl<'s> UserGeometry<'s> {
    /// What stands still, and what moves, for rays from that far; `parts` holds a committed scene for every mesh with a
    /// placed instance, and `patches` the triangles of the world that are not Embree's own.
    pub(super) fn pair(
        (scene, reach): (&'s Scene, OriginBound),
        parts: Vec<Option<InstancedScene<'s>>>,
        patches: TriangleClusters,
        instancing: Instancing,
    ) -> [UserGeometry<'s>; 2] {
        let instances = (0u32..)
            .zip(&scene.instances)
            .filter(|(_, instance)| is_user(scene, instance, instancing));
        let (moving, others): (Vec<_>, Vec<_>) = instances.partition(|(_, instance)| instance.is_moving());
        let (spheres, mut still) = apart(scene, &others);
        let (clusters, alone) = SphereClusters::of(&spheres);
        still.extend(alone);
        let motions = moving.iter().filter_map(|(_, instance)| instance.motion());
        let step_count = motions.map(AnimatedTransform::step_count).max().unwrap_or(0);
        let parts: Arc<[_]> = parts.into_iter().map(|part| part.map(Box::new)).collect();
        let still = UserGeometry {
            clusters,
            instances: still,
            parts: parts.clone(),
            reach,
            ..UserGeometry::of_patches(scene, patches)
        };
        let moving = UserGeometry {
            instances: moving.iter().map(|(index, _)| *index).collect(),
            parts,
            step_count,
            reach,
            ..UserGeometry::of_patches(scene, TriangleClusters::default())
        };
        [still, moving]
    }

    /// Triangles and nothing else.
    pub(super) fn of_patches(scene: &'s Scene, patches: TriangleClusters) -> UserGeometry<'s> {
        UserGeometry {
            scene,
            clusters: SphereClusters::default(),
            patches,
            instances: Vec::new(),
            parts: Arc::new([]),
            step_count: 0,
            reach: OriginBound::default(),
            panic_count: AtomicU64::new(0),
        }
    }

    /// Equal steps of time between the boxes of a primitive; 0 where nothing moves.
    pub(super) fn step_count(&self) -> u32 {
        self.step_count
    }

    /// Shapes and placed meshes.
    pub(super) fn object_count(&self) -> usize {
        self.clusters.sphere_count() + self.instances.len()
    }

    /// Patches of triangles.
    pub(super) fn patch_count(&self) -> usize {
        self.patches.len()
    }

    /// What Embree keeps boxes of.
    pub(super) fn primitive_count(&self) -> usize {
        self.clusters.len() + self.patches.len() + self.instances.len()
    }

    /// A primitive by its number.
    #[inline(always)]
    pub(super) fn primitive(&self, number: usize) -> Option<Primitive<'_>> {
        if let Some((cluster, instances)) = self.clusters.get(number) {
            return Some(Primitive::Spheres(cluster, instances));
        }
        let number = number.checked_sub(self.clusters.len())?;
        if let Some(patch) = self.patches.get(number) {
            return Some(Primitive::TriangleCluster(patch));
        }
        let index = *self.instances.get(number.checked_sub(self.patches.len())?)?;
        Some(Primitive::Instance(
            index,
            self.scene.instances.get(index as usize)?,
        ))
    }

    /// The geometry of that number, which an instance has.
    #[inline(always)]
    pub(super) fn geometry(&self, number: u32) -> &'s Geometry {
        &self.scene.geometries[number as usize]
    }

    /// The box of a primitive in world space after that many steps of time, padded.
    ///
    /// Embree interpolates boxes in f32, by a part of a step that is off by 2^-24 of all steps, over which a box moves by
    /// twice the largest coordinate at most.
    pub(super) fn bounds(&self, primitive: usize, step: u32) -> Option<([f32; 3], [f32; 3])> {
        let instance = match self.primitive(primitive)? {
            Primitive::Spheres(cluster, _) => {
                let world = cluster.bounds();
                return Some(padded(&world, self.padding(&world)));
            }
            Primitive::TriangleCluster(_) => return self.patches.boxed(primitive - self.clusters.len()),
            Primitive::Instance(_, instance) => instance,
        };
        let geometry = &self.scene.geometries[instance.geometry as usize];
        let object = match (&self.parts[instance.geometry as usize], geometry) {
            (Some(part), _) => part.bounds,
            (None, shape) => shape.bounds(),
        };
        if self.step_count == 0 {
            let world = instance.world_bounds(geometry, &object);
            return Some(padded(&world, self.padding(&world)));
        }
        let now = instance.step_bounds(geometry, &object, [step, self.step_count]);
        let always = instance.world_bounds(geometry, &object).magnitude();
        let interpolation = UNIT * f64::from(2 * self.step_count + 4);
        Some(padded(
            &now,
            self.padding(&now) + (PLACEMENT_PADDING + interpolation) * always,
        ))
    }

    /// What a box is padded by on all sides.
    fn padding(&self, world: &Bounds) -> f64 {
        let placement = PLACEMENT_PADDING * world.magnitude() + NEAR_PADDING * world.extent().max_element();
        placement.max(self.reach.padding(world))
    }

    /// Bytes of its records and those of its parts, but for patches.
    pub(super) fn byte_count(&self) -> u64 {
        let parts = self.parts.iter().flatten().count() * size_of::<InstancedScene>();
        self.own_byte_count() + (size_of_val(&*self.parts) + parts) as u64
    }

    /// Bytes of its own records, but for patches.
    pub(super) fn own_byte_count(&self) -> u64 {
        size_of_val(&*self.instances) as u64 + self.clusters.byte_count()
    }

    /// Bytes of its patches and those of its parts.
    pub(super) fn patch_byte_count(&self) -> u64 {
        let of_parts = self.patches_of_parts().map(|part| part.patches.byte_count());
        self.patches.byte_count() + of_parts.sum::<u64>()
    }

    /// Callbacks that have panicked, those of its parts included.
    pub(super) fn panic_count(&self) -> u64 {
        let of_parts = self.patches_of_parts().map(|part| part.own_panic_count());
        self.own_panic_count() + of_parts.sum::<u64>()
    }

    /// Callbacks that have panicked.
    pub(super) fn own_panic_count(&self) -> u64 {
        self.panic_count.load(Ordering::Relaxed)
    }

    fn patches_of_parts(&self) -> impl Iterator<Item = &UserGeometry<'s>> {
        let parts = self.parts.iter().flatten();
        parts.filter_map(|part| part.patches.as_deref())
    }

    /// Runs a callback's work. No panic may cross into C: after one, the callback's lanes have missed.
    pub(super) fn guarded(&self, work: impl FnOnce()) -> bool {
        let done = panic::catch_unwind(AssertUnwindSafe(|| {
            #[cfg(test)]
            super::callbacks::tests::maybe_panic();
            work();
        }));
        if done.is_err() {
            self.panic_count.fetch_add(1, Ordering::Relaxed);
        }
        done.is_ok()
    }

    /// The scene of a placed mesh.
    pub(super) fn part(&self, geometry: u32) -> Option<SceneRef<'_>> {
        let part = self.parts.get(geometry as usize)?.as_ref()?;
        Some(part.scene.as_ref())
    }
}

/// Part of a box's largest coordinate by which it is padded: object-space rays are rounded to f32, which moves them
/// against the geometry by a few 2^-24 of the coordinates involved.
const PLACEMENT_PADDING: f64 = 1.0 / (1 << 20) as f64;
/// Half a unit in the last place of an f32 at 1.
const UNIT: f64 = 1.0 / (1 << 24) as f64;

/// Part of a box's longest edge by which it is padded at least: rays that start within hundreds of edges find it wherever
/// they start, be it farther than [`OriginBound`] knows of.
const NEAR_PADDING: f64 = 1.0 / (1 << 13) as f64;

fn padded(world: &Bounds, by: f64) -> ([f32; 3], [f32; 3]) {
    let padding = DVec3::splat(by);
    Bounds {
        min: world.min - padding,
        max: world.max + padding,
    }
    .to_f32_outward()
}
