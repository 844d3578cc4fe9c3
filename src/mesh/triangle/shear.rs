//! Ray set-up of the watertight test.

use crate::numeric::Ray;

/// Ray set-up of the watertight test, computed once per ray: the axes with the dominant one last, and origin and shear
/// in that order.
#[derive(Clone, Copy, Debug)]
pub struct Shear {
    pub(super) axes: [usize; 3],
    pub(super) origin: [f32; 3],
    pub(super) shear: [f32; 3],
}

/// Returns the axis along which a direction is longest; the later one of equals.
#[inline(always)]
pub(crate) fn dominant_axis(direction: [f32; 3]) -> usize {
    let [x, y, z] = direction;
    let (x, y, z) = (x.abs(), y.abs(), z.abs());
    if x > y && x > z {
        0
    } else if y > z {
        1
    } else {
        2
    }
}

/// Returns the axes in the cyclic order that puts `dominant` last.
#[inline(always)]
pub(super) fn axes_around(dominant: usize) -> [usize; 3] {
    [[1, 2, 0], [2, 0, 1], [0, 1, 2]][dominant]
}

impl Shear {
    /// Computes the shear of a ray with a finite, non-zero direction.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Shear {
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        let axes = axes_around(dominant_axis(direction));
        let [kx, ky, kz] = axes;
        let z = direction[kz];
        Shear {
            axes,
            origin: [origin[kx], origin[ky], origin[kz]],
            shear: [direction[kx] / z, direction[ky] / z, 1.0 / z],
        }
    }
}
