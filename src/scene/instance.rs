//! Instances: geometries with a transform to world space, stored in as few bytes as the transform needs.
//!
//! A scene may hold millions of instances, most of them spheres that are only moved and scaled, or meshes with the
//! identity transform. Two matrices for each would take 192 bytes, so matrices are stored only for transforms that
//! rotate, mirror or stretch; the others are computed on demand from a scale and a translation. A moving instance
//! stores its motion.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::Geometry;
use crate::mesh::PointCloud;
use crate::numeric::{self, AnimatedTransform, Bounds, MotionError, SingularMatrix};
use crate::shape::{Shape, Sphere};

/// A geometry placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Name for messages: the node's name or number.
    pub name: Arc<str>,
    /// Index of the geometry in [`super::Scene::geometries`].
    pub geometry: u32,
    /// Index of the material in [`super::Scene::materials`].
    pub material: u32,
    placement: Placement,
}

/// Transform from object space to the world.
#[derive(Clone, Debug)]
enum Placement {
    /// The identity: object space is world space.
    Identity,
    /// A positive scale whose reciprocal is finite, then a translation.
    Similar(UniformScale),
    /// Any other map that can be inverted.
    Affine(Box<Affine>),
    /// A map that changes with time.
    Moving(Box<AnimatedTransform>),
}

/// A uniform scale and a translation: `p * scale + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct UniformScale {
    /// Scale factor; it and its reciprocal are positive and finite.
    pub(crate) scale: f64,
    /// Image of the object-space origin.
    pub(crate) translation: DVec3,
}

/// An affine map and its inverse.
#[derive(Clone, Debug)]
pub(super) struct Affine {
    pub(super) world_from_object: DAffine3,
    pub(super) object_from_world: DAffine3,
}

impl Instance {
    /// Creates an instance of `geometry` at rest with the transform `world_from_object`.
    pub fn new(
        name: impl Into<Arc<str>>,
        geometry: u32,
        material: u32,
        world_from_object: DAffine3,
    ) -> Result<Instance, SingularMatrix> {
        Ok(Instance {
            name: name.into(),
            geometry,
            material,
            placement: Placement::new(&world_from_object)?,
        })
    }

    /// Creates an instance of `geometry` whose transform is the first map at the start of the motion and the second at
    /// its end; [`AnimatedTransform`] interpolates between them. With two equal maps the instance is at rest.
    pub fn moving(
        name: impl Into<Arc<str>>,
        geometry: u32,
        material: u32,
        world_from_object: [DAffine3; 2],
    ) -> Result<Instance, MotionError> {
        Ok(Instance {
            name: name.into(),
            geometry,
            material,
            placement: Placement::between(world_from_object)?,
        })
    }

    /// Sets the transform and ends any motion; changes nothing if the map cannot be inverted.
    pub fn place(&mut self, world_from_object: DAffine3) -> Result<(), SingularMatrix> {
        self.placement = Placement::new(&world_from_object)?;
        Ok(())
    }

    /// Replaces the transforms at the start and at the end of the motion by `placed` of each.
    pub(crate) fn replace(&mut self, placed: impl Fn(DAffine3) -> DAffine3) -> Result<(), MotionError> {
        match self.motion() {
            Some(motion) => self.placement = Placement::between(motion.ends().map(placed))?,
            None => self.place(placed(self.world_from_object()))?,
        }
        Ok(())
    }

    /// Returns the instance's motion; `None` for an instance at rest.
    pub fn motion(&self) -> Option<&AnimatedTransform> {
        match &self.placement {
            Placement::Moving(motion) => Some(motion),
            _ => None,
        }
    }

    /// Returns whether the instance moves while the shutter is open.
    #[inline(always)]
    pub fn is_moving(&self) -> bool {
        matches!(self.placement, Placement::Moving(_))
    }

    /// Returns the maps at `time`; `None` for an instance at rest.
    #[inline(always)]
    pub(super) fn moving_at(&self, time: f32) -> Option<Affine> {
        match &self.placement {
            Placement::Moving(motion) => Some(Affine::of(motion, time)),
            _ => None,
        }
    }

