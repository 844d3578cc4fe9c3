//! Assignment of meshes to Embree scenes: the world or a scene of their own, as native triangles or, at watertight
//! precision, as triangle clusters.

use super::duplicate_triangles::later_duplicates;
use crate::accel::Precision;
use crate::accel::embree::built_meshes::BuiltMeshes;
use crate::accel::embree::instance_kind::{instanced_mesh, world_mesh, world_triangle_count};
use crate::accel::embree::origin_bound::OriginBound;
use crate::accel::embree::user_geometry::triangle_cluster::TriangleClusters;
use crate::mesh::Mesh;
use crate::numeric::Bounds;
use crate::scene::{Geometry, Scene};

/// Assignment of all meshes of a scene.
pub(super) struct BuildPlan<'s> {
    scene: &'s Scene,
    /// World-space meshes, each with its first instance.
    world: Vec<(u32, &'s Mesh)>,
    /// World-space meshes as native triangles; empty at watertight precision.
    native: Vec<(u32, NativeMesh<'s>)>,
    /// Flags by geometry, set if it is a mesh with a scene of its own.
    is_instanced: Vec<bool>,
    /// Bound on the origins of rays.
    origin_bound: OriginBound,
    /// Flag for triangle clusters instead of native triangles.
    uses_clusters: bool,
}

/// A mesh whose triangles become Embree's own.
pub(super) struct NativeMesh<'s> {
    pub(super) mesh: &'s Mesh,
    /// Triangles, in rising order, that coincide with an earlier one of the same Embree scene and are omitted, as they
    /// can never be the nearest hit.
    pub(super) skipped_duplicates: Vec<u32>,
}

/// A mesh with an Embree scene of its own.
pub(super) struct InstancedMesh<'s> {
    mesh: &'s Mesh,
    /// Bound on the ray origins in object space, present if its triangles are clusters.
    origin_bound: Option<OriginBound>,
}

/// Contents of the Embree scene of a mesh.
pub(super) enum Triangles<'s> {
    /// Native triangles, tested by Embree.
    Native(NativeMesh<'s>),
    /// Triangle clusters, tested by callbacks.
    TriangleClusters(TriangleClusters),
}

impl<'s> BuildPlan<'s> {
    /// Plans the build of a validated scene.
    pub(super) fn new(scene: &'s Scene, precision: Precision) -> BuildPlan<'s> {
        // Find world-space and instanced meshes; a mesh may be both
        let mut is_in_world = vec![false; scene.geometries.len()];
        let mut is_instanced = vec![false; scene.geometries.len()];
        let mut world = Vec::new();
        for (index, instance) in (0u32..).zip(&scene.instances) {
            let geometry = instance.geometry as usize;
            if let Some(mesh) = world_mesh(scene, instance) {
                // A second instance with the identity transform would coincide with the first in every triangle.
                if !std::mem::replace(&mut is_in_world[geometry], true) {
                    world.push((index, mesh));
                }
            }
            is_instanced[geometry] |= instanced_mesh(scene, instance).is_some();
        }
        // Find duplicates among native triangles only; callbacks break ties themselves
        let uses_clusters = precision == Precision::Watertight;
        let native = if uses_clusters {
            Vec::new()
        } else {
            natives(&world)
        };
        // Bound the ray origins by the bounds of all geometries
        let bounds: Vec<Bounds> = scene.geometries.iter().map(Geometry::bounds).collect();
        BuildPlan {
            scene,
            world,
            native,
            is_instanced,
            origin_bound: OriginBound::of(scene, &bounds),
            uses_clusters,
        }
    }

    /// Returns the scene that is planned.
    pub(super) fn scene(&self) -> &'s Scene {
        self.scene
    }

    /// Returns the world-space meshes that are native triangles, each with its instance.
    pub(super) fn native(&self) -> &[(u32, NativeMesh<'s>)] {
        &self.native
    }

    /// Builds the triangle clusters of the world-space meshes, empty unless watertight; runs on the current thread
    /// pool.
    pub(super) fn triangle_clusters(
        &self,
        mesh_cache: Option<&BuiltMeshes<TriangleClusters>>,
    ) -> TriangleClusters {
        if !self.uses_clusters {
            return TriangleClusters::default();
        }
        TriangleClusters::of(self.world.iter().copied(), self.origin_bound, mesh_cache)
    }

    /// Returns the bound on the origins of rays.
    pub(super) fn origin_bound(&self) -> OriginBound {
        self.origin_bound
    }

    /// Returns the number of world triangles that Embree does not get, including repeated instances.
    pub(super) fn held_back_count(&self) -> usize {
        let given: usize = self.world.iter().map(|(_, mesh)| mesh.triangles.len()).sum();
        let skipped_duplicates = self
            .native
            .iter()
            .map(|(_, given)| given.skipped_duplicates.len());
        world_triangle_count(self.scene) - given + skipped_duplicates.sum::<usize>()
    }

    /// Returns the meshes with scenes of their own, by geometry.
    pub(super) fn placed(&self) -> impl Iterator<Item = Option<InstancedMesh<'s>>> {
        let geometries = (0u32..).zip(&self.scene.geometries).zip(&self.is_instanced);
        geometries.map(|((number, geometry), is_instanced)| {
            let Geometry::Mesh(mesh) = geometry else {
                return None;
            };
            let instances = self.scene.instances.iter();
            let mine = instances.filter(|instance| instance.geometry == number);
            is_instanced.then(|| InstancedMesh {
                mesh,
                origin_bound: self.uses_clusters.then(|| self.origin_bound.in_object(mine)),
            })
        })
    }
}

impl<'s> InstancedMesh<'s> {
    /// Returns the number of triangles of the mesh.
    pub(super) fn triangle_count(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// Returns the contents of the mesh's scene, and a box around all rays that may hit it; runs on the current thread
    /// pool.
    pub(super) fn triangles(
        &self,
        mesh_cache: Option<&BuiltMeshes<TriangleClusters>>,
    ) -> (Triangles<'s>, Bounds) {
        let bounds = self.mesh.bounds();
        match self.origin_bound {
            Some(origin_bound) => {
                let triangle_clusters =
                    TriangleClusters::of(std::iter::once((0, self.mesh)), origin_bound, mesh_cache);
                (
                    Triangles::TriangleClusters(triangle_clusters),
                    origin_bound.padded(&bounds),
                )
            }
            None => {
                let skipped_duplicates = later_duplicates(&[self.mesh]).pop().unwrap_or_default();
                let mesh = self.mesh;
                (
                    Triangles::Native(NativeMesh {
                        mesh,
                        skipped_duplicates,
                    }),
                    bounds,
                )
            }
        }
    }
}

fn natives<'s>(world: &[(u32, &'s Mesh)]) -> Vec<(u32, NativeMesh<'s>)> {
    let meshes: Vec<&Mesh> = world.iter().map(|&(_, mesh)| mesh).collect();
    let skipped_duplicates = later_duplicates(&meshes);
    let given = world.iter().zip(skipped_duplicates);
    given
        .map(|(&(instance, mesh), skipped_duplicates)| {
            (
                instance,
                NativeMesh {
                    mesh,
                    skipped_duplicates,
                },
            )
        })
        .collect()
}
