//! Ends of shadow rays to emissive surfaces, off the surfaces by a bound on rounding errors.

use glam::{DAffine3, DMat3, DVec3};

use crate::numeric::HitErrorBound;
use crate::scene::Instance;

/// Relative bound on the rounding errors of a traversal in f32: on how far they move the end of a shadow ray and the
/// surface that it ends at, relative to the length of the ray along each axis of object space.
///
/// It counts 2^-24 for each of: the direction; the vertices minus the origin; three products and two sums each of the
/// distance from a plane and of the approach to it; their quotient; and three each for the instance transform of
/// origin and direction.
const SHADOW_RAY_ERROR: f64 = 19.0 / (1 << 24) as f64;

/// Transforms of an emissive object, for the ends of shadow rays to it.
pub(super) struct ShadowRayEnds {
    world_from_object: DAffine3,
    object_from_world: DAffine3,
    /// Absolute values of the linear part of `object_from_world`.
    extents: DMat3,
}

impl ShadowRayEnds {
    /// Returns the transforms of `instance`.
    pub(super) fn of(instance: &Instance) -> ShadowRayEnds {
        let inverse = instance.object_from_world();
        let axes = [
            inverse.matrix3.x_axis,
            inverse.matrix3.y_axis,
            inverse.matrix3.z_axis,
        ];
        let [x, y, z] = axes.map(DVec3::abs);
        ShadowRayEnds {
            world_from_object: instance.world_from_object(),
            object_from_world: inverse,
            extents: DMat3::from_cols(x, y, z),
        }
    }

    /// Returns the end of a shadow ray of the vector `way` to `position` on the object: offset along the unit normal `n`,
    /// which is on the side that the ray comes from. `on_surface` bounds the error of rays that leave the surface there,
    /// in object space.
    #[inline(always)]
    pub(super) fn end(&self, position: DVec3, n: DVec3, way: DVec3, on_surface: DVec3) -> DVec3 {
        // Add the error of the traversal over the length of the ray
        let in_object = SHADOW_RAY_ERROR * (self.extents * way.abs());
        let bound = HitErrorBound(on_surface + in_object);
        let error = bound.transformed(&self.world_from_object, &self.object_from_world, position);
        position + error.along(n) * n
    }
}
