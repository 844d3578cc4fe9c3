//! Checks of single values: sizes, unit vectors, radiance and coordinates.

use glam::DVec3;

use crate::numeric::Ray;

/// Largest difference of a direction's squared length from 1: directions come from f32 files, whose rounding is 2^-24,
/// through a few f64 steps.
pub(super) const UNIT_TOLERANCE: f64 = 1.0 / 1024.0 / 1024.0;

pub(super) fn is_size(x: f64) -> bool {
    x > 0.0 && x < f64::INFINITY
}

pub(super) fn is_unit(v: DVec3) -> bool {
    (v.length_squared() - 1.0).abs() <= UNIT_TOLERANCE
}

pub(super) fn is_radiance(rgb: &[f32; 3]) -> bool {
    rgb.iter().all(|x| (0.0..f32::INFINITY).contains(x))
}

/// Rejects anything whose largest coordinate, `magnitude`, is out of the range that the backends accept.
pub(super) fn check_coordinate_range(magnitude: f64) -> Result<(), String> {
    if magnitude < f64::from(Ray::LIMIT) {
        Ok(())
    } else {
        Err("exceeds the range of coordinates: normalise the scene or make it smaller".into())
    }
}
