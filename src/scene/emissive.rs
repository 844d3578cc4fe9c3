//! Objects that light the scene by what shines of them.
//!
//! Emission alone is only seen: by the camera, in mirrors and through glass. A lamp is an object whose emission also
//! lights other surfaces, volumes and fog, as a light with an extent in the shape of the object
//! ([`AreaShape::Object`]). It shines on both sides, as it is seen to.

use glam::DVec3;

use super::{AlphaMode, AreaShape, Geometry, Instance, Light, LightKind, Material, Model, Scene};
use crate::shading::{AreaLight, DiskLight, MeshLight, QuadLight, ShapeLight, SphereLight};
use crate::shape::{Shape, Sphere};

/// How far the squares of a round sphere's axes may be apart, and their products from 0, relative to the squares: what
/// the rounding of a chain of turns leaves. Stretched ones are asked as other bodies are.
const ROUNDNESS: f64 = 64.0 * f64::EPSILON;

impl Scene {
    /// Makes a lamp of an instance: adds the light that lies on it, of which every surface asks `samples` points, and
    /// which has the instance's name and its material's emission.
    ///
    /// # Errors
    /// One sentence that says why it cannot be one: there is no such instance, it does not shine, it moves, light goes
    /// through it, or it is a plane, a polyhedron or a quadric.
    pub fn add_emissive_light(&mut self, instance: u32, samples: u32) -> Result<(), String> {
        self.lamp_surface(instance)?;
        let placed = &self.instances[instance as usize];
        let material = &self.materials[placed.material as usize];
        if !material.shines() {
            return Err(format!(
                "its material `{}` has no emission: give it some",
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

    /// The surface of an instance as a light in world space, or why it cannot be one.
    pub(crate) fn lamp_surface(&self, instance: u32) -> Result<AreaLight, String> {
        let Some(instance) = self.instances.get(instance as usize) else {
            return Err("its object does not exist: give the number of one of the scene's".into());
        };
        let geometry = self.geometries.get(instance.geometry as usize);
        let material = self.materials.get(instance.material as usize);
        let (Some(geometry), Some(material)) = (geometry, material) else {
            return Err("its object has no geometry or no material: give it one".into());
        };
        if instance.is_moving() {
            return Err("it moves, and lights stand still: take its motion or the lamp away".into());
        }
        if material.transmits() || material.alpha != AlphaMode::Opaque {
            return Err(format!(
                "its material `{}` lets light through, which a lamp cannot: make it opaque",
                material.name
            ));
        }
        surface(geometry, instance)
    }

    /// Gives lamps the new numbers of their instances: `new_index` holds that of each instance which is left. The
    /// lights of others go with them.
    pub(super) fn renumber_lamps(&mut self, new_index: &[Option<u32>]) {
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

    /// Gives lamps the emission of their materials again, after those have changed.
    pub(crate) fn resolve_emissive_lights(&mut self) {
        for light in &mut self.lights {
            if let Some(instance) = light.lamp() {
                let material = self.instances[instance as usize].material;
                light.intensity = self.materials[material as usize].emission;
            }
        }
    }
}

impl Material {
    /// Whether its emission is light rather than what an unlit surface looks like.
    pub(crate) fn shines(&self) -> bool {
        self.emission != [0.0; 3] && self.model != Model::Unlit
    }
}

/// The surface of `geometry` where `instance` places it.
fn surface(geometry: &Geometry, instance: &Instance) -> Result<AreaLight, String> {
    let map = instance.world_from_object();
    let (center, [x, y, z]) = (
        map.translation,
        [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| map.matrix3 * axis),
    );
    let made = match geometry {
        Geometry::Mesh(mesh) => {
            let corners = |t| mesh.corners_f64(t).map(|p| map.transform_point3(p));
            MeshLight::new((0..mesh.triangles.len() as u32).map(corners)).map(AreaLight::Mesh)
        }
        Geometry::Shape(Shape::Quad) => QuadLight::new(center, x, y).map(AreaLight::Quad),
        Geometry::Shape(Shape::Disk) => DiskLight::new(center, x, y).map(AreaLight::Disk),
        Geometry::Shape(Shape::Sphere(sphere)) if is_round([x, y, z]) => {
            let Sphere { center, radius } = *sphere;
            SphereLight::new(map.transform_point3(center), radius * x.length()).map(AreaLight::Sphere)
        }
        Geometry::Shape(shape) => match ShapeLight::new(shape, map, instance.object_from_world()) {
            Some(made) => made.map(|body| AreaLight::Body(Box::new(body))),
            None => {
                return Err(
                    "no plane, polyhedron or quadric can be one: give another shape or a mesh".into(),
                );
            }
        },
    };
    made.map_err(|error| error.to_string())
}

/// Whether a sphere with these conjugate axes is one.
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