    /// Sets the transform to the identity, so that object space is world space.
    pub(crate) fn reset_transform(&mut self) {
        self.placement = Placement::Identity;
    }

    /// Returns the object-to-world map; for a moving instance that at the start of its motion (see [`Instance::pose`]).
    #[inline]
    pub fn world_from_object(&self) -> DAffine3 {
        match &self.placement {
            Placement::Identity => DAffine3::IDENTITY,
            Placement::Similar(UniformScale { scale, translation }) => DAffine3 {
                matrix3: DMat3::from_diagonal(DVec3::splat(*scale)),
                translation: *translation,
            },
            Placement::Affine(affine) => affine.world_from_object,
            Placement::Moving(motion) => motion.at(0.0),
        }
    }

    /// Returns the world-to-object map, the checked inverse; for a moving instance that at the start of its motion.
    #[inline]
    pub fn object_from_world(&self) -> DAffine3 {
        match &self.placement {
            Placement::Identity => DAffine3::IDENTITY,
            Placement::Similar(UniformScale { scale, translation }) => {
                let scale = scale.recip();
                DAffine3 {
                    matrix3: DMat3::from_diagonal(DVec3::splat(scale)),
                    translation: -(scale * *translation),
                }
            }
            Placement::Affine(affine) => affine.object_from_world,
            Placement::Moving(motion) => Affine::of(motion, 0.0).object_from_world,
        }
    }

    /// Returns whether object space is world space, as for every baked mesh.
    #[inline(always)]
    pub fn is_identity(&self) -> bool {
        matches!(self.placement, Placement::Identity)
    }

    /// Returns whether the transform mirrors, so that windings run clockwise when seen from the front.
    pub fn is_mirrored(&self) -> bool {
        match &self.placement {
            Placement::Affine(affine) => affine.world_from_object.matrix3.determinant() < 0.0,
            Placement::Moving(motion) => motion.at(0.0).matrix3.determinant() < 0.0,
            Placement::Identity | Placement::Similar(_) => false,
        }
    }

    /// Returns the sphere in world space if the transform keeps it a sphere without a rotation; `None` otherwise.
    #[inline(always)]
    pub(crate) fn world_sphere(&self, sphere: &Sphere) -> Option<Sphere> {
        match &self.placement {
            Placement::Identity => Some(*sphere),
            Placement::Similar(UniformScale { scale, translation }) => Some(Sphere {
                center: *scale * sphere.center + *translation,
                radius: *scale * sphere.radius,
            }),
            Placement::Affine(_) | Placement::Moving(_) => None,
        }
    }

    /// Returns a world-space box around the instance at all times; `object_bounds` are the bounds of its `geometry`,
    /// and finite.
    pub(crate) fn world_bounds(&self, geometry: &Geometry, object_bounds: &Bounds) -> Bounds {
        let boxed = |map: &DAffine3| transformed_bounds(map, geometry, object_bounds);
        match &self.placement {
            Placement::Moving(motion) => motion.bounds_of(object_bounds, boxed),
            _ => boxed(&self.world_from_object()),
        }
    }

    /// Returns a world-space box around one point of a cloud at all times.
    pub(crate) fn point_bounds(&self, cloud: &PointCloud, point: u32) -> Bounds {
        let sphere = Geometry::Shape(cloud.shape(point));
        self.world_bounds(&sphere, &sphere.bounds())
    }

    /// Returns a world-space box as [`AnimatedTransform::step_bounds`] defines it, after `steps[0]` of `steps[1]`
    /// steps; equal for all steps if the instance is at rest. `object_bounds` are the bounds of its `geometry`, and
    /// finite.
    pub fn step_bounds(&self, geometry: &Geometry, object_bounds: &Bounds, steps: [u32; 2]) -> Bounds {
        let boxed = |map: &DAffine3| transformed_bounds(map, geometry, object_bounds);
        match &self.placement {
            Placement::Moving(motion) => motion.step_bounds(object_bounds, steps, boxed),
            _ => boxed(&self.world_from_object()),
        }
    }

