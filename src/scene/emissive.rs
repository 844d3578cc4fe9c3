//! Emissive objects that also light the scene.
//!
//! Emission alone is only visible: to the camera, in mirrors and through glass. An emissive object with a light on it
//! ([`AreaShape::Object`]) also lights other surfaces, volumes and fog, as an area light in the shape of the object. It
//! emits on both sides, as it is visible from both.

use glam::DVec3;

use super::area_light::{AreaLight, DiskLight, MeshLight, QuadLight, ShapeLight, SphereLight};
use super::{
    AlphaMode, AreaShape, DEFAULT_LIGHT_SAMPLES, Geometry, Instance, Light, LightKind, Material, Model, Scene,
};
use crate::shape::{Shape, Sphere};

/// Largest difference of the squared axes of a round sphere, and of their products from 0, relative to the squares: the
/// rounding error of a chain of rotations. Ellipsoids beyond it are sampled as general shapes.
const ROUNDNESS: f64 = 64.0 * f64::EPSILON;

/// Largest number of emissive objects that [`Scene::add_emissive_lights`] makes lights: every surface samples each of
/// them.
const MAX_EMISSIVE_LIGHTS: usize = 32;

impl Scene {
    /// Adds the area lights of all emissive objects that can be lights, at most 32: those that emit most light if their
    /// textures are left out of account. Together they have the usual number of samples or one each.
    ///
    /// Returns a warning for objects that remain without a light.
    pub fn add_emissive_lights(&mut self) -> Option<String> {
        // Find the emissive objects with the light that they emit
        let mut emitters = Vec::new();
        let mut left_out = Vec::new();
        for (number, instance) in (0..).zip(&self.instances) {
            let material = &self.materials[instance.material as usize];
            if !material.is_emissive() {
                continue;
            }
            match self.emissive_surface(number) {
                Ok(surface) => {
                    let radiance: f64 = material.emission.into_iter().map(f64::from).sum();
                    emitters.push((surface.area() * radiance, number));
                }
                Err(reason) => left_out.push(format!("`{}` ({reason})", instance.name)),
            }
        }
        // Add the strongest ones in the order of the instances
        emitters.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let weak = emitters.len().saturating_sub(MAX_EMISSIVE_LIGHTS);
        emitters.truncate(MAX_EMISSIVE_LIGHTS);
        emitters.sort_by_key(|emitter| emitter.1);
        let samples = (DEFAULT_LIGHT_SAMPLES / emitters.len().max(1) as u32).max(1);
        for (_, number) in emitters {
            if let Err(reason) = self.add_emissive_light(number, samples) {
                left_out.push(format!("instance {number} ({reason})"));
            }
        }
        // Report the others
        match (weak, &left_out[..]) {
            (0, []) => None,
            (0, [first, rest @ ..]) => Some(format!(
                "{} of the emissive objects are no lights, the first of them {first}",
                rest.len() + 1
            )),
            _ => Some(format!(
                "{} of the emissive objects are no lights: {MAX_EMISSIVE_LIGHTS} lights are allowed, and the strongest \
                 ones are taken",
                weak + left_out.len()
            )),
        }
    }

    /// Adds the area light of an emissive object: it takes the name of the instance and the emission of its material,
    /// and every shading point samples `samples` points of it.
    ///
    /// # Errors
    /// One sentence that says why the instance cannot be a light: it does not exist, does not emit, moves or transmits
    /// light, or is a plane, a polyhedron, a quadric or a point cloud.
    pub fn add_emissive_light(&mut self, instance: u32, samples: u32) -> Result<(), String> {
        self.emissive_surface(instance)?;
        let placed = &self.instances[instance as usize];
        let material = &self.materials[placed.material as usize];
        if !material.is_emissive() {
            return Err(format!(
                "its material `{}` has no emission: give it an emission over 0",
                material.name
            ));
        }
        self.lights.push(Light {
            name: placed.name.to_string(),
            intensity: material.emission,
            kind: LightKind::Area {
                shape: AreaShape::Object { instance },
                samples,
            },
        });
        Ok(())
    }

