//! Affine maps in f64: checked inverses, normals by cofactors, and rays that preserve `t`.
//!
//! An instance transforms the ray instead of the object: with `o' = M⁻¹ o` and `d' = M⁻¹ d`, *not* renormalised, the
//! point `o' + t d'` is the preimage of `o + t d` for the same `t`, so hits in object space need no conversion.

use glam::{DAffine3, DMat3, DVec3, Vec3};

/// Ray segment as the acceleration structures see it: the f32 values are exact by definition, and every f64 computation
/// on it starts from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start of the parametrisation; the point at `t = 0`.
    pub origin: Vec3,
    /// Direction, of any finite non-zero length; `t` is measured in its length.
    pub direction: Vec3,
    /// Smallest parameter that counts as a hit.
    pub t_near: f32,
    /// Largest parameter that counts as a hit; may be infinite.
    pub t_far: f32,
    /// Time of the ray within the shutter interval, from 0 at its start to 1 at its end. Only moving objects use it.
    pub time: f32,
}

impl Ray {
    /// Largest magnitude of a coordinate or of a direction component that may be passed to a backend: the square root
    /// of the largest float, so that products of two stay finite. Embree's own limit is the same.
    pub const LIMIT: f32 = 1.844e18;

    /// Creates a ray over `t` in [0, ∞), at time 0.
    pub fn new(origin: Vec3, direction: Vec3) -> Ray {
        Ray {
            origin,
            direction,
            t_near: 0.0,
            t_far: f32::INFINITY,
            time: 0.0,
        }
    }

    /// Returns the point at `t` in f64.
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin.as_dvec3() + t * self.direction.as_dvec3()
    }

    /// Returns whether a backend may trace this ray: finite, in range, with a direction and an interval.
    pub fn is_traceable(&self) -> bool {
        // Comparisons with NaN are false, so a NaN anywhere rejects the ray.
        let in_range = |v: Vec3| v.abs().cmplt(Vec3::splat(Ray::LIMIT)).all();
        in_range(self.origin)
            && in_range(self.direction)
            && self.direction != Vec3::ZERO
            && self.t_near >= 0.0
            && self.t_far >= self.t_near
            && self.t_near < f32::INFINITY
    }
}

/// Error for a matrix that cannot be inverted to working accuracy.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the matrix is singular or not finite (condition number {condition:.1e})")]
pub struct SingularMatrix {
    /// Condition number of the linear part in the maximum norm; infinite or NaN where it has no inverse.
    pub condition: f64,
}

/// Largest condition number that is accepted: beyond it fewer than 4 of f64's 16 digits would survive the inverse.
const MAX_CONDITION: f64 = 1e12;

/// Largest difference of the product of a map and its inverse from the identity, for each unit of the condition number:
/// 3 roundings of a cofactor, 5 of the determinant, 2 of the quotient and 5 of the product, of 2^-53 each, in rows of
/// three.
const MAX_RESIDUAL: f64 = 32.0 * f64::EPSILON;

/// Inverts an affine map by cofactors.
///
/// The test uses the condition number, never the determinant, whose magnitude depends on the size of the object only.
pub fn inverse(target_from_source: &DAffine3) -> Result<DAffine3, SingularMatrix> {
    let m = target_from_source.matrix3;
    // Scaling by the largest entry keeps the determinant of tiny and huge maps in range.
    let largest = m.to_cols_array().iter().fold(0.0f64, |a, &x| a.max(x.abs()));
    if !(largest > 0.0 && largest.is_finite() && target_from_source.translation.is_finite()) {
        return Err(SingularMatrix {
            condition: f64::INFINITY,
        });
    }
    let scaled = m * largest.recip();
    // Invert the scaled linear part
    let cofactors = cofactor_matrix(scaled);
    let determinant = scaled.x_axis.dot(cofactors.x_axis);
    let linear = cofactors.transpose() * determinant.recip();
    let condition = row_sum_norm(scaled) * row_sum_norm(linear);
    // A NaN condition number fails the comparison, too.
    if !(condition < MAX_CONDITION) {
        return Err(SingularMatrix { condition });
    }
    // The cofactors of a rounded map onto a line are rounding errors only and may look valid: check the residual.
    let rest = row_sum_norm(scaled * linear - DMat3::IDENTITY);
    if !(rest <= MAX_RESIDUAL * condition) {
        return Err(SingularMatrix {
            condition: f64::INFINITY,
        });
    }
    // Undo the scaling
    let linear = linear * largest.recip();
    Ok(DAffine3 {
        matrix3: linear,
        translation: -(linear * target_from_source.translation),
    })
}