    /// Returns the bytes on the heap that this instance owns, its name not counted.
    pub fn heap_byte_count(&self) -> usize {
        match self.placement {
            Placement::Affine(_) => size_of::<Affine>(),
            Placement::Moving(_) => size_of::<AnimatedTransform>(),
            Placement::Identity | Placement::Similar(_) => 0,
        }
    }
}

/// Returns a box around a geometry that is transformed by `map`.
fn transformed_bounds(map: &DAffine3, geometry: &Geometry, object_bounds: &Bounds) -> Bounds {
    let Geometry::Shape(Shape::Sphere(sphere)) = geometry else {
        return object_bounds.transformed(map);
    };
    // The half extent of an ellipsoid along an axis is the length of the matrix's row; the transformed box would be
    // larger.
    let rows = map.matrix3.transpose();
    let reach = DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length());
    let center = map.transform_point3(sphere.center);
    Bounds {
        min: center - sphere.radius * reach,
        max: center + sphere.radius * reach,
    }
}

impl Affine {
    /// Returns the maps of a motion at `time`.
    fn of(motion: &AnimatedTransform, time: f32) -> Affine {
        let world_from_object = motion.at(f64::from(time));
        Affine {
            // The condition number of a sum of definite matrices is at most that of the worse one, but not in the norm
            // in which `inverse` checks it; so the check may fail at times between two ends that passed it.
            object_from_world: numeric::inverse(&world_from_object)
                .unwrap_or_else(|_| world_from_object.inverse()),
            world_from_object,
        }
    }
}

impl Placement {
    fn between(ends: [DAffine3; 2]) -> Result<Placement, MotionError> {
        let [start, end] = ends;
        // Equal ends need neither a motion nor its cost
        if start == end {
            return Ok(Placement::new(&start)?);
        }
        Ok(Placement::Moving(Box::new(AnimatedTransform::new(start, end)?)))
    }

    fn new(map: &DAffine3) -> Result<Placement, SingularMatrix> {
        if *map == DAffine3::IDENTITY {
            return Ok(Placement::Identity);
        }
        let object_from_world = numeric::inverse(map)?;
        // A scale of which all axes are equal needs no matrices
        let scale = map.matrix3.x_axis.x;
        let is_similar = scale > 0.0
            && scale.recip().is_finite()
            && map.matrix3 == DMat3::from_diagonal(DVec3::splat(scale));
        Ok(if is_similar {
            Placement::Similar(UniformScale {
                scale,
                translation: map.translation,
            })
        } else {
            Placement::Affine(Box::new(Affine {
                world_from_object: *map,
                object_from_world,
            }))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_transform_returns_its_map_and_inverse() {
        let moved = DAffine3::from_translation(DVec3::new(1.0, -2.0, 3.0));
        for map in [
            DAffine3::IDENTITY,
            moved,
            moved * DAffine3::from_scale(DVec3::splat(0.3)),
            moved * DAffine3::from_scale(DVec3::splat(-0.3)),
            moved * DAffine3::from_rotation_x(0.4) * DAffine3::from_scale(DVec3::new(2.0, 1.0, -1e-3)),
        ] {
            let instance = Instance::new("", 0, 0, map).unwrap();
            assert_eq!(instance.world_from_object(), map);
            let back = instance.object_from_world() * map;
            // The condition number is 2e3 at most, the translation 3: a few times 6e3 roundings.
            assert!(
                back.abs_diff_eq(DAffine3::IDENTITY, 6e3 * 16.0 * f64::EPSILON),
                "{back}"
            );
            assert_eq!(instance.is_identity(), map == DAffine3::IDENTITY);
            assert_eq!(instance.is_mirrored(), map.matrix3.determinant() < 0.0);
        }
    }

    #[test]
    fn singular_map_is_rejected_without_change() {
        let mut instance = Instance::new("", 0, 0, DAffine3::IDENTITY).unwrap();
        for bad in [
            DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.0)),
            DAffine3::from_translation(DVec3::new(0.0, f64::NAN, 0.0)),
        ] {
            assert!(instance.place(bad).is_err());
            assert!(instance.is_identity());
        }
    }

    #[test]
    fn transformed_sphere_has_the_bounds_of_its_ellipsoid() {
        let turn = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_4);
        let map = turn * DAffine3::from_scale(DVec3::new(3.0, 1.0, 1.0));
        let instance = Instance::new("", 0, 0, map).unwrap();
        let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
        let bounds = instance.world_bounds(&sphere, &sphere.bounds());
        // The rows are (3, -1, 0) / √2 and (3, 1, 0) / √2: both √5 long.
        assert!(
            (bounds.max - DVec3::new(5f64.sqrt(), 5f64.sqrt(), 1.0))
                .abs()
                .max_element()
                < 1e-15
        );
    }

