//! Baking of mesh transforms: a mesh that is used once is transformed to world space at load time, so that rays need no
//! transform to intersect it.
//!
//! Every vertex is mapped in f64 and rounded to f32 once.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::mesh_cleanup::{self, Removed};
use super::{Geometry, Material, Scene, Space, Texture};
use crate::buffer::Buffer;
use crate::mesh::Mesh;
use crate::numeric;
use crate::parallel;

/// Returns the mesh transformed by `map`. Normals keep pointing outside, and a mirroring map reverses the windings so
/// that the front side stays the front side. Tangents are transformed too; a mirroring map flips their handedness,
/// because it does not flip the normals.
pub(crate) fn bake_mesh(mesh: &Mesh, map: &DAffine3) -> Mesh {
    let normal = |n: [f32; 3]| {
        numeric::transform_normal(&map.matrix3, Vec3::from(n).as_dvec3())
            .as_vec3()
            .to_array()
    };
    // The sign of the determinant decides whether windings and handedness are reversed
    let is_mirrored = map.matrix3.determinant() < 0.0;
    let handedness = if is_mirrored { -1.0 } else { 1.0 };
    let tangent = |[x, y, z, w]: [f32; 4]| {
        let t = Vec3::new(x, y, z).as_dvec3();
        // A tangent that the map collapses to zero is kept
        let moved = (map.matrix3 * t).try_normalize().unwrap_or(t);
        moved.as_vec3().extend(w * handedness).to_array()
    };
    Mesh {
        triangles: if is_mirrored {
            mapped(&mesh.triangles, |[a, b, c]| [a, c, b])
        } else {
            mesh.triangles.clone()
        },
        normals: match &mesh.normals {
            // Under a uniform scale directions keep their exact bits and need no new copy
            Some(normals) if !is_scaling(&map.matrix3) => Some(mapped(normals, normal)),
            kept => kept.clone(),
        },
        tangents: match &mesh.tangents {
            Some(tangents) if !is_scaling(&map.matrix3) => Some(mapped(tangents, tangent)),
            kept => kept.clone(),
        },
        ..with_positions(mesh, |p| map.transform_point3(p))
    }
}

/// Returns whether `map` is a positive uniform scale, under which normals and tangents keep their exact bits.
fn is_scaling(map: &DMat3) -> bool {
    let factor = map.x_axis.x;
    factor > 0.0 && *map == DMat3::from_diagonal(DVec3::splat(factor))
}

/// Returns the mesh with its positions mapped by `moved` in f64; all other arrays are shared with `mesh`.
pub(crate) fn with_positions(mesh: &Mesh, moved: impl Fn(DVec3) -> DVec3 + Sync) -> Mesh {
    let position = |p: [f32; 3]| moved(Vec3::from(p).as_dvec3()).as_vec3().to_array();
    Mesh {
        positions: mapped(&mesh.positions, position),
        ..mesh.clone()
    }
}

/// Returns a buffer of `map` applied to every element, computed on several threads.
fn mapped<T: bytemuck::Pod + Send + Sync>(elements: &[T], map: impl Fn(T) -> T + Sync) -> Buffer<T> {
    Buffer::from(parallel::generate(elements.len(), |i| map(elements[i])))
}

/// Returns whether `material` has a procedural texture in object space, which baking the transform would change.
pub(crate) fn has_object_space_texture(material: &Material, textures: &[Texture]) -> bool {
    material.layers.iter().any(|layer| {
        let texture = textures.get(layer.texture.texture as usize);
        matches!(texture, Some(Texture::Procedural(procedural)) if procedural.space == Space::Object)
    })
}