/// Transforms a ray to the object space of an instance in f64, and rounds it once to f32; `t` keeps its meaning.
///
/// All backends call this function, so they trace identical object-space rays.
#[inline(always)]
pub fn object_ray(object_from_world: &DAffine3, ray: &Ray) -> Ray {
    Ray {
        origin: object_from_world
            .transform_point3(ray.origin.as_dvec3())
            .as_vec3(),
        direction: object_from_world
            .transform_vector3(ray.direction.as_dvec3())
            .as_vec3(),
        ..*ray
    }
}

/// Transforms a normal by an affine map: the cofactor matrix times the sign of the determinant, normalised.
///
/// For a normal defined by an outside (a sphere's) this is correct under mirroring, too; a normal defined by winding (a
/// triangle's) must be flipped by the caller when the map mirrors.
#[inline(always)]
pub fn transform_normal(target_from_source: &DMat3, n: DVec3) -> DVec3 {
    let cofactors = cofactor_matrix(*target_from_source);
    let sign = target_from_source.x_axis.dot(cofactors.x_axis).signum();
    (cofactors * n * sign).normalize_or_zero()
}

/// Returns the matrix of cofactors, which is `det(M) M⁻ᵀ` and exists for every `M`.
#[inline(always)]
fn cofactor_matrix(m: DMat3) -> DMat3 {
    DMat3::from_cols(
        m.y_axis.cross(m.z_axis),
        m.z_axis.cross(m.x_axis),
        m.x_axis.cross(m.y_axis),
    )
}

/// Returns the norm induced by the maximum norm: the largest row sum of magnitudes.
fn row_sum_norm(m: DMat3) -> f64 {
    let rows = m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs();
    // `max_element` drops NaN; the test keeps it.
    if rows.is_nan() {
        f64::NAN
    } else {
        rows.max_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_a_strongly_non_uniform_map() {
        let map = DAffine3::from_rotation_x(0.3)
            * DAffine3::from_scale(DVec3::new(1e3, 1.0, -1e-3))
            * DAffine3::from_translation(DVec3::new(5.0, -7.0, 1e3));
        let back = inverse(&map).unwrap() * map;
        // The condition number is 1e6, so each entry has an error of a few times 1e6 · 2^-53, times the translation.
        assert!(back.abs_diff_eq(DAffine3::IDENTITY, 1e3 * 1e6 * 16.0 * f64::EPSILON));
    }

    #[test]
    fn tiny_uniform_scale_is_not_singular() {
        assert!(inverse(&DAffine3::from_scale(DVec3::splat(1e-60))).is_ok());
    }

    #[test]
    fn flat_zero_and_nan_maps_are_rejected() {
        for scale in [
            DVec3::new(1.0, 1.0, 0.0),
            DVec3::ZERO,
            DVec3::new(1.0, f64::NAN, 1.0),
            DVec3::new(1.0, 1e-13, 1.0),
        ] {
            assert!(inverse(&DAffine3::from_scale(scale)).is_err(), "{scale}");
        }
    }

    #[test]
    fn mirror_keeps_an_outward_normal_outward() {
        let mirror = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        assert_eq!(transform_normal(&mirror, DVec3::X), -DVec3::X);
        assert_eq!(transform_normal(&mirror, DVec3::Y), DVec3::Y);
    }

    #[test]
    fn unnormalised_object_ray_keeps_t() {
        let ray = Ray::new(Vec3::new(4.0, 0.0, 0.0), Vec3::new(-1.0, 0.0, 0.0));
        let inner = object_ray(&DAffine3::from_scale(DVec3::splat(0.5)), &ray);
        // The unit sphere is scaled by 2: the world hit is at t = 2; the object ray from 2 with direction -0.5 reaches
        // 1 there.
        assert_eq!(inner.at(2.0), DVec3::X);
    }

    #[test]
    fn invalid_rays_are_reported_as_untraceable() {
        let good = Ray::new(Vec3::ZERO, Vec3::X);
        assert!(good.is_traceable());
        for bad in [
            Ray {
                origin: Vec3::NAN,
                ..good
            },
            Ray {
                direction: Vec3::ZERO,
                ..good
            },
            Ray {
                direction: Vec3::splat(1e19),
                ..good
            },
            Ray { t_near: -1.0, ..good },
            Ray {
                t_near: f32::NAN,
                ..good
            },
            Ray {
                t_far: f32::NAN,
                ..good
            },
            Ray {
                t_near: 2.0,
                t_far: 1.0,
                ..good
            },
        ] {
            assert!(!bad.is_traceable(), "{bad:?}");
        }
    }
}
