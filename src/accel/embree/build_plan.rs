//! Which meshes go where: into the world or into a scene of their own, as Embree's own triangles or, where they are to be
//! watertight, as patches.

use super::duplicate_triangles::later_duplicates;
use super::origin_bound::OriginBound;
use super::triangle_cluster::TriangleClusters;
use super::user_geometry;
use crate::accel::{Instancing, MeshCache, Precision};
use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::scene::{Geometry, Instance, Scene};

/// Which meshes go where.
pub(super) struct BuildPlan<'s> {
    scene: &'s Scene,
    /// Meshes in the world, each with the first instance that has it there.
    world: Vec<(u32, &'s Mesh)>,
    /// The same as Embree's own triangles, if they are to be that.
    native: Vec<(u32, NativeMesh<'s>)>,
    /// By geometry: whether it is a mesh with a scene of its own.
    is_placed: Vec<bool>,
    /// How far rays come from.
    reach: OriginBound,
    /// Whether triangles are patches.
    is_patched: bool,
}

/// A mesh for Embree.
pub(super) struct NativeMesh<'s> {
    pub(super) mesh: &'s Mesh,
    /// Triangles, in rising order, that coincide with an earlier one of the same Embree scene and can never be the
    /// answer.
    pub(super) held_back: Vec<u32>,
}

/// A mesh with a scene of its own.
pub(super) struct InstancedMesh<'s> {
    mesh: &'s Mesh,
    /// How far rays come from in its space, where its triangles are patches.
    reach: Option<OriginBound>,
}

/// What a mesh's scene holds.
pub(super) enum Triangles<'s> {
    /// Embree's own.
    Native(NativeMesh<'s>),
    /// Ours.
    TriangleClusters(TriangleClusters),
}

impl<'s> BuildPlan<'s> {
    /// Of a validated scene.
    pub(super) fn new(scene: &'s Scene, precision: Precision) -> BuildPlan<'s> {
        let mut is_in_world = vec![false; scene.geometries.len()];
        let mut is_placed = vec![false; scene.geometries.len()];
        let mut world = Vec::new();
        for (index, instance) in (0u32..).zip(&scene.instances) {
            let geometry = instance.geometry as usize;
            if let Some(mesh) = world_mesh(scene, instance) {
                // A second instance in the same place would coincide with the first in every triangle.
                if !std::mem::replace(&mut is_in_world[geometry], true) {
                    world.push((index, mesh));
                }
            }
            is_placed[geometry] |= placed_mesh(scene, instance).is_some();
        }
        let is_patched = precision == Precision::Watertight;
        let native = if is_patched { Vec::new() } else { natives(&world) };
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        BuildPlan {
            scene,
            world,
            native,
            is_placed,
            reach: OriginBound::of(scene, &bounds),
            is_patched,
        }
    }

    /// What it is a plan of.
    pub(super) fn scene(&self) -> &'s Scene {
        self.scene
    }

    /// Meshes in the world that are Embree's own triangles, each with its instance.
    pub(super) fn native(&self) -> &[(u32, NativeMesh<'s>)] {
        &self.native
    }

    /// The triangles of the world that are not; on the current pool.
    pub(super) fn patches(&self, mesh_cache: Option<&MeshCache>) -> TriangleClusters {
        if !self.is_patched {
            return TriangleClusters::default();
        }
        TriangleClusters::of(self.world.iter().copied(), self.reach, mesh_cache)
    }

    /// How far rays come from.
    pub(super) fn reach(&self) -> OriginBound {
        self.reach
    }

    /// Triangles that nobody is asked about, those of repeated instances included.
    pub(super) fn held_back_count(&self) -> usize {
        let given: usize = self.world.iter().map(|(_, mesh)| mesh.triangles.len()).sum();
        let held_back = self.native.iter().map(|(_, given)| given.held_back.len());
        world_triangle_count(self.scene) - given + held_back.sum::<usize>()
    }

    /// The meshes with scenes of their own, by geometry.
    pub(super) fn placed(&self) -> impl Iterator<Item = Option<InstancedMesh<'s>>> {
        let geometries = (0u32..).zip(&self.scene.geometries).zip(&self.is_placed);
        geometries.map(|((number, geometry), is_placed)| {
            let Geometry::Mesh(mesh) = geometry else {
                return None;
            };
            let instances = self.scene.instances.iter();
            let mine = instances.filter(|instance| instance.geometry == number);
            is_placed.then(|| InstancedMesh {
                mesh,
                reach: self.is_patched.then(|| self.reach.in_object(mine)),
            })
        })
    }
}

impl<'s> InstancedMesh<'s> {
    /// How many triangles it has.
    pub(super) fn triangle_count(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// What its scene holds, and a box around all rays that may meet it; on the current pool.
    pub(super) fn triangles(&self, mesh_cache: Option<&MeshCache>) -> (Triangles<'s>, Bounds) {
        let bounds = self.mesh.bounds();
        match self.reach {
            Some(reach) => {
                let patches = TriangleClusters::of(std::iter::once((0, self.mesh)), reach, mesh_cache);
                (Triangles::TriangleClusters(patches), reach.padded(&bounds))
            }
            None => {
                let held_back = later_duplicates(&[self.mesh]).pop().unwrap_or_default();
                let mesh = self.mesh;
                (Triangles::Native(NativeMesh { mesh, held_back }), bounds)
            }
        }
    }
}

fn natives<'s>(world: &[(u32, &'s Mesh)]) -> Vec<(u32, NativeMesh<'s>)> {
    let meshes: Vec<&Mesh> = world.iter().map(|&(_, mesh)| mesh).collect();
    let held_back = later_duplicates(&meshes);
    let given = world.iter().zip(held_back);
    given
        .map(|(&(instance, mesh), held_back)| (instance, NativeMesh { mesh, held_back }))
        .collect()
}

/// What Embree builds trees over, for telling how far it is: triangles of the world and of placed meshes, and objects.
pub(super) fn primitive_count(scene: &Scene) -> usize {
    let mut is_placed = vec![false; scene.geometries.len()];
    for instance in &scene.instances {
        is_placed[instance.geometry as usize] |= placed_mesh(scene, instance).is_some();
    }
    let geometries = scene.geometries.iter().zip(&is_placed);
    let placed = geometries.map(|(geometry, &placed)| if placed { geometry.primitive_count() } else { 0 });
    let is_object = |i: &&Instance| user_geometry::is_user(scene, i, Instancing::Callback);
    let objects = scene.instances.iter().filter(is_object).count();
    placed.sum::<usize>() + world_triangle_count(scene) + objects
}

/// Triangles of the world, those of repeated instances included.
pub(super) fn world_triangle_count(scene: &Scene) -> usize {
    let meshes = scene.instances.iter().filter_map(|i| world_mesh(scene, i));
    meshes.map(|mesh| mesh.triangles.len()).sum()
}

/// The mesh of an instance whose object space is world space.
fn world_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// The mesh of an instance that stands elsewhere.
pub(super) fn placed_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if !instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}
