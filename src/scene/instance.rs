//! A geometry placed in the world, in as few bytes as its placement needs.
//!
//! A scene may hold millions of instances, most of them spheres that are moved and scaled or meshes that stand where
//! they are. Two matrices for each would take 192 bytes, so matrices are kept only where the placement turns, mirrors or
//! stretches; the others are made from a scale and a translation when they are asked for.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::Geometry;
use crate::numeric::{self, Bounds, SingularMatrix};
use crate::shape::{Shape, Sphere};

/// A geometry placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// What messages call it: the node's name or number.
    pub name: Arc<str>,
    /// Index into [`super::Scene::geometries`].
    pub geometry: u32,
    /// Index into [`super::Scene::materials`].
    pub material: u32,
    placement: Placement,
}

/// How object space lies in the world.
#[derive(Clone, Debug)]
enum Placement {
    /// It is the world.
    Unmoved,
    /// Scaled by a positive number whose reciprocal is finite, then moved.
    Similar(Similarity),
    /// Anything else that can be inverted.
    Affine(Box<Affine>),
}

/// A uniform scale and a translation: `p * scale + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Similarity {
    /// Positive and finite, as is its reciprocal.
    pub(crate) scale: f64,
    /// Where the origin goes.
    pub(crate) translation: DVec3,
}

#[derive(Clone, Debug)]
struct Affine {
    world_from_object: DAffine3,
    object_from_world: DAffine3,
}

impl Instance {
    /// Places `geometry` by `world_from_object`.
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

    /// Places it anew; where the map cannot be inverted, it stays where it is.
    pub fn place(&mut self, world_from_object: DAffine3) -> Result<(), SingularMatrix> {
        self.placement = Placement::new(&world_from_object)?;
        Ok(())
    }

    /// Makes object space world space.
    pub(crate) fn unplace(&mut self) {
        self.placement = Placement::Unmoved;
    }

    /// Object to world.
    #[inline]
    pub fn world_from_object(&self) -> DAffine3 {
        match &self.placement {
            Placement::Unmoved => DAffine3::IDENTITY,
            Placement::Similar(Similarity { scale, translation }) => DAffine3 {
                matrix3: DMat3::from_diagonal(DVec3::splat(*scale)),
                translation: *translation,
            },
            Placement::Affine(affine) => affine.world_from_object,
        }
    }

    /// World to object, the checked inverse.
    #[inline]
    pub fn object_from_world(&self) -> DAffine3 {
        match &self.placement {
            Placement::Unmoved => DAffine3::IDENTITY,
            Placement::Similar(Similarity { scale, translation }) => {
                let scale = scale.recip();
                DAffine3 {
                    matrix3: DMat3::from_diagonal(DVec3::splat(scale)),
                    translation: -(scale * *translation),
                }
            }
            Placement::Affine(affine) => affine.object_from_world,
        }
    }

    /// Whether object space is world space, as it is for every baked mesh.
    #[inline(always)]
    pub fn is_identity(&self) -> bool {
        matches!(self.placement, Placement::Unmoved)
    }

    /// Whether the placement turns left into right, so that windings seen from the front run clockwise.
    pub fn is_mirrored(&self) -> bool {
        match &self.placement {
            Placement::Affine(affine) => affine.world_from_object.matrix3.determinant() < 0.0,
            _ => false,
        }
    }

    /// A sphere in world space where the placement keeps it one without turning it; `None` elsewhere.
    #[inline(always)]
    pub(crate) fn world_sphere(&self, sphere: &Sphere) -> Option<Sphere> {
        match &self.placement {
            Placement::Unmoved => Some(*sphere),
            Placement::Similar(Similarity { scale, translation }) => Some(Sphere {
                center: *scale * sphere.center + *translation,
                radius: *scale * sphere.radius,
            }),
            Placement::Affine(_) => None,
        }
    }

    /// A box around the instance in world space; `object_bounds` are those of its `geometry`, and finite.
    pub(crate) fn world_bounds(&self, geometry: &Geometry, object_bounds: &Bounds) -> Bounds {
        let map = self.world_from_object();
        let Geometry::Shape(Shape::Sphere(sphere)) = geometry else {
            return object_bounds.transformed(&map);
        };
        // An ellipsoid reaches as far along an axis as the matrix's row is long, not to the corners of a turned box.
        let rows = map.matrix3.transpose();
        let reach = DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length());
        let center = map.transform_point3(sphere.center);
        Bounds {
            min: center - sphere.radius * reach,
            max: center + sphere.radius * reach,
        }
    }

    /// Bytes on the heap that belong to this instance, its name not counted.
    pub fn heap_byte_count(&self) -> usize {
        match self.placement {
            Placement::Affine(_) => size_of::<Affine>(),
            _ => 0,
        }
    }
}

impl Placement {
    fn new(map: &DAffine3) -> Result<Placement, SingularMatrix> {
        if *map == DAffine3::IDENTITY {
            return Ok(Placement::Unmoved);
        }
        let object_from_world = numeric::inverse(map)?;
        let scale = map.matrix3.x_axis.x;
        let is_similar = scale > 0.0
            && scale.recip().is_finite()
            && map.matrix3 == DMat3::from_diagonal(DVec3::splat(scale));
        Ok(if is_similar {
            Placement::Similar(Similarity {
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
    fn every_placement_gives_back_its_map_and_an_inverse() {
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
    fn a_map_without_an_inverse_is_refused_and_changes_nothing() {
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
    fn a_turned_and_stretched_sphere_has_the_box_of_its_ellipsoid() {
        let turn = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_4);
        let map = turn * DAffine3::from_scale(DVec3::new(3.0, 1.0, 1.0));
        let instance = Instance::new("", 0, 0, map).unwrap();
        let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
        let bounds = instance.world_bounds(&sphere, &sphere.bounds());
        // Rows (3, -1, 0) / √2 and (3, 1, 0) / √2: both √5 long.
        assert!(
            (bounds.max - DVec3::new(5f64.sqrt(), 5f64.sqrt(), 1.0))
                .abs()
                .max_element()
                < 1e-15
        );
    }

    #[test]
    fn an_unturned_instance_takes_at_most_64_bytes() {
        assert!(size_of::<Instance>() <= 64, "{}", size_of::<Instance>());
    }
}
