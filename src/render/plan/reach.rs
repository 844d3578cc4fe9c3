//! Whether anything can stand between a light and what it lights.
//!
//! For every pair of objects: the box around the first is swept to the light, and if the box around the second is not
//! touched by that, no point of the first has the second before the light. A convex object that is only seen from
//! outside hides no light from itself. Boxes are the worst case, so what is found impossible is impossible.

use glam::DVec3;

use crate::numeric::Bounds;
use crate::scene::{AlphaMode, Camera, Falloff, Geometry, Instance, Light, LightKind, Projection, Scene};
use crate::shape::Shape;

/// Objects whose pairs are looked at; in larger scenes every light is taken to be hidden somewhere.
const MAX_OBJECTS: usize = 64;

/// What one light's shadow rays can meet.
#[derive(Clone, Debug, PartialEq)]
pub struct LightReach {
    /// Whether anything may hide it.
    pub casts: bool,
    /// Why, or why not.
    pub reason: String,
}

impl LightReach {
    fn none(reason: &str) -> LightReach {
        LightReach {
            casts: false,
            reason: reason.into(),
        }
    }

    fn some(reason: impl Into<String>) -> LightReach {
        LightReach {
            casts: true,
            reason: reason.into(),
        }
    }
}

/// An instance as a light sees it.
struct Object<'s> {
    bounds: Bounds,
    name: &'s str,
    /// Its number.
    instance: u32,
    /// Whether it may hide the light from itself: from its own far side, where it is translucent.
    hides_itself: bool,
}

/// What each light's shadow rays can meet, in the order of the lights.
pub(super) fn of_lights(scene: &Scene, camera: &Camera) -> Vec<LightReach> {
    if scene.instances.len() > MAX_OBJECTS {
        let reason = format!("any of {} objects", scene.instances.len());
        return vec![LightReach::some(reason); scene.lights.len()];
    }
    let objects: Vec<Object> = scene
        .instances
        .iter()
        .zip(0..)
        .map(|(instance, number)| Object::of(scene, (instance, number), camera))
        .collect();
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

fn of_light(light: &Light, objects: &[Object]) -> LightReach {
    if light.intensity == [0.0; 3] {
        return LightReach::none("it is dark");
    }
    let lit: Vec<&Object> = objects
        .iter()
        .filter(|object| light.lights(&object.bounds))
        .collect();
    if lit.is_empty() {
        return LightReach::none("nothing is within its range");
    }
    for object in &lit {
        // What is one itself, and convex, gets nothing of it.
        if !object.may_hide(light) {
            continue;
        }
        if object.hides_itself {
            return LightReach::some(format!("`{}` may hide it from itself", object.name));
        }
        let swept = light.swept(&object.bounds, objects);
        let hiding = objects.iter().find(|other| {
            !std::ptr::eq(*other, *object) && other.may_hide(light) && touch(&swept, &other.bounds)
        });
        if let Some(other) = hiding {
            return LightReach::some(format!("`{}` may hide it from `{}`", other.name, object.name));
        }
    }
    LightReach::none("nothing stands between it and what it lights")
}

/// Whether an object may throw its shadow into what a light lights of volumes and fog.
fn beam_of(light: &Light, objects: &[Object], scene: &Scene) -> Option<LightReach> {
    if light.intensity == [0.0; 3] {
        return None;
    }
    let filled = scene.volumes.iter().filter(|volume| !volume.is_clear());
    for volume in filled.filter(|volume| light.lights(&volume.bounds())) {
        let swept = light.swept(&volume.bounds(), objects);
        let hides = |other: &&Object| other.may_hide(light) && touch(&swept, &other.bounds);
        if let Some(other) = objects.iter().find(hides) {
            let reason = format!("`{}` may hide it from volume `{}`", other.name, volume.name());
            return Some(LightReach::some(reason));
        }
    }
    // Fog is everywhere: also behind whatever the light gets to.
    let hiding = objects.iter().find(|object| light.lights(&object.bounds));
    let hiding = hiding.filter(|_| scene.has_fog())?;
    Some(LightReach::some(format!(
        "`{}` may hide it from fog",
        hiding.name
    )))
}

impl<'s> Object<'s> {
    fn of(scene: &'s Scene, (instance, number): (&'s Instance, u32), camera: &Camera) -> Object<'s> {
        let geometry = &scene.geometries[instance.geometry as usize];
        let material = &scene.materials[instance.material as usize];
        let bounds = if geometry.is_unbounded() {
            Bounds {
                min: DVec3::NEG_INFINITY,
                max: DVec3::INFINITY,
            }
        } else {
            instance.world_bounds(geometry, &geometry.bounds())
        };
        let is_flat = matches!(
            geometry,
            Geometry::Shape(Shape::Plane | Shape::Disk | Shape::Quad)
        );
        let is_convex = matches!(
            geometry,
            Geometry::Shape(Shape::Sphere(_) | Shape::Cube | Shape::Polyhedron(_))
        );
        let from_outside = !material.transmits()
            && material.translucent().is_none()
            && material.alpha == AlphaMode::Opaque
            && !may_be_seen_from_inside(&bounds, camera);
        Object {
            bounds,
            instance: number,
            name: if instance.name.is_empty() {
                &material.name
            } else {
                &instance.name
            },
            hides_itself: !(is_flat || is_convex && from_outside),
        }
    }
}

impl Object<'_> {
    /// Whether it may stand before a light: what is one itself, and convex, does not.
    fn may_hide(&self, light: &Light) -> bool {
        self.hides_itself || light.lamp() != Some(self.instance)
    }
}

/// Whether camera rays may begin within the box.
fn may_be_seen_from_inside(bounds: &Bounds, camera: &Camera) -> bool {
    if camera.world_from_camera_end.is_some() {
        // A camera that moves may be anywhere, as far as this is worth knowing.
        return true;
    }
    let eye = camera.world_from_camera.translation;
    let ahead = -camera.world_from_camera.matrix3.z_axis;
    let is_point = !matches!(camera.projection, Projection::Orthographic { .. });
    if is_point && camera.z_near == 0.0 {
        // With a lens they begin around the eye.
        let reach = camera.lens_radius();
        return touch(
            bounds,
            &Bounds {
                min: eye - reach,
                max: eye + reach,
            },
        );
    }
    // They begin on the near plane.
    let middle = (0.5 * (bounds.min + bounds.max) - eye).dot(ahead);
    let reach = (0.5 * (bounds.max - bounds.min)).dot(ahead.abs());
    !((middle - camera.z_near).abs() > reach)
}

impl Light {
    /// Whether any of its light gets to the box.
    fn lights(&self, bounds: &Bounds) -> bool {
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
                touch(&reached, bounds)
            }
            _ => true,
        }
    }

    /// A box around all ways from the box to the light.
    fn swept(&self, bounds: &Bounds, objects: &[Object]) -> Bounds {
        match &self.kind {
            LightKind::Directional { to_light } => {
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
                let of_object = || self.lamp().and_then(|lamp| objects.get(lamp as usize));
                let light = shape.bounds().or_else(|| of_object().map(|object| object.bounds));
                light.map_or(*bounds, |light| bounds.union(light))
            }
        }
    }
}

/// Whether two boxes have a point in common; points on their sides count.
fn touch(a: &Bounds, b: &Bounds) -> bool {
    (0..3).all(|axis| a.min[axis] <= b.max[axis] && b.min[axis] <= a.max[axis])
}
