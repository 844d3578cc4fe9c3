//! Bounds on the error of reported hits relative to the exact object, by which bounding volumes must be wider.
//!
//! With u = 2^-24, M the instance transform, B the largest coordinate of the object in its own space and T' the
//! translation of M⁻¹, three things move a hit, per axis of object space:
//!
//! * the object-space ray is rounded to f32: `u |o'| + u |p' - o'|`;
//! * the triangle test projects vertices: `4u |p' - o'| + 4u e`, e <= 2B the extent (see `bsp::error_bounds`);
//! * shapes are tested in f64, whose roundings are 2^29 times smaller.
//!
//! As `|p'| <= B` and `|o'| <= |M⁻¹| |o| + |T'|`, that is at most `u (6 |M⁻¹| |o| + 6 |T'| + 13 B)`, in the world
//! `u (6 |M| |M⁻¹| |o| + |M| (6 |T'| + 13 B))`. All is doubled, for the effect of one rounding on another.
//!
//! Besides, a triangle that is seen edge-on may be hit anywhere along it: its parameter is a mean of those of its
//! vertices, with weights that rounding decides.

use glam::{DAffine3, DMat3, DVec3};

use crate::numeric::Bounds;
use crate::scene::{Geometry, Instance};

/// Unit roundoff of f32: half a unit in the last place of 1.
pub(super) const UNIT: f64 = 1.0 / (1u64 << 24) as f64;
/// Squared length below which digits are lost at the end of the range of f32, or will be: its smallest normal number
/// over the unit of rounding, 2^-126 / 2^-24.
pub(super) const MIN_SQUARE: f32 = 1.972_152_3e-31;
/// Largest mixing of axes by an instance transform. Beyond it rounding moves hits by more than 64 times as much, the
/// inverse in f64 would need a bound, too, and objects get no bounding volume.
const MAX_MIXING: f64 = 64.0;
/// Largest coordinate of objects with a bounding volume: beyond it squares of differences would overflow f32.
const MAX_MAGNITUDE: f64 = 1e18;

/// Bounds on the rounding errors of hits on one object; lengths are in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HitError {
    /// Displacement per axis relative to the largest coordinate of the ray's origin.
    pub(super) origin_factor: f64,
    /// Displacement per axis that the object itself causes.
    pub(super) own: f64,
    /// Distance along the ray by which a hit may be reported too near or too far; 0 for shapes.
    pub(super) depth: f64,
}

impl HitError {
    /// Bounds of zero, for exact rays and objects.
    pub(super) const NONE: HitError = HitError {
        origin_factor: 0.0,
        own: 0.0,
        depth: 0.0,
    };

    /// Computes the bounds of an instance; `None` if no bounding volume is safe: for unbounded or moving objects and
    /// for extreme transforms.
    pub(super) fn of(instance: &Instance, geometry: &Geometry, object_bounds: &Bounds) -> Option<HitError> {
        if geometry.is_unbounded() || object_bounds.is_empty() || instance.is_moving() {
            return None;
        }
        let map = instance.world_from_object();
        let inverse = instance.object_from_world();
        let size = object_bounds.magnitude();
        // Bound the displacement by the magnitudes of both transforms
        let linear = magnitudes(&map);
        let back = magnitudes(&inverse);
        let mixing = (linear * (back * DVec3::ONE)).max_element();
        // Bound the part that does not depend on the ray
        let own = linear * (6.0 * inverse.translation.abs() + DVec3::splat(13.0 * size));
        let depth = match geometry {
            // Vertices of a triangle differ along the longest axis of the direction by the extent at most, and that
            // axis has at least 1 / √3 of its length.
            Geometry::Mesh(_) => {
                3f64.sqrt() * object_bounds.extent().max_element() * spectral_bound(&map.matrix3)
            }
            Geometry::Shape(_) | Geometry::Points(_) => 0.0,
        };
        let reach = own.max_element() + depth + object_bounds.transformed(&map).magnitude();
        // NaN fails the comparison, too.
        (mixing <= MAX_MIXING && reach < MAX_MAGNITUDE).then(|| HitError {
            // The additional 1 covers the rounding of the moved origin itself.
            origin_factor: 2.0 * UNIT * (6.0 * mixing + 1.0),
            // Behind the origin, slab parameters are off by 16u of `depth`.
            own: 2.0 * UNIT * (own.max_element() + 16.0 * depth),
            depth,
        })
    }
}

/// Returns the magnitudes of the linear part.
fn magnitudes(map: &DAffine3) -> DMat3 {
    let m = map.matrix3;
    DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs())
}

/// Returns a bound on the largest factor by which a matrix lengthens a vector, exact for rotations with a scale, else
/// at most 2 % too large.
///
/// The largest eigenvalue of a positive matrix is at most any norm, and at most the 32nd root of the trace of its 32nd
/// power, which exceeds it by 3^(1/32) at most.
pub(super) fn spectral_bound(m: &DMat3) -> f64 {
    // Scale by the largest entry, so that the squares of tiny and huge ones stay within range.
    let largest = m.to_cols_array().iter().fold(0.0f64, |a, &x| a.max(x.abs()));
    if !(largest > 0.0) {
        return 0.0;
    }
    let scaled = *m * largest.recip();
    let gram = scaled.transpose() * scaled;
    let rows = gram.x_axis.abs() + gram.y_axis.abs() + gram.z_axis.abs();
    let by_norm = rows.max_element();
    let mut power = gram * by_norm.recip();
    for _ in 0..5 {
        power = power * power;
    }
    let trace = power.x_axis.x + power.y_axis.y + power.z_axis.z;
    let by_trace = by_norm * trace.powf(1.0 / 32.0);
    // The factor covers some hundred roundings of 2^-53.
    largest * by_norm.min(by_trace).sqrt() * (1.0 + 2f64.powi(-44))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Shape, Sphere};

    #[test]
    fn spectral_bound_is_exact_for_rotations_and_close_for_scalings() {
        let turn = DMat3::from_rotation_x(0.7) * DMat3::from_rotation_z(1.9);
        assert!((spectral_bound(&(3.0 * turn)) - 3.0).abs() < 1e-12);
        let stretched = turn * DMat3::from_diagonal(DVec3::new(0.1, -5.0, 4.9)) * turn;
        let bound = spectral_bound(&stretched);
        assert!((5.0..5.0 * 1.02).contains(&bound), "{bound}");
        assert_eq!(spectral_bound(&DMat3::ZERO), 0.0);
        let tiny = spectral_bound(&(1e-250 * turn));
        assert!((tiny * 1e250 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn extreme_transforms_and_planes_have_no_bounding_volume() {
        let sphere = Geometry::Shape(Shape::Sphere(Sphere::UNIT));
        let turn = DAffine3::from_rotation_x(0.5);
        let placed = |map| Instance::new("", 0, 0, map).unwrap();
        let guard = |map, geometry: &Geometry| HitError::of(&placed(map), geometry, &geometry.bounds());
        let flat = DAffine3::from_scale(DVec3::new(1.0, 1.0, 1e-3));
        assert!(guard(flat, &sphere).is_some());
        assert!(guard(turn * flat, &sphere).is_some());
        assert!(guard(flat * turn, &sphere).is_none());
        assert!(guard(DAffine3::from_scale(DVec3::splat(1e19)), &sphere).is_none());
        assert!(guard(turn, &Geometry::Shape(Shape::Plane)).is_none());
    }
}
