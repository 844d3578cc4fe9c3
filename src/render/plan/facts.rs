//! Facts about a scene that a plan is based on: the materials, meshes and lights in use, collected in one pass.

use super::light_visibility::{self, LightVisibility};
use crate::mesh::{Mesh, PointCloud};
use crate::scene::{Camera, Geometry, Material, Scene, TextureBinding};

/// Parts of a scene that are in use.
pub struct Facts<'s> {
    /// Scene that is planned.
    pub scene: &'s Scene,
    /// Camera that sees the scene.
    pub camera: &'s Camera,
    /// Materials that some instance uses.
    pub materials: Vec<&'s Material>,
    /// Meshes that some instance uses, with the name of its material.
    pub meshes: Vec<(&'s Mesh, &'s str)>,
    /// Point clouds that some instance uses, with the name of its material.
    pub clouds: Vec<(&'s PointCloud, &'s str)>,
    /// Occlusion of every light.
    pub lights: Vec<LightVisibility>,
}

impl<'s> Facts<'s> {
    /// Collects the facts of a scene that has passed [`Scene::validate`].
    pub fn of(scene: &'s Scene, camera: &'s Camera) -> Facts<'s> {
        let mut has_material = vec![false; scene.materials.len()];
        // Material of the first instance of each geometry.
        let mut shown = vec![None; scene.geometries.len()];
        for instance in &scene.instances {
            has_material[instance.material as usize] = true;
            shown[instance.geometry as usize].get_or_insert(instance.material);
        }
        let mesh = |(geometry, material): (&'s Geometry, &Option<u32>)| match (geometry, material) {
            (Geometry::Mesh(mesh), Some(material)) => {
                Some((mesh, scene.materials[*material as usize].name.as_str()))
            }
            _ => None,
        };
        let cloud = |(geometry, material): (&'s Geometry, &Option<u32>)| {
            let material = &scene.materials[(*material)? as usize];
            Some((geometry.point_cloud()?, material.name.as_str()))
        };
        Facts {
            scene,
            camera,
            materials: scene
                .materials
                .iter()
                .zip(has_material)
                .filter_map(|(material, is_used)| is_used.then_some(material))
                .collect(),
            meshes: scene.geometries.iter().zip(&shown).filter_map(mesh).collect(),
            clouds: scene.geometries.iter().zip(&shown).filter_map(cloud).collect(),
            lights: light_visibility::of_lights(scene, camera),
        }
    }

    /// Returns `reason` for the first material that fulfils `calls`, and the number of further ones.
    pub(super) fn material(
        &self,
        calls: impl Fn(&Material) -> bool,
        reason: impl Fn(&Material) -> String,
    ) -> Option<String> {
        // Find the first material and count the others
        let mut calling = self.materials.iter().filter(|material| calls(material));
        let first = calling.next()?;
        let of = self.materials.len();
        Some(match calling.count() {
            0 => format!("material `{}` {}", first.name, reason(first)),
            more => format!(
                "material `{}` {}, and {more} more of {of}",
                first.name,
                reason(first)
            ),
        })
    }

    /// Returns `reason` for the first texture layer that fulfils `calls`, and the number of further materials with
    /// one.
    pub(super) fn layer(
        &self,
        calls: impl Fn(&TextureBinding) -> bool,
        reason: impl Fn(&TextureBinding) -> String,
    ) -> Option<String> {
        let find = |material: &Material| material.layers.iter().copied().find(|layer| calls(layer));
        self.material(
            |material| find(material).is_some(),
            |material| find(material).map_or_else(String::new, |layer| reason(&layer)),
        )
    }
}