    /// Returns the surface of `instance` as an area light in world space, or a sentence that says why it cannot be one.
    pub(crate) fn emissive_surface(&self, instance: u32) -> Result<AreaLight, String> {
        let Some(instance) = self.instances.get(instance as usize) else {
            return Err("its object does not exist: give the number of an object of the scene".into());
        };
        let geometry = self.geometries.get(instance.geometry as usize);
        let material = self.materials.get(instance.material as usize);
        let (Some(geometry), Some(material)) = (geometry, material) else {
            return Err("its object has no geometry or no material: give it one".into());
        };
        // Light samplers are built once, in world space, so the object must be at rest
        if instance.is_moving() {
            return Err("it moves, and lights cannot move: remove its motion or the area light".into());
        }
        // The light samplers do not model transmission through the surface
        if material.transmits() || material.alpha != AlphaMode::Opaque {
            return Err(format!(
                "its material `{}` transmits light, but an area light must be opaque: make it opaque",
                material.name
            ));
        }
        surface(geometry, instance)
    }

    /// Renumbers the instances of emissive lights: `new_index` holds the new index of each instance that remains.
    /// Lights of removed instances are removed.
    pub(super) fn renumber_emissive_lights(&mut self, new_index: &[Option<u32>]) {
        self.lights.retain_mut(|light| match &mut light.kind {
            LightKind::Area {
                shape: AreaShape::Object { instance },
                ..
            } => match new_index.get(*instance as usize).copied().flatten() {
                Some(index) => {
                    *instance = index;
                    true
                }
                None => false,
            },
            _ => true,
        });
    }

    /// Sets the intensity of emissive lights to the emission of their materials, after materials have changed.
    pub(crate) fn resolve_emissive_lights(&mut self) {
        for light in &mut self.lights {
            if let Some(instance) = light.emissive_instance() {
                let material = self.instances[instance as usize].material;
                light.intensity = self.materials[material as usize].emission;
            }
        }
    }
}

impl Material {
    /// Returns whether the material emits light; the colour of an unlit surface is no light.
    pub(crate) fn is_emissive(&self) -> bool {
        self.emission != [0.0; 3] && self.model != Model::Unlit
    }
}

/// Returns the world-space area light in the shape of `geometry` under the transform of `instance`.
fn surface(geometry: &Geometry, instance: &Instance) -> Result<AreaLight, String> {
    // Map the origin and the unit axes to world space
    let map = instance.world_from_object();
    let (center, [x, y, z]) = (
        map.translation,
        [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| map.matrix3 * axis),
    );
    // Choose the sampling scheme by the shape
    let made = match geometry {
        Geometry::Mesh(mesh) => {
            let corners = |t| mesh.corners_f64(t).map(|p| map.transform_point3(p));
            // Transform the corners in f64, as a light has no instance of its own
            MeshLight::new((0..mesh.triangles.len() as u32).map(corners)).map(AreaLight::Mesh)
        }
        Geometry::Points(_) => {
            return Err(
                "a point cloud cannot be an area light: remove the area light, and its points emit to rays that hit them"
                    .into(),
            );
        }
        Geometry::Shape(Shape::Quad) => QuadLight::new(center, x, y).map(AreaLight::Quad),
        Geometry::Shape(Shape::Disk) => DiskLight::new(center, x, y).map(AreaLight::Disk),
        // Only a sphere that stays round can be sampled as a sphere
        Geometry::Shape(Shape::Sphere(sphere)) if is_round([x, y, z]) => {
            let Sphere { center, radius } = *sphere;
            SphereLight::new(map.transform_point3(center), radius * x.length()).map(AreaLight::Sphere)
        }
        Geometry::Shape(shape) => match ShapeLight::new(shape, map, instance.object_from_world()) {
            Some(made) => made.map(|light| AreaLight::Shape(Box::new(light))),
            None => {
                return Err(
                    "a plane, polyhedron or quadric cannot be an area light: give another shape or a mesh"
                        .into(),
                );
            }
        },
    };
    made.map_err(|error| error.to_string())
}

/// Returns whether a sphere with these conjugate axes in world space is still a sphere, within [`ROUNDNESS`].
fn is_round(axes: [DVec3; 3]) -> bool {
    let [x, y, z] = axes;
    let square = x.length_squared();
    let off = [
        y.length_squared() - square,
        z.length_squared() - square,
        x.dot(y),
        y.dot(z),
        z.dot(x),
    ];
    off.into_iter().all(|off| off.abs() <= ROUNDNESS * square)
}
