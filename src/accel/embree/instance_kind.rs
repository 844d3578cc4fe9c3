//! Classification of instances by their representation in Embree: meshes in world space, instanced meshes, and objects of
//! the user geometry.

use super::native_instances;
use crate::accel::Instancing;
use crate::mesh::Mesh;
use crate::scene::{Geometry, Instance, Scene};

/// Returns the number of primitives of all trees, for the progress: triangles of the world and of instanced meshes,
/// points and objects.
pub(super) fn primitive_count(scene: &Scene) -> usize {
    let mut is_instanced = vec![false; scene.geometries.len()];
    for instance in &scene.instances {
        is_instanced[instance.geometry as usize] |= instanced_mesh(scene, instance).is_some();
    }
    let geometries = scene.geometries.iter().zip(&is_instanced);
    let placed = geometries.map(|(geometry, &placed)| if placed { geometry.primitive_count() } else { 0 });
    let is_object = |i: &&Instance| is_user(scene, i, Instancing::Callback);
    let objects = scene.instances.iter().filter(is_object).count();
    placed.sum::<usize>() + world_triangle_count(scene) + scene.point_count() + objects
}

/// Returns the number of triangles of the world, including repeated instances.
pub(super) fn world_triangle_count(scene: &Scene) -> usize {
    let meshes = scene.instances.iter().filter_map(|i| world_mesh(scene, i));
    meshes.map(|mesh| mesh.triangles.len()).sum()
}

/// Returns the mesh of an instance with the identity transform.
pub(super) fn world_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// Returns the mesh of an instance with a transform other than the identity.
pub(super) fn instanced_mesh<'s>(scene: &'s Scene, instance: &Instance) -> Option<&'s Mesh> {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(mesh) if !instance.is_identity() && !mesh.triangles.is_empty() => Some(mesh),
        _ => None,
    }
}

/// Returns whether an instance is one primitive of the user geometry, unlike a point cloud with one for each point.
pub(super) fn is_user(scene: &Scene, instance: &Instance, instancing: Instancing) -> bool {
    match &scene.geometries[instance.geometry as usize] {
        Geometry::Mesh(_) => {
            instanced_mesh(scene, instance).is_some() && !native_instances::supports(instance, instancing)
        }
        Geometry::Points(_) => false,
        shape => !shape.is_unbounded(),
    }
}
