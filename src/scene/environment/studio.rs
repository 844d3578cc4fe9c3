//! Studio: a room of graded grey, lit by soft boxes as product photographs are.
//!
//! Metal shows the boxes as bright shapes with soft edges between darker walls, and glass their edges. The key light
//! stands to the left of the camera, a tall fill light to its right, a weak one hangs above, and two narrow ones behind
//! the object draw its outline, outside of the image.

use glam::DVec3;

/// Radiance of the room at the level of the horizon.
const WALL: f64 = 0.24;
/// Radiance of the room straight up.
const CEILING: f64 = 0.34;
/// Radiance of the room straight down.
const FLOOR: f64 = 0.12;
/// Part of a soft box's half width and half height over which its edge fades.
const EDGE: f64 = 0.25;

/// Rectangular light far away, perpendicular to the direction to its centre.
struct SoftBox {
    /// Angle about +y of the centre in degrees, from +z toward +x.
    azimuth: f64,
    /// Angle of the centre above the horizon in degrees.
    elevation: f64,
    /// Half of the width divided by the distance.
    half_width: f64,
    /// Half of the height divided by the distance.
    half_height: f64,
    /// Radiance in the middle of the box.
    radiance: f64,
}

/// Soft boxes of the studio: key, fill, top and the two rim lights.
const SOFT_BOXES: [SoftBox; 5] = [
    SoftBox {
        azimuth: -45.0,
        elevation: 42.0,
        half_width: 0.45,
        half_height: 0.45,
        radiance: 3.2,
    },
    SoftBox {
        azimuth: 65.0,
        elevation: 18.0,
        half_width: 0.28,
        half_height: 0.7,
        radiance: 1.6,
    },
    SoftBox {
        azimuth: 0.0,
        elevation: 90.0,
        half_width: 0.6,
        half_height: 0.6,
        radiance: 0.4,
    },
    SoftBox {
        azimuth: -125.0,
        elevation: 20.0,
        half_width: 0.14,
        half_height: 0.8,
        radiance: 3.0,
    },
    SoftBox {
        azimuth: 125.0,
        elevation: 20.0,
        half_width: 0.14,
        half_height: 0.8,
        radiance: 3.0,
    },
];

/// Returns the grey radiance from `direction`, a unit vector.
pub(super) fn radiance(direction: DVec3) -> [f64; 3] {
    let boxes: f64 = SOFT_BOXES
        .iter()
        .map(|soft_box| soft_box.radiance_from(direction))
        .sum();
    [room(direction) + boxes; 3]
}

/// Returns the radiance of the room without the boxes.
fn room(direction: DVec3) -> f64 {
    let pole = if direction.y > 0.0 { CEILING } else { FLOOR };
    WALL + (pole - WALL) * smooth_step(direction.y.abs())
}

impl SoftBox {
    fn radiance_from(&self, direction: DVec3) -> f64 {
        let (sin_azimuth, cos_azimuth) = self.azimuth.to_radians().sin_cos();
        let (sin_elevation, cos_elevation) = self.elevation.to_radians().sin_cos();
        // Project the direction onto the plane of the box, at distance 1
        let forward = DVec3::new(
            cos_elevation * sin_azimuth,
            sin_elevation,
            cos_elevation * cos_azimuth,
        );
        let right = DVec3::new(cos_azimuth, 0.0, -sin_azimuth);
        let up = forward.cross(right);
        let depth = direction.dot(forward);
        if !(depth > 0.0) {
            return 0.0;
        }
        let across = direction.dot(right) / (depth * self.half_width);
        let above = direction.dot(up) / (depth * self.half_height);
        self.radiance * coverage(across) * coverage(above)
    }
}

/// Returns the coverage at a distance from the middle of a box, in units of half its extent: 1 inside, 0 outside.
fn coverage(distance: f64) -> f64 {
    smooth_step((1.0 - distance.abs()) / EDGE)
}

/// Returns the cubic step from 0 at 0 to 1 at 1, level at both ends.
fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn soft_box_is_bright_in_its_middle_and_dark_beyond_its_edge() {
        let front = SoftBox {
            azimuth: 0.0,
            elevation: 0.0,
            half_width: 0.5,
            half_height: 1.0,
            radiance: 2.0,
        };
        let from = |x: f64, y: f64, z: f64| front.radiance_from(DVec3::new(x, y, z).normalize());
        assert_eq!(from(0.0, 0.0, 1.0), 2.0);
        // The edge fades from 0.375 to 0.5 across; half-way the step is 1/2.
        assert_eq!(from(0.375, 0.0, 1.0), 2.0);
        assert!((from(0.4375, 0.0, 1.0) - 1.0).abs() < 1e-12);
        assert_eq!(from(0.5, 0.0, 1.0), 0.0);
        assert_eq!(from(0.0, 0.7, 1.0), 2.0);
        assert_eq!(from(0.0, 0.0, -1.0), 0.0);
    }

    #[test]
    fn no_box_is_behind_the_object_as_seen_from_the_front() {
        // 45 degrees high and wide around -z
        for (x, y) in [
            (-0.42, -0.42),
            (0.42, -0.42),
            (-0.42, 0.42),
            (0.42, 0.42),
            (0.0, 0.0),
        ] {
            let direction = DVec3::new(x, y, -1.0).normalize();
            assert_eq!(radiance(direction)[1], room(direction));
        }
    }
}
