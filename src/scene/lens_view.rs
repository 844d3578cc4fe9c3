//! Lens prepared for the rays of one camera.

use std::f64::consts::TAU;

use glam::DVec3;

use super::camera::{Camera, CameraRay, Projection};
use super::lens::{Aperture, Lens};

impl Camera {
    /// Returns the lens prepared for this camera's rays; `None` for a pinhole or a lens of radius 0.
    pub(crate) fn lens_view(&self) -> Option<LensView> {
        self.lens
            .filter(|lens| lens.radius() > 0.0)
            .map(|lens| lens.view(self))
    }
}

impl Lens {
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
            aperture: match self.aperture {
                Aperture::Disk => Aperture::Disk,
                Aperture::Polygon { blades, rotation } => Aperture::Polygon {
                    blades,
                    rotation: rotation % TAU,
                },
            },
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
}
