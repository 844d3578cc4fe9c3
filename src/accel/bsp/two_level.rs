//! Two-level structure of a scene: the world tree, and one tree for each instanced mesh.

use std::collections::BTreeSet;

use super::builder::{Branch, Built, build};
use super::primitives::{Contents, Primitives, RunKind};
use crate::accel::extents::SphereVolume;
use crate::accel::planes::Planes;
use crate::accel::{AccelError, AccelOptions, AccelPart, Hit, holder_of_tree};
use crate::numeric::Ray;
use crate::scene::{Geometry, Scene};

/// All trees of a scene, in the layout `T`.
pub(super) struct TwoLevelTree<'s, T> {
    /// Scene that the trees were built from.
    pub(super) scene: &'s Scene,
    /// Top level: the tree in world space.
    pub(super) world: TreeLevel<'s, T>,
    /// Infinite planes, which no tree can hold.
    pub(super) planes: Planes,
    /// Bounding spheres of shapes by instance; empty if spheres are not used.
    pub(super) spheres: Vec<Option<SphereVolume>>,
    /// Object-space trees by geometry; `None` unless the geometry is an instanced mesh.
    pub(super) objects: Vec<Option<TreeLevel<'s, T>>>,
    /// Peak bytes in use at any time of the build.
    pub(super) peak_bytes: u64,
}

/// One tree with its primitives.
pub(super) struct TreeLevel<'s, T> {
    /// Primitives that the indices in the tree stand for.
    pub(super) primitives: Primitives<'s>,
    /// Nodes of the tree in its layout.
    pub(super) tree: T,
}

/// A layout of a tree in memory.
pub(super) trait TreeLayout: Sized {
    /// Lays out a built tree; `None` if it is too large.
    fn lay_out(root: &Branch, primitives: &Primitives) -> Option<Self>;

    /// Returns the number of bytes in use.
    fn byte_count(&self) -> u64;
}

impl<'s, T: TreeLayout> TwoLevelTree<'s, T> {
    /// Builds all trees on the current thread pool.
    pub(super) fn build(
        scene: &'s Scene,
        options: &AccelOptions,
        contents: Contents,
    ) -> Result<TwoLevelTree<'s, T>, AccelError> {
        // Estimate the total work by primitive counts
        let silent = |_: f64| ();
        let progress: &(dyn Fn(f64) + Sync) = options.progress.unwrap_or(&silent);
        let placed = instanced_meshes(scene);
        let triangle_count = |index: usize| scene.geometries[index].primitive_count();
        let world = Primitives::of_world(scene, contents).ok_or(AccelError::OutOfMemory)?;
        let total = world.count() + placed.iter().map(|&index| triangle_count(index)).sum::<usize>();
        let mut meter = BuildMeter {
            progress,
            total: total.max(1) as f64,
            done: 0,
            bytes: 0,
            peak_bytes: 0,
        };
        // Build the tree of each instanced mesh
        let mut objects = Vec::new();
        for (index, geometry) in scene.geometries.iter().enumerate() {
            objects.push(match geometry {
                Geometry::Mesh(mesh) if placed.contains(&index) => {
                    Some(meter.level(Primitives::of_mesh(mesh).ok_or(AccelError::OutOfMemory)?)?)
                }
                _ => None,
            });
        }
        // Build the world tree
        let world = meter.level(world)?;
        progress(1.0);
        Ok(TwoLevelTree {
            scene,
            world,
            planes: Planes::of(scene),
            spheres: Vec::new(),
            objects,
            peak_bytes: meter.peak_bytes,
        })
    }

    /// Returns whether a ray may hit an instance by its bounding sphere; true without a sphere.
    #[inline(always)]
    pub(super) fn may_hit(&self, instance: u32, ray: &Ray) -> bool {
        match self.spheres.get(instance as usize) {
            Some(Some(sphere)) => sphere.may_hit(ray),
            _ => true,
        }
    }

    /// Returns the bytes of all trees, and of the world's primitive list.
    pub(super) fn byte_count(&self) -> u64 {
        let objects = self.objects.iter().flatten().map(|level| level.tree.byte_count());
        self.world.tree.byte_count() + self.world.primitives.byte_count() + objects.sum::<u64>()
    }

    /// Returns the bytes of the trees by category.
    pub(super) fn parts(&self) -> Vec<AccelPart> {
        let world = self.world.tree.byte_count() + self.world.primitives.byte_count();
        let objects = self.world.primitives.object_count();
        let triangles = self.world.primitives.count() - objects;
        let part = |holder, what, bytes| AccelPart { holder, what, bytes };
        vec![
            part(
                "triangles",
                "trees of instanced meshes",
                self.byte_count() - world,
            ),
            part(holder_of_tree(triangles, objects), "top-level tree", world),
        ]
    }

    /// Returns a one-line summary of the trees.
    pub(super) fn summary(&self) -> String {
        let objects = self.objects.iter().flatten().count();
        let count = self.world.primitives.count();
        let planes = self.planes.count();
        format!(
            "BSP of {count} primitives in world space, {objects} trees of instanced meshes, {planes} planes"
        )
    }

    /// Returns the hit on world index `number`; `primitive` is the triangle or part if that is an instanced mesh or a
    /// shape.
    #[inline(always)]
    pub(super) fn hit(&self, number: u32, primitive: u32, [t, u, v]: [f32; 3]) -> Hit {
        let run = self.world.primitives.run(number);
        let primitive = match run.kind {
            RunKind::Triangles(_) | RunKind::Points(..) => number - run.first,
            RunKind::Whole(_) => primitive,
        };
        Hit {
            instance: run.instance,
            primitive,
            t,
            u,
            v,
        }
    }
}

/// Accumulated work and memory while the trees are built one after the other.
struct BuildMeter<'a> {
    progress: &'a (dyn Fn(f64) + Sync),
    total: f64,
    done: usize,
    bytes: u64,
    peak_bytes: u64,
}

impl BuildMeter<'_> {
    fn level<'s, T: TreeLayout>(
        &mut self,
        primitives: Primitives<'s>,
    ) -> Result<TreeLevel<'s, T>, AccelError> {
        let (before, count, total) = (self.done as f64, primitives.count() as f64, self.total);
        let progress = self.progress;
        let Built {
            root,
            peak_bytes,
            branch_bytes,
        } = build(&primitives, &|part| progress((before + part * count) / total));
        let tree = T::lay_out(&root, &primitives).ok_or(AccelError::OutOfMemory)?;
        // Take the peak of the build itself, and of the binary tree beside its layout
        self.peak_bytes = self.peak_bytes.max(self.bytes + peak_bytes);
        self.peak_bytes = self.peak_bytes.max(self.bytes + branch_bytes + tree.byte_count());
        self.bytes += tree.byte_count();
        self.done += primitives.count();
        Ok(TreeLevel { primitives, tree })
    }
}

/// Returns the meshes that need a tree in object space.
fn instanced_meshes(scene: &Scene) -> BTreeSet<usize> {
    let placed = scene.instances.iter().filter(|instance| !instance.is_identity());
    let is_mesh = |index: &usize| matches!(scene.geometries[*index], Geometry::Mesh(_));
    placed
        .map(|instance| instance.geometry as usize)
        .filter(is_mesh)
        .collect()
}