impl Scene {
    /// Bakes every mesh that exactly one instance uses, unless that instance has the identity transform, moves, or has
    /// a material whose procedural texture is evaluated in object space.
    pub(super) fn bake_single_uses(&mut self) {
        let use_counts = self.use_counts();
        // Skip shapes and meshes whose object space must stay as it is
        for instance in &mut self.instances {
            let Geometry::Mesh(mesh) = &mut self.geometries[instance.geometry as usize] else {
                continue;
            };
            let has_object_space_texture = self
                .materials
                .get(instance.material as usize)
                .is_some_and(|m| has_object_space_texture(m, &self.textures));
            let keeps_transform = instance.is_identity() || instance.is_moving();
            if use_counts[instance.geometry as usize] != 1 || keeps_transform || has_object_space_texture {
                continue;
            }
            // Transform the mesh to world space
            *mesh = bake_mesh(mesh, &instance.world_from_object());
            instance.reset_transform();
        }
    }

    /// Removes the triangles that lost their area when their vertices were moved and rounded to f32, and sets vertices
    /// that left its range to zero. Returns the numbers of triangles, each with the name of an instance that they
    /// belonged to.
    pub(super) fn drop_rounded_triangles(&mut self) -> Vec<(String, Removed)> {
        let mut dropped = Vec::new();
        for (index, geometry) in self.geometries.iter_mut().enumerate() {
            let Geometry::Mesh(mesh) = geometry else { continue };
            // Remove them, and name an instance of the mesh
            if mesh_cleanup::scan(mesh).is_ok_and(|scan| scan.unusable > 0) {
                let mut instances = self.instances.iter();
                let owner = instances.find(|instance| instance.geometry as usize == index);
                let name = owner.map_or_else(String::new, |owner| owner.name.to_string());
                dropped.push((name, mesh_cleanup::drop_unusable(mesh)));
            }
            // Vertices that no triangle uses may be beyond the range of f32
            mesh_cleanup::clear_non_finite_positions(mesh);
        }
        dropped
    }

    /// Removes meshes without triangles and their instances, and renumbers geometries, instances and emissive objects.
    pub(super) fn remove_empty_meshes(&mut self) {
        let is_empty: Vec<bool> = self.geometries.iter().map(|g| g.primitive_count() == 0).collect();
        if !is_empty.contains(&true) {
            return;
        }
        // Number the geometries that remain
        let mut number = 0;
        let new_index: Vec<u32> = is_empty
            .iter()
            .map(|&empty| {
                let index = number;
                number += u32::from(!empty);
                index
            })
            .collect();
        // Number the instances that remain
        let mut left = 0;
        let new_instance: Vec<Option<u32>> = self
            .instances
            .iter()
            .map(|i| {
                let index = left;
                let remains = !is_empty[i.geometry as usize];
                left += u32::from(remains);
                remains.then_some(index)
            })
            .collect();
        // Apply the new numbers
        self.renumber_emissive_lights(&new_instance);
        self.instances.retain(|i| !is_empty[i.geometry as usize]);
        for instance in &mut self.instances {
            instance.geometry = new_index[instance.geometry as usize];
        }
        self.geometries.retain(|g| g.primitive_count() > 0);
    }

