//! Conservative test whether anything can occlude a light.
//!
//! For every pair of objects, the bounding box of the first is swept to the light. If it does not touch the box of
//! the second, no point of the first has the second in front of the light. A convex object that is seen only from
//! outside occludes no light for itself. Boxes are conservative, so a light found to be unoccluded is unoccluded.

use std::cell::OnceCell;

use glam::DVec3;

use crate::numeric::Bounds;
use crate::scene::{AlphaMode, Camera, Falloff, Geometry, Instance, Light, LightKind, Projection, Scene};
use crate::shape::Shape;

/// Largest number of objects whose pairs are tested; in larger scenes every light counts as occluded.
const MAX_OBJECTS: usize = 64;

/// Result of the test for one light.
#[derive(Clone, Debug, PartialEq)]
pub struct LightVisibility {
    /// True if the light may be occluded.
    pub casts: bool,
    /// Reason for the result, for reports.
    pub reason: String,
}

impl LightVisibility {
    fn none(reason: &str) -> LightVisibility {
        LightVisibility {
            casts: false,
            reason: reason.into(),
        }
    }

    fn some(reason: impl Into<String>) -> LightVisibility {
        LightVisibility {
            casts: true,
            reason: reason.into(),
        }
    }
}

/// Instance with the data that the test needs.
struct Object<'s> {
    placed: &'s Instance,
    geometry: &'s Geometry,
    /// Bounding box in world space, once it was needed: that of a large mesh takes a pass over its triangles.
    bounds: OnceCell<Bounds>,
    name: &'s str,
    /// Index of the instance in the scene.
    instance: u32,
    /// True if the object may occlude a light for itself, from its own far side, where it is translucent.
    hides_itself: bool,
}

/// Returns the test results of all lights, in their order.
pub(super) fn of_lights(scene: &Scene, camera: &Camera) -> Vec<LightVisibility> {
    // Skip the quadratic test in large scenes
    if scene.instances.len() > MAX_OBJECTS {
        let reason = format!("any of {} objects", scene.instances.len());
        return vec![LightVisibility::some(reason); scene.lights.len()];
    }
    let objects: Vec<Object> = scene
        .instances
        .iter()
        .zip(0..)
        .map(|(instance, number)| Object::of(scene, (instance, number), camera))
        .collect();
    // Test surfaces first, then volumes and fog
    scene
        .lights
        .iter()
        .map(|light| {
            let reach = of_light(light, &objects);
            if reach.casts {
                return reach;
            }
            beam_of(light, &objects, scene).unwrap_or(reach)
        })
        .collect()
}

fn of_light(light: &Light, objects: &[Object]) -> LightVisibility {
    if light.intensity == [0.0; 3] {
        return LightVisibility::none("it is dark");
    }
    let lit: Vec<&Object> = objects
        .iter()
        .filter(|object| light.reaches(|| *object.bounds()))
        .collect();
    if lit.is_empty() {
        return LightVisibility::none("nothing is within its range");
    }
    for object in &lit {
        // A convex object that is the light itself gets no light from itself.
        if !object.may_hide(light) {
            continue;
        }
        // Test the object against itself and against all others
        if object.hides_itself {
            return LightVisibility::some(format!("`{}` may hide it from itself", object.name));
        }
        let swept = light.swept(object.bounds(), objects);
        let hiding = objects.iter().find(|other| {
            !std::ptr::eq(*other, *object) && other.may_hide(light) && touch(&swept, other.bounds())
        });
        if let Some(other) = hiding {
            return LightVisibility::some(format!("`{}` may hide it from `{}`", other.name, object.name));
        }
    }
    LightVisibility::none("nothing is between it and what it lights")
}

/// Returns a result if an object may cast its shadow into volumes or fog that the light reaches.
fn beam_of(light: &Light, objects: &[Object], scene: &Scene) -> Option<LightVisibility> {
    if light.intensity == [0.0; 3] {
        return None;
    }
    let filled = scene.volumes.iter().filter(|volume| !volume.is_clear());
    for volume in filled.filter(|volume| light.reaches(|| volume.bounds())) {
        let swept = light.swept(&volume.bounds(), objects);
        let hides = |other: &&Object| other.may_hide(light) && touch(&swept, other.bounds());
        if let Some(other) = objects.iter().find(hides) {
            let reason = format!("`{}` may hide it from volume `{}`", other.name, volume.name());
            return Some(LightVisibility::some(reason));
        }
    }
    // Fog is everywhere, also behind each object that the light reaches.
    if !scene.has_fog() {
        return None;
    }
    let hiding = objects.iter().find(|object| light.reaches(|| *object.bounds()))?;
    Some(LightVisibility::some(format!(
        "`{}` may hide it from fog",
        hiding.name
    )))
}