    #[test]
    fn motion_between_equal_transforms_is_none() {
        let map = DAffine3::from_rotation_x(0.4);
        let instance = Instance::moving("", 0, 0, [map; 2]).unwrap();
        assert!(!instance.is_moving());
        assert_eq!(instance.world_from_object(), map);
        let mut turning = Instance::moving("", 0, 0, [map, DAffine3::IDENTITY]).unwrap();
        assert!(turning.is_moving() && !turning.is_identity());
        turning
            .replace(|map| DAffine3::from_translation(DVec3::X) * map)
            .unwrap();
        assert_eq!(turning.pose(1.0).world_from_object().translation, DVec3::X);
        turning.place(map).unwrap();
        assert!(!turning.is_moving());
    }

    #[test]
    fn moving_bounds_contain_the_object_at_all_times() {
        let start = DAffine3::from_translation(DVec3::new(1.0, 0.5, 0.0))
            * DAffine3::from_scale(DVec3::new(2.0, 0.3, 1.0));
        let end = DAffine3::from_axis_angle(DVec3::new(0.6, 0.0, 0.8), 2.9)
            * DAffine3::from_scale(DVec3::new(1.0, 1.3, 0.2));
        let instance = Instance::moving("", 0, 0, [start, end]).unwrap();
        for shape in [Shape::Cube, Shape::Sphere(Sphere::UNIT)] {
            let geometry = Geometry::Shape(shape);
            let object = geometry.bounds();
            let all = instance.world_bounds(&geometry, &object);
            let steps = 16;
            // Compare the exact box at many times with both kinds of bounds
            for number in 0..=1600u32 {
                let time = f64::from(number) / 1600.0;
                let exact = transformed_bounds(
                    &instance.pose(time as f32).world_from_object(),
                    &geometry,
                    &object,
                );
                // Interpolate between the boxes of the steps before and after
                let step = (number / 100).min(steps - 1);
                let [from, to] =
                    [step, step + 1].map(|step| instance.step_bounds(&geometry, &object, [step, steps]));
                let part = time * f64::from(steps) - f64::from(step);
                let between = Bounds {
                    min: from.min.lerp(to.min, part),
                    max: from.max.lerp(to.max, part),
                };
                for held in [&all, &between] {
                    // The time is rounded to f32; points move by up to 12 per unit of time.
                    let slack = DVec3::splat(12.0 * 0.5f64.powi(25));
                    assert!(
                        (exact.min + slack).cmpge(held.min).all()
                            && (exact.max - slack).cmple(held.max).all()
                    );
                }
                // The padding is small: boxes of neighbouring steps differ by more.
                assert!(
                    number % 100 != 0 || (exact.min - from.min).min(exact.min - to.min).max_element() < 0.05
                );
            }
        }
    }

    #[test]
    fn unrotated_instance_takes_at_most_64_bytes() {
        assert!(size_of::<Instance>() <= 64, "{}", size_of::<Instance>());
    }
}
