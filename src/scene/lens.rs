//! Thin lens model for depth of field.
//!
//! An ideal lens maps a point in the plane of focus to one point of the film, the one where the ray through the middle
//! of the lens, the pinhole's ray, ends. So a ray that leaves the lens off its middle goes to the point where the
//! pinhole's ray intersects the plane of focus (R. Cook, T. Porter, L. Carpenter, "Distributed ray tracing", SIGGRAPH
//! 1984).

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::{Camera, CameraRay, Projection};
use crate::numeric::warp;

/// A thin lens in front of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    radius: f64,
    focus_distance: f64,
    aperture: Aperture,
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

    /// Prepares the lens for the rays of `camera`.
    pub fn view(&self, camera: &Camera) -> LensView {
        let axes = camera.world_from_camera.matrix3;
        // The parameter of a ray is its depth in units of the window distance.
        let window_distance = match camera.projection {
            Projection::Window { distance, .. } => distance,
            Projection::Perspective { .. } | Projection::Orthographic { .. } => 1.0,
        };
        LensView {
            right: axes.x_axis * self.radius,
            up: axes.y_axis * self.radius,
            per_t_focus: window_distance / self.focus_distance,
            is_pinhole: self.radius == 0.0,
            aperture: self.aperture,
        }
    }
}

/// A lens prepared for the rays of one camera.
#[derive(Clone, Copy, Debug)]
pub struct LensView {
    /// World-space vectors from the middle of the lens to its right and upper rim, as long as the radius.
    right: DVec3,
    up: DVec3,
    /// Reciprocal of the ray parameter at the plane of focus; 0 for focus at infinity.
    per_t_focus: f64,
    is_pinhole: bool,
    aperture: Aperture,
}

impl LensView {
    /// Returns the ray from the lens point that `u` in [0, 1)² selects to the point where `pinhole` is in focus.
    ///
    /// A lens without radius returns `pinhole` itself, bit for bit. As the lens is perpendicular to the view axis, `t`
    /// still measures depth, and the near and far planes stay where they are. With o the origin and d the direction,
    /// and units u of 2^-53, the ray passes the point in focus within 4 u (|o| + radius) + 3 u t |d| per coordinate.
    #[inline(always)]
    pub fn ray(&self, pinhole: CameraRay, u: [f64; 2]) -> CameraRay {
        if self.is_pinhole {
            return pinhole;
        }
        let lens_point = self.aperture.point(u);
        let offset = lens_point.x * self.right + lens_point.y * self.up;
        CameraRay {
            origin: pinhole.origin + offset,
            // o + aside + t (d - aside / t_focus) equals the pinhole's point at t = t_focus
            direction: pinhole.direction - offset * self.per_t_focus,
            ..pinhole
        }
    }
}

impl Aperture {
    /// Returns the point of the opening of radius 1 that `u` in [0, 1)² selects, uniform in area.
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
    let corner = |number: f64| DVec2::from_angle(rotation + TAU * number / f64::from(blades));
    // The distance from the middle grows with the square root of the area; along the edge the density is uniform.
    u[1].sqrt() * corner(blade).lerp(corner(blade + 1.0), scaled - blade)
}

#[cfg(test)]
mod tests {
    use glam::DAffine3;

    use super::*;

    fn camera(projection: Projection) -> Camera {
        Camera {
            world_from_camera: DAffine3::from_translation(DVec3::new(10.0, -20.0, 5.0))
                * DAffine3::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), 0.9),
            projection,
            z_near: 0.25,
            z_far: 100.0,
            ..Camera::default()
        }
    }

    fn projections() -> [Projection; 3] {
        [
            Projection::Perspective {
                y_fov: 0.8,
                aspect: None,
            },
            Projection::Window {
                half_width: 2.0,
                half_height: 1.5,
                distance: 3.0,
            },
            Projection::Orthographic {
                y_mag: 4.0,
                x_mag: None,
            },
        ]
    }

    const OPENINGS: [Aperture; 2] = [
        Aperture::Disk,
        Aperture::Polygon {
            blades: 6,
            rotation: 0.2,
        },
    ];

    /// Returns the middles of eight by eight cells, and the corner at zero.
    fn places() -> impl Iterator<Item = [f64; 2]> {
        (0..64).map(|i| [f64::from(i % 8) / 8.0, f64::from(i / 8) / 8.0])
    }

    #[test]
    fn rays_of_a_film_point_converge_in_the_focus_plane() {
        const U: f64 = 0.5 * f64::EPSILON;
        for (projection, aperture) in projections().into_iter().flat_map(|p| OPENINGS.map(|a| (p, a))) {
            let camera = camera(projection);
            let (view, lens) = (
                camera.view(300, 200),
                Lens::new(0.3, 7.0, aperture).unwrap().view(&camera),
            );
            // Find the point in focus on the pinhole's ray
            let t = lens.per_t_focus.recip();
            for (x, y) in [(0.5, 0.5), (0.0, 1.0), (0.9, 0.13)] {
                let pinhole = view.ray(x, y);
                let focus = pinhole.origin + t * pinhole.direction;
                let depth = (focus - camera.world_from_camera.translation)
                    .dot(-camera.world_from_camera.matrix3.z_axis);
                assert!((depth - 7.0).abs() < 1e-13);
                // All rays through the lens must pass it
                for u in places() {
                    let ray = lens.ray(pinhole, u);
                    let found = ray.origin + t * ray.direction;
                    let bound =
                        U * (4.0 * (ray.origin.abs() + 0.3) + 3.0 * t * (ray.direction.abs() + 0.3 / t));
                    // Twice the bound, as the point in focus is itself computed with such an error.
                    assert!(
                        (found - focus).abs().cmple(2.0 * bound).all(),
                        "{projection:?} {u:?}"
                    );
                    assert_eq!((ray.t_near, ray.t_far), (pinhole.t_near, pinhole.t_far));
                }
            }
        }
    }

    #[test]
    fn lens_ray_parameters_match_pinhole_depth() {
        let camera = camera(projections()[1]);
        let axis = -camera.world_from_camera.matrix3.z_axis;
        let lens = Lens::new(0.3, 7.0, Aperture::Disk).unwrap().view(&camera);
        for u in places() {
            let ray = lens.ray(camera.view(30, 20).ray(0.2, 0.7), u);
            let depth = (ray.origin + 2.0 * ray.direction - camera.world_from_camera.translation).dot(axis);
            assert!((depth - 6.0).abs() < 1e-13);
        }
    }

    #[test]
    fn zero_radius_gives_the_exact_pinhole_ray() {
        for projection in projections() {
            let camera = camera(projection);
            let lens = Lens::new(0.0, 7.0, Aperture::Disk).unwrap().view(&camera);
            for u in places() {
                let pinhole = camera.view(300, 200).ray(u[1], u[0]);
                assert_eq!(lens.ray(pinhole, u), pinhole);
            }
        }
    }

    #[test]
    fn rays_of_a_film_point_are_parallel_when_focused_at_infinity() {
        let camera = camera(projections()[0]);
        let lens = Lens::new(0.1, f64::INFINITY, Aperture::Disk)
            .unwrap()
            .view(&camera);
        let pinhole = camera.view(30, 20).ray(0.1, 0.2);
        for u in places() {
            let ray = lens.ray(pinhole, u);
            assert_eq!(ray.direction, pinhole.direction);
            assert!((ray.origin - pinhole.origin).length() <= 0.1 + 32.0 * f64::EPSILON);
        }
    }

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