impl<'s> Object<'s> {
    fn of(scene: &'s Scene, (instance, number): (&'s Instance, u32), camera: &Camera) -> Object<'s> {
        let geometry = &scene.geometries[instance.geometry as usize];
        let material = &scene.materials[instance.material as usize];
        let object = Object {
            placed: instance,
            geometry,
            bounds: OnceCell::new(),
            instance: number,
            name: if instance.name.is_empty() {
                &material.name
            } else {
                &instance.name
            },
            hides_itself: true,
        };
        // Classify its shape and visibility
        let is_flat = matches!(
            geometry,
            Geometry::Shape(Shape::Plane | Shape::Disk | Shape::Quad)
        );
        let is_convex = matches!(
            geometry,
            Geometry::Shape(Shape::Sphere(_) | Shape::Cube | Shape::Polyhedron(_))
        );
        // An opaque convex object that is seen from outside occludes no light for itself
        let from_outside = || {
            !material.transmits()
                && material.translucent().is_none()
                && material.alpha == AlphaMode::Opaque
                && !may_be_seen_from_inside(object.bounds(), camera)
        };
        let hides_itself = !(is_flat || is_convex && from_outside());
        Object {
            hides_itself,
            ..object
        }
    }
}

impl Object<'_> {
    /// Returns the bounding box in world space; unbounded shapes have an infinite one.
    fn bounds(&self) -> &Bounds {
        self.bounds.get_or_init(|| {
            if self.geometry.is_unbounded() {
                return Bounds {
                    min: DVec3::NEG_INFINITY,
                    max: DVec3::INFINITY,
                };
            }
            self.placed.world_bounds(self.geometry, &self.geometry.bounds())
        })
    }

    /// Returns whether the object may occlude a light; a convex object that is the light itself may not.
    fn may_hide(&self, light: &Light) -> bool {
        self.hides_itself || light.emissive_instance() != Some(self.instance)
    }
}

/// Returns whether camera rays may start inside the box.
fn may_be_seen_from_inside(bounds: &Bounds, camera: &Camera) -> bool {
    if camera.world_from_camera_end.is_some() {
        // The path of a moving camera is not worth a closer test.
        return true;
    }
    let eye = camera.world_from_camera.translation;
    let ahead = -camera.world_from_camera.matrix3.z_axis;
    let is_point = !matches!(camera.projection, Projection::Orthographic { .. });
    if is_point && camera.z_near == 0.0 {
        // With a lens, rays start around the camera position.
        let reach = camera.lens_radius();
        return touch(
            bounds,
            &Bounds {
                min: eye - reach,
                max: eye + reach,
            },
        );
    }
    // Otherwise rays start on the near plane.
    let middle = (0.5 * (bounds.min + bounds.max) - eye).dot(ahead);
    let reach = (0.5 * (bounds.max - bounds.min)).dot(ahead.abs());
    !((middle - camera.z_near).abs() > reach)
}

impl Light {
    /// Returns whether any light reaches a box, which is computed only if the light has a range.
    fn reaches(&self, bounds: impl FnOnce() -> Bounds) -> bool {
        let (position, falloff) = match &self.kind {
            LightKind::Directional { .. } | LightKind::Area { .. } => return true,
            LightKind::Point { position, falloff }
            | LightKind::Spot {
                position, falloff, ..
            } => (*position, falloff),
        };
        match falloff {
            Falloff::InverseSquare { range: Some(range) } => {
                let reached = Bounds {
                    min: position - *range,
                    max: position + *range,
                };
                touch(&reached, &bounds())
            }
            _ => true,
        }
    }

    /// Returns a box around all segments from the box to the light.
    fn swept(&self, bounds: &Bounds, objects: &[Object]) -> Bounds {
        match &self.kind {
            LightKind::Directional { to_light } => {
                // Extend the box to infinity towards the light
                let mut swept = *bounds;
                for axis in 0..3 {
                    if to_light[axis] > 0.0 {
                        swept.max[axis] = f64::INFINITY;
                    } else if to_light[axis] < 0.0 {
                        swept.min[axis] = f64::NEG_INFINITY;
                    }
                }
                swept
            }
            LightKind::Point { position, .. } | LightKind::Spot { position, .. } => Bounds {
                min: bounds.min.min(*position),
                max: bounds.max.max(*position),
            },
            LightKind::Area { shape, .. } => {
                let of_object = || {
                    self.emissive_instance()
                        .and_then(|instance| objects.get(instance as usize))
                };
                // Sweep to the bounds of an area light
                let light = shape
                    .bounds()
                    .or_else(|| of_object().map(|object| *object.bounds()));
                light.map_or(*bounds, |light| bounds.union(light))
            }
        }
    }
}

/// Returns whether two boxes have a common point; points on their sides count.
fn touch(a: &Bounds, b: &Bounds) -> bool {
    (0..3).all(|axis| a.min[axis] <= b.max[axis] && b.min[axis] <= a.max[axis])
}