    /// Returns the number of instances of each geometry.
    pub(crate) fn use_counts(&self) -> Vec<usize> {
        let mut counts = vec![0; self.geometries.len()];
        for instance in &self.instances {
            counts[instance.geometry as usize] += 1;
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Instance, Normalisation};

    fn triangle() -> Mesh {
        Mesh {
            positions: Buffer::from(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            triangles: Buffer::from(vec![[0, 1, 2]]),
            normals: Some(Buffer::from(vec![[0.0, 0.0, 1.0]; 3])),
            tangents: Some(Buffer::from(vec![[1.0, 0.0, 0.0, 1.0]; 3])),
            ..Mesh::default()
        }
    }

    #[test]
    fn mirrored_triangle_swaps_winding_and_keeps_its_outward_normal() {
        let mirror = DAffine3::from_scale(DVec3::new(-2.0, 1.0, 1.0));
        let baked = bake_mesh(&triangle(), &mirror);
        assert_eq!(baked.positions[1], [-2.0, 0.0, 0.0]);
        assert_eq!(baked.triangles[0], [0, 2, 1]);
        // The winding normal is (0,1,0) x (-2,0,0) = (0,0,2), on the side of the shading normal.
        assert_eq!(baked.normals.as_ref().unwrap()[0], [0.0, 0.0, 1.0]);
        let [a, b, c] = baked.corners_f64(0);
        assert_eq!((b - a).cross(c - a), DVec3::new(0.0, 0.0, 2.0));
    }

    #[test]
    fn tangents_are_transformed_and_mirrors_flip_handedness() {
        let tangent = |map: &DAffine3| bake_mesh(&triangle(), map).tangents.unwrap()[0];
        // x maps to -x, and n x t = z x -x = -y: the bitangent, which stays y, points the other way.
        let mirror = DAffine3::from_scale(DVec3::new(-2.0, 1.0, 1.0));
        assert_eq!(tangent(&mirror), [-1.0, 0.0, 0.0, -1.0]);
        // A shear maps x to (3, 4) / 5.
        let shear = DMat3::from_cols(DVec3::new(3.0, 4.0, 0.0), DVec3::Y, DVec3::Z);
        assert_eq!(tangent(&DAffine3::from_mat3(shear)), [0.6, 0.8, 0.0, 1.0]);
    }

    #[test]
    fn triangles_that_normalisation_collapses_are_dropped() {
        // Scaled by 1e-30, the corners of the small triangle are below the smallest f32
        let corners = |size: f32| vec![[0.0; 3], [size, 0.0, 0.0], [0.0, size, 0.0]];
        let mesh = Mesh {
            positions: [corners(1e30), corners(1e-16)].concat().into(),
            triangles: vec![[0, 1, 2], [3, 4, 5]].into(),
            ..Mesh::default()
        };
        let bounds = [mesh.bounds()];
        let mut scene = Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            materials: vec![Material::default()],
            instances: vec![Instance::new("both", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        scene.normalise_and_bake(Normalisation::fitting(&bounds[0]), &bounds);
        assert_eq!(scene.geometries[0].primitive_count(), 1);
        assert_eq!(scene.warnings, ["both had 1 triangle without an area: dropped"]);
        assert!(scene.validate().is_ok());
    }

    #[test]
    fn unused_vertices_that_normalisation_takes_beyond_all_numbers_become_zero() {
        let corners = [[0.0; 3], [1e-20, 0.0, 0.0], [0.0, 1e-20, 0.0]];
        let mesh = Mesh {
            positions: [&corners[..], &[[1e30; 3]]].concat().into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        };
        let bounds = [mesh_cleanup::scan(&mesh).unwrap().bounds];
        let mut scene = Scene {
            geometries: vec![Geometry::Mesh(mesh)],
            materials: vec![Material::default()],
            instances: vec![Instance::new("tiny", 0, 0, DAffine3::IDENTITY).unwrap()],
            ..Scene::default()
        };
        scene.normalise_and_bake(Normalisation::fitting(&bounds[0]), &bounds);
        assert!(scene.warnings.is_empty() && scene.validate().is_ok());
    }

    #[test]
    fn only_single_use_meshes_are_baked_and_degenerate_triangles_counted() {
        let moved = DAffine3::from_translation(DVec3::new(1e9, 0.0, 0.0));
        let at = |geometry| Instance::new(format!("g{geometry}"), geometry, 0, moved).unwrap();
        let mut scene = Scene {
            geometries: vec![Geometry::Mesh(triangle()), Geometry::Mesh(triangle())],
            instances: vec![at(0), at(1), at(1)],
            ..Scene::default()
        };
        // At 1e9 the spacing of f32 is 64, so the unit triangle collapses.
        scene.bake_single_uses();
        let dropped = scene.drop_rounded_triangles();
        assert_eq!(dropped.len(), 1);
        assert_eq!(dropped[0].1.no_area, 1);
        assert!(scene.instances[0].is_identity());
        assert!(!scene.instances[1].is_identity());
        // Removing the collapsed mesh renumbers the other one
        scene.remove_empty_meshes();
        assert_eq!(scene.geometries.len(), 1);
        assert_eq!(
            scene.instances.iter().map(|i| i.geometry).collect::<Vec<_>>(),
            [0, 0]
        );
    }
}
