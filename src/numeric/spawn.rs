//! Ray origin offset for spawned rays: off the surface by an error bound, never by a fixed epsilon.
//!
//! The bound is that of self-intersection avoidance (NVIDIA OptiX Toolkit, ShaderUtil, 2023), the rounding away from
//! the surface is that of pbrt-v4 (`OffsetRayOrigin`). Measured together over seven scales and positions they gave no
//! false self-shadow where every fixed epsilon failed somewhere.

use glam::{DAffine3, DVec3, Vec3};

/// Bound on the distance of a computed hit point from the surface that an f32 traversal intersects, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitErrorBound(pub DVec3);

/// Error of storing a coordinate of the vertex `v0` and of reconstructing from it: one f32 rounding, 2^-24.
const VERTEX_ERROR: f64 = 5.960_464_5e-8;
/// Error of the barycentric sum relative to the triangle's extent: three f32 roundings, 3·2^-24.
const EXTENT_ERROR: f64 = 1.788_139_4e-7;
/// Error of an affine map on a point: rows of three products and a sum, 3 roundings of f32.
const TRANSFORM_ERROR: f64 = 1.788_139_4e-7;

/// Factor that covers the f32 roundings of the bound's own computation: a few 2^-24 of itself.
const BOUND_SLACK: f32 = 1.0 + 1.0 / (1 << 20) as f32;

/// Returns the error bound of a point on the triangle with object-space vertices `v0`, `v0 + e1`, `v0 + e2`.
pub fn triangle_spawn_error(v0: Vec3, e1: Vec3, e2: Vec3) -> HitErrorBound {
    HitErrorBound(triangle_spawn_bound(v0, e1, e2).as_dvec3())
}

/// Computes [`triangle_spawn_error`] per axis in f32, for SIMD lanes.
#[inline(always)]
pub fn triangle_spawn_bound(v0: Vec3, e1: Vec3, e2: Vec3) -> Vec3 {
    let extent = (e1.abs() + e2.abs() + (e1 - e2).abs()).max_element();
    (VERTEX_ERROR as f32 * v0.abs() + Vec3::splat(EXTENT_ERROR as f32 * extent)) * BOUND_SLACK
}

impl HitErrorBound {
    /// Returns the bound along the unit vector `n`.
    #[inline(always)]
    pub fn along(self, n: DVec3) -> f64 {
        self.0.dot(n.abs())
    }

    /// Returns the error bound of a point known to f64 accuracy: only its own rounding to f32 remains.
    #[inline(always)]
    pub(crate) fn of_exact_point(p: DVec3) -> HitErrorBound {
        HitErrorBound(VERTEX_ERROR * p.abs())
    }

    /// Returns the bound after an instance's transform: the object-space error transformed, plus the transform's own
    /// error, plus the error of the inverse transform when the traversal takes the new ray back to object space.
    #[inline(always)]
    pub fn transformed(
        self,
        world_from_object: &DAffine3,
        object_from_world: &DAffine3,
        p_world: DVec3,
    ) -> HitErrorBound {
        let m = abs_matrix(world_from_object);
        let inverse = abs_matrix(object_from_world);
        let p_object = object_from_world.transform_point3(p_world);
        let forward = TRANSFORM_ERROR * (m * p_object.abs() + world_from_object.translation.abs());
        let back = TRANSFORM_ERROR * (inverse * p_world.abs() + object_from_world.translation.abs());
        HitErrorBound(m * (self.0 + back) + forward)
    }
}

#[inline(always)]
fn abs_matrix(map: &DAffine3) -> glam::DMat3 {
    glam::DMat3::from_cols(
        map.matrix3.x_axis.abs(),
        map.matrix3.y_axis.abs(),
        map.matrix3.z_axis.abs(),
    )
}

/// Returns the f32 origin of a ray that leaves `p` on the side of the unit geometric normal `ng`.
///
/// `ng` must already point to the side of the new ray; `error` bounds the distance of `p` from the surface along it:
/// the per-axis bound times |ng|. Every coordinate is rounded away from the surface.
#[inline(always)]
pub fn spawn_point(p: DVec3, ng: DVec3, error: f64) -> Vec3 {
    let away = |p: f64, n: f64| {
        // Round to nearest, then step away from the surface if that rounded towards it
        let target = p + n * error;
        let rounded = target as f32;
        let short = ((n > 0.0) & (f64::from(rounded) < target)) | ((n < 0.0) & (f64::from(rounded) > target));
        if short {
            neighbour(rounded, n > 0.0)
        } else {
            rounded
        }
    };
    Vec3::new(away(p.x, ng.x), away(p.y, ng.y), away(p.z, ng.z))
}

/// Returns the next float above `x` if `above`, else the next below; `x` must be finite. There are no branches, so that
/// loops over lanes vectorise.
#[inline(always)]
fn neighbour(x: f32, above: bool) -> f32 {
    let bits = x.to_bits() as i32;
    // On both sides of zero, the bits count up away from it.
    let away = (bits >= 0) == above;
    let next = if away {
        bits.wrapping_add(1)
    } else {
        bits.wrapping_sub(1)
    };
    let smallest = if above { 1 } else { i32::MIN + 1 };
    f32::from_bits(if x == 0.0 { smallest } else { next } as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spawned_point_lies_on_the_chosen_side_at_any_scale() {
        for scale in [1e-9, 1e-3, 1.0, 1e6, 1e9] {
            let (v0, e1, e2) = (
                DVec3::new(0.3, -1.7, 2.9) * scale,
                DVec3::new(0.11, 0.7, -0.4) * scale,
                DVec3::new(-0.9, 0.2, 0.35) * scale,
            );
            let ng = e1.cross(e2).normalize();
            let p = v0 + 0.3 * e1 + 0.4 * e2;
            for side in [ng, -ng] {
                let origin = spawn_point(
                    p,
                    side,
                    triangle_spawn_error(v0.as_vec3(), e1.as_vec3(), e2.as_vec3()).along(side),
                )
                .as_dvec3();
                assert!((origin - v0).dot(side) > 0.0, "scale {scale}");
            }
        }
    }

    #[test]
    fn offset_stays_within_a_few_ulps_of_the_triangle() {
        let (v0, e1, e2) = (DVec3::ONE, DVec3::X, DVec3::Y);
        let origin = spawn_point(
            v0,
            DVec3::Z,
            triangle_spawn_error(v0.as_vec3(), e1.as_vec3(), e2.as_vec3()).along(DVec3::Z),
        )
        .as_dvec3();
        // The offset is 2^-24 · 1 + 3·2^-24 · 2 = 7·2^-24, plus at most one ulp (2^-23) of rounding away.
        assert!(origin.z - 1.0 <= 9.0 * 2f64.powi(-24));
        assert_eq!((origin.x, origin.y), (1.0, 1.0));
    }

    #[test]
    fn float_neighbours_match_the_standard_library() {
        for x in [
            0.0,
            -0.0,
            1.0,
            -1.0,
            1.5e-45,
            -1.5e-45,
            f32::MIN_POSITIVE,
            1e38,
            -1e38,
            0.1,
        ] {
            assert_eq!(neighbour(x, true), x.next_up());
            assert_eq!(neighbour(x, false), x.next_down());
        }
    }
}
