//! Selection of the instanced meshes that Embree may transform itself, by the loss of accuracy.
//!
//! Embree rounds the matrix to f32, inverts it in f32 and transforms every ray by that inverse in f32. Relative to the
//! ray's and the mesh's distances from the world origin the ray is then off by some 2^-24 times the condition number of
//! the matrix, where the callback is off by 2^-24 of object space (the bound is in `accel::hit_compare`). A ray is
//! transformed once for all triangles of a mesh, so edges within it stay closed; only its position is rounded.
//!
//! Moving instances stay with the callback, and so do matrices that would lose more accuracy than the condition numbers
//! allowed here and those by which a ray could leave the range of coordinates in which Embree 3.13, as Debian builds
//! it, does not end the process.

use glam::{DAffine3, DMat3};

use crate::accel::Instancing;
use crate::scene::Instance;

/// Largest row sum of a matrix or of its inverse. With [`RAY_LIMIT`] it keeps rays in object space under 2^60 plus
/// 2^24, while [`crate::numeric::Ray::LIMIT`] is over 2^60.6.
const NORM_LIMIT: f64 = (1 << 24) as f64;
/// Least coordinate of rays that are not traced where Embree has instances; a normalised scene is of size 1.
pub(super) const RAY_LIMIT: f32 = (1u64 << 36) as f32;
/// Bytes that Embree 3.13.5 takes for an instance beside its trees, by the growth of the process; its memory monitor
/// does not report them.
pub(super) const RECORD_BYTES: u64 = 240;
/// Largest condition number, and largest product of the columns' lengths over the determinant: of the 24 bits of an f32
/// they leave 18, less the loss by rounding itself.
const CONDITION_LIMIT: f64 = (1 << 6) as f64;

/// Returns whether an instanced mesh becomes an instance of Embree's own.
pub(super) fn supports(instance: &Instance, instancing: Instancing) -> bool {
    if instancing != Instancing::Native || instance.is_moving() {
        return false;
    }
    let (map, inverse) = (instance.world_from_object(), instance.object_from_world());
    // Bound the range of transformed rays and the loss of accuracy
    let norms = [norm(&map.matrix3), norm(&inverse.matrix3)];
    let moves = [&map, &inverse].map(|map| map.translation.abs().max_element());
    let m = &map.matrix3;
    let lengths = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    norms.iter().chain(&moves).all(|&size| size <= NORM_LIMIT)
        && norms[0] * norms[1] <= CONDITION_LIMIT
        && lengths <= CONDITION_LIMIT * m.determinant().abs()
}

/// Returns the largest row sum of magnitudes.
fn norm(m: &DMat3) -> f64 {
    (m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs()).max_element()
}

/// Returns a matrix in Embree's format: three columns and the translation, each rounded to f32.
pub(super) fn columns(map: &DAffine3) -> [f32; 12] {
    map.to_cols_array().map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn only_transforms_invertible_in_f32_use_native_instances() {
        let supports = |map| {
            let instance = Instance::new("", 0, 0, map).unwrap();
            supports(&instance, Instancing::Native)
        };
        let scale = |x, y, z| DAffine3::from_scale(DVec3::new(x, y, z));
        assert!(supports(scale(-1.0, 1.0, 1.0)));
        assert!(supports(scale(60.0, 1.0, 1.0)));
        assert!(supports(scale(1e-6, 1e-6, 1e-6)));
        assert!(!supports(scale(70.0, 1.0, 1.0)), "condition");
        assert!(!supports(scale(1e-8, 1e-8, 1e-8)), "the inverse's norm");
        assert!(!supports(DAffine3::from_translation(DVec3::new(0.0, 1e8, 0.0))));
    }

    #[test]
    fn native_instances_are_used_only_on_request() {
        let instance = Instance::new("", 0, 0, DAffine3::from_translation(DVec3::X)).unwrap();
        assert!(supports(&instance, Instancing::Native));
        assert!(!supports(&instance, Instancing::Callback));
    }

    #[test]
    fn columns_come_before_the_translation() {
        let map = DAffine3::from_cols_array(&std::array::from_fn(|i| i as f64));
        assert_eq!(columns(&map), std::array::from_fn(|i| i as f32));
    }
}
