//! Thin lens model for depth of field.
//!
//! An ideal lens maps a point in the plane of focus to one point of the film, the one where the ray through the middle
//! of the lens, the pinhole's ray, ends. So a ray that leaves the lens off its middle goes to the point where the
//! pinhole's ray intersects the plane of focus (R. Cook, T. Porter, L. Carpenter, "Distributed ray tracing", SIGGRAPH
//! 1984).

use std::f64::consts::TAU;

use glam::DVec2;

use crate::numeric::lane_math::sin_cos;
use crate::numeric::warp;

/// A thin lens in front of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    pub(super) radius: f64,
    pub(super) focus_distance: f64,
    pub(super) aperture: Aperture,
}

/// Shape of the lens opening, which is also that of the blur.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Aperture {
    /// A circular opening with the lens's radius.
    #[default]
    Disk,
    /// A regular polygon inscribed in the disk.
    Polygon {
        /// Number of straight blades that bound the opening, at least 3.
        blades: u32,
        /// Angle of its first corner from the right, counter-clockwise as the camera looks, in radians.
        rotation: f64,
    },
}

/// Reasons why lens parameters are rejected, worded as advice.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LensError {
    /// The radius is negative or not finite.
    #[error("the radius of the lens is {0}: give the aperture's radius in metres, 0 for a pinhole")]
    Radius(f64),
    /// The distance of focus is not positive.
    #[error("the focus distance is {0}: give the distance of the plane in focus, in metres and more than 0")]
    FocusDistance(f64),
    /// An aperture has too few blades, or a rotation that is not finite.
    #[error(
        "an aperture of {blades} blades turned by {rotation} is not a polygon: give 3 or more blades and a finite angle"
    )]
    Polygon {
        /// Number of blades that was requested.
        blades: u32,
        /// Rotation of the aperture in radians.
        rotation: f64,
    },
}

impl Lens {
    /// Creates a lens whose opening has a circumscribed circle of `radius` metres and whose plane of focus lies
    /// `focus_distance` metres away along the view axis, possibly at infinity.
    pub fn new(radius: f64, focus_distance: f64, aperture: Aperture) -> Result<Lens, LensError> {
        if !(radius >= 0.0 && radius.is_finite()) {
            return Err(LensError::Radius(radius));
        }
        if !(focus_distance > 0.0) {
            return Err(LensError::FocusDistance(focus_distance));
        }
        match aperture {
            Aperture::Polygon { blades, rotation } if blades < 3 || !rotation.is_finite() => {
                Err(LensError::Polygon { blades, rotation })
            }
            _ => Ok(Lens {
                radius,
                focus_distance,
                aperture,
            }),
        }
    }

    /// Returns the radius of the opening in metres; for a polygon that of its circumscribed circle.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Returns the distance of the plane of focus along the view axis in metres; may be infinite.
    pub fn focus_distance(&self) -> f64 {
        self.focus_distance
    }

    /// Returns the lens for lengths that are multiplied by `factor`, a power of two.
    pub(super) fn scaled(&self, factor: f64) -> Lens {
        Lens {
            radius: self.radius * factor,
            focus_distance: self.focus_distance * factor,
            aperture: self.aperture,
        }
    }
}

impl Aperture {
    /// Returns the point of the opening of radius 1 that `u` in [0, 1)² selects, uniform in area. A rotation must be
    /// within ±2^20 radians.
    #[inline(always)]
    pub fn point(&self, u: [f64; 2]) -> DVec2 {
        match *self {
            Aperture::Disk => warp::disk(u),
            Aperture::Polygon { blades, rotation } => polygon_point(blades, rotation, u),
        }
    }
}

/// Returns a uniform point of a regular polygon: `u[0]` selects one of the triangles between the middle and two
/// neighbouring corners and a position along its edge, `u[1]` the distance from the middle.
fn polygon_point(blades: u32, rotation: f64, u: [f64; 2]) -> DVec2 {
    // u[0] selects the edge, and its fraction a position along the edge
    let scaled = u[0] * f64::from(blades);
    let blade = scaled.floor();
    let corner = |number: f64| {
        let [sin, cos] = sin_cos(rotation + TAU * number / f64::from(blades));
        DVec2::new(cos, sin)
    };
    // The distance from the middle grows with the square root of the area; along the edge the density is uniform.
    u[1].sqrt() * corner(blade).lerp(corner(blade + 1.0), scaled - blade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygon_aperture_points_are_uniform_within_the_blades() {
        for blades in [3, 6, 9] {
            let aperture = Aperture::Polygon {
                blades,
                rotation: 0.2,
            };
            // The distance of each edge from the middle
            let inner = (TAU / 2.0 / f64::from(blades)).cos();
            let mut second_moment = 0.0;
            let count = 300;
            for i in 0..count * count {
                let u = [i % count, i / count].map(|k| (f64::from(k) + 0.5) / f64::from(count));
                let p = aperture.point(u);
                second_moment += p.length_squared() / f64::from(count * count);
                // Every point must be on the inner side of every edge
                for blade in 0..blades {
                    let outward = DVec2::from_angle(0.2 + TAU * (f64::from(blade) + 0.5) / f64::from(blades));
                    assert!(p.dot(outward) <= inner + 1e-15);
                }
            }
            // For the triangle of the middle and two corners c: |p|² = r² |mix|², mean 1/2 (1 - (2/3) sin²(π/n)).
            let expected = 0.5 * (1.0 - 2.0 / 3.0 * (TAU / 2.0 / f64::from(blades)).sin().powi(2));
            assert!(
                (second_moment - expected).abs() < 1e-4,
                "{blades}: {second_moment}, not {expected}"
            );
        }
    }

    #[test]
    fn invalid_lenses_are_rejected_with_advice() {
        assert_eq!(Lens::new(-1.0, 1.0, Aperture::Disk), Err(LensError::Radius(-1.0)));
        assert!(Lens::new(f64::INFINITY, 1.0, Aperture::Disk).is_err());
        for focus in [0.0, -2.0, f64::NAN] {
            assert!(Lens::new(0.1, focus, Aperture::Disk).is_err());
        }
        let line = Aperture::Polygon {
            blades: 2,
            rotation: 0.0,
        };
        assert!(
            Lens::new(0.1, 1.0, line)
                .unwrap_err()
                .to_string()
                .contains("give 3 or more blades")
        );
    }
}
