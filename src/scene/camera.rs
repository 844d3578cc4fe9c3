//! Cameras and their film-to-ray mappings, shutters, and near and far planes.

use std::f64::consts::FRAC_PI_4;

use glam::{DAffine3, DMat3, DVec2, DVec3};

use super::lens::Lens;
use crate::numeric::AnimatedTransform;

/// A camera in world space. Camera space looks along -z with +y up, as in glTF.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name by which `--camera` selects it.
    pub name: String,
    /// Camera-to-world map at the start of the motion: orthonormal, without scale.
    pub world_from_camera: DAffine3,
    /// Mapping from film points to rays.
    pub projection: Projection,
    /// Distance of the near plane along the view axis, zero or more; nothing nearer is visible.
    pub z_near: f64,
    /// Distance of the far plane along the view axis; may be infinite.
    pub z_far: f64,
    /// Thin lens that causes depth of field; `None` for a pinhole.
    pub lens: Option<Lens>,
    /// Camera-to-world map at the end of the motion, orthonormal and without scale; `None` for a camera at rest.
    pub world_from_camera_end: Option<DAffine3>,
    /// Time interval in which the film is exposed.
    pub shutter: Shutter,
}

/// A pinhole camera at the origin, at rest, that looks along -z with a vertical field of view of 45 degrees.
impl Default for Camera {
    fn default() -> Camera {
        Camera {
            name: String::new(),
            world_from_camera: DAffine3::IDENTITY,
            projection: Projection::Perspective {
                y_fov: FRAC_PI_4,
                aspect: None,
            },
            z_near: 0.0,
            z_far: f64::INFINITY,
            lens: None,
            world_from_camera_end: None,
            shutter: Shutter::default(),
        }
    }
}

/// Opening and closing times of a shutter as fractions of all motions, the camera's own and those of instances: 0 is
/// their start and 1 their end. By default it is open all the time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shutter {
    /// Time at which the shutter opens, 0 or more.
    pub open: f64,
    /// Time at which the shutter closes, 1 or less, and not before `open`.
    pub close: f64,
}

impl Default for Shutter {
    fn default() -> Shutter {
        Shutter {
            open: 0.0,
            close: 1.0,
        }
    }
}

impl Shutter {
    /// Returns the time of a sample whose time coordinate, in [0, 1), is `u`.
    pub fn time(&self, u: f64) -> f32 {
        (self.open + (self.close - self.open) * u) as f32
    }
}

/// Mapping of film points to rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// A pinhole with a field of view: all rays start at one point.
    Perspective {
        /// Full vertical field of view in radians, within (0, π).
        y_fov: f64,
        /// Width over height; `None` takes the image's aspect.
        aspect: Option<f64>,
    },
    /// A pinhole with an explicit window, whatever the shape of its pixels: all rays start at one point and follow the
    /// textbook formula `P(x, y) = E + w(2x/c - 1) i + h(2y/r - 1) j - n k`, with t = 1 on the near plane.
    Window {
        /// Half the width of the window, w.
        half_width: f64,
        /// Half the height of the window, h.
        half_height: f64,
        /// Distance of the window from the camera, n; positive.
        distance: f64,
    },
    /// Parallel rays that start on a window.
    Orthographic {
        /// Half the height of the window.
        y_mag: f64,
        /// Half the width of the window; `None` takes the image's aspect.
        x_mag: Option<f64>,
    },
}

/// A camera ray in f64, before it is rounded to the f32 ray that is traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraRay {
    /// Origin in world space.
    pub origin: DVec3,
    /// Direction in world space, not normalised: `t` measures the depth along the view axis in units of the window
    /// distance, so the direction of a perspective ray is longer than that distance.
    pub direction: DVec3,
    /// Ray parameter of the near plane.
    pub t_near: f64,
    /// Ray parameter of the far plane.
    pub t_far: f64,
}

/// A camera prepared for one image size: an affine mapping from film points to rays.
#[derive(Clone, Copy, Debug)]
pub struct CameraView {
    /// Ray origin; constant for a perspective.
    origin: FilmMap,
    direction: FilmMap,
    t_near: f64,
    t_far: f64,
}

/// A vector in world space that is an affine function of the film point.
#[derive(Clone, Copy, Debug)]
struct FilmMap {
    /// Value at the top left corner of the image.
    corner: DVec3,
    /// Increment over the width of the image.
    across: DVec3,
    /// Increment over the height of the image.
    down: DVec3,
}

impl FilmMap {
    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> DVec3 {
        self.corner + x * self.across + y * self.down
    }
}

impl Camera {
    /// Prepares the camera for images of `width` by `height` pixels.
    ///
    /// Pixels are square: the vertical extent is as stated and the horizontal one follows the image, even where the
    /// camera states an aspect (glTF 2.0, 3.10.3, requires cropping or extending, not stretching).
    pub fn view(&self, width: u32, height: u32) -> CameraView {
        // Find the half extents of the window and its distance
        let aspect = f64::from(width) / f64::from(height);
        let square = |half_height: f64| DVec2::new(half_height * aspect, half_height);
        let (window, distance) = match self.projection {
            Projection::Perspective { y_fov, .. } => (square((0.5 * y_fov).tan()), 1.0),
            Projection::Window {
                half_width,
                half_height,
                distance,
            } => (DVec2::new(half_width, half_height), distance),
            Projection::Orthographic { y_mag, .. } => (square(y_mag), 1.0),
        };
        // Map film points to the window in world space, relative to its centre; the image's y axis points down
        let axes = self.world_from_camera.matrix3;
        let eye = self.world_from_camera.translation;
        let on_window = FilmMap {
            corner: axes.y_axis * window.y - axes.x_axis * window.x,
            across: axes.x_axis * (2.0 * window.x),
            down: axes.y_axis * (-2.0 * window.y),
        };
        // Perspective rays share their origin, orthographic rays their direction
        let constant = |corner| FilmMap {
            corner,
            across: DVec3::ZERO,
            down: DVec3::ZERO,
        };
        let moved = |map: FilmMap, by| FilmMap {
            corner: by + map.corner,
            ..map
        };
        let (origin, direction) = match self.projection {
            Projection::Perspective { .. } | Projection::Window { .. } => {
                (constant(eye), moved(on_window, -axes.z_axis * distance))
            }
            Projection::Orthographic { .. } => (moved(on_window, eye), constant(-axes.z_axis)),
        };
        CameraView {
            origin,
            direction,
            t_near: self.z_near / distance,
            t_far: self.z_far / distance,
        }
    }
}

impl Camera {
    /// Returns the camera's motion; `None` for a camera at rest.
    pub fn motion(&self) -> Option<AnimatedTransform> {
        let motion = AnimatedTransform::new(self.world_from_camera, self.world_from_camera_end?);
        motion.ok().filter(|motion| !motion.is_still())
    }

    /// Returns the radius of the lens in metres; 0 for a pinhole.
    pub fn lens_radius(&self) -> f64 {
        self.lens.map_or(0.0, |lens| lens.radius())
    }
}

/// Smallest sine of the angle between the view direction and the up direction: 2^-26 leaves half of f64's digits to the
/// axes.
const MIN_SINE: f64 = 1.0 / (1 << 26) as f64;

/// Returns the axes of a camera that looks along `forward` with `up` upwards in the image, both of any length; `None`
/// if one has no length or they are parallel.
pub(crate) fn axes_looking_along(forward: DVec3, up: DVec3) -> Option<DMat3> {
    let forward = forward.try_normalize()?;
    // The length of this product is the sine of the angle between the two
    let right = forward.cross(up.try_normalize()?);
    if !(right.length() > MIN_SINE) {
        return None;
    }
    let right = right.normalize();
    Some(DMat3::from_cols(right, right.cross(forward), -forward))
}

impl CameraView {
    /// Returns the ray through the film point (`x`, `y`), each in [0, 1], from the top left corner of the image.
    ///
    /// The middle of pixel (i, j) is ((i + ½) / width, (j + ½) / height).
    #[inline(always)]
    pub fn ray(&self, x: f64, y: f64) -> CameraRay {
        CameraRay {
            origin: self.origin.at(x, y),
            direction: self.direction.at(x, y),
            t_near: self.t_near,
            t_far: self.t_far,
        }
    }

    /// Returns the change of the ray direction over a film offset of (`x`, `y`).
    pub(crate) fn direction_offset(&self, x: f64, y: f64) -> DVec3 {
        x * self.direction.across + y * self.direction.down
    }

    /// Returns the film point whose ray goes through `p`, the inverse of [`CameraView::ray`]: outside [0, 1] where `p`
    /// is outside the image, `None` where `p` is behind the camera.
    pub(crate) fn film_point(&self, p: DVec3) -> Option<DVec2> {
        // Set up a 3x3 system for the film point
        let (columns, rest) = match self.eye() {
            // The offset to p is a positive multiple of a direction: corner + x across + y down = s (p - eye).
            Some(eye) => (
                [self.direction.across, self.direction.down, eye - p],
                -self.direction.corner,
            ),
            None => (
                [self.origin.across, self.origin.down, self.direction.corner],
                p - self.origin.corner,
            ),
        };
        // A negative third unknown means that p is behind the camera
        let solved = DMat3::from_cols_array_2d(&columns.map(|column| column.to_array())).inverse() * rest;
        (solved.is_finite() && solved.z > 0.0).then(|| solved.truncate())
    }

    /// Returns the ray parameter of the near plane, at which rays begin.
    pub fn t_near(&self) -> f64 {
        self.t_near
    }

    /// Returns the ray parameter of the far plane, at which rays end.
    pub fn t_far(&self) -> f64 {
        self.t_far
    }

    /// Returns the common origin of all rays; `None` for an orthographic camera.
    #[inline(always)]
    pub fn eye(&self) -> Option<DVec3> {
        (self.origin.across == DVec3::ZERO && self.origin.down == DVec3::ZERO).then_some(self.origin.corner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(projection: Projection) -> Camera {
        Camera {
            world_from_camera: DAffine3::from_translation(DVec3::new(1.0, 2.0, 3.0)),
            projection,
            z_near: 0.5,
            ..Camera::default()
        }
    }

    #[test]
    fn right_angle_camera_sees_its_corners_at_45_degrees() {
        let view = camera(Projection::Perspective {
            y_fov: std::f64::consts::FRAC_PI_2,
            aspect: None,
        })
        .view(200, 100);
        let top = view.ray(0.5, 0.0);
        assert!((top.direction - DVec3::new(0.0, 1.0, -1.0)).length() < 1e-15);
        assert_eq!(top.t_near, 0.5);
        let left = view.ray(0.0, 0.5);
        assert!((left.direction - DVec3::new(-2.0, 0.0, -1.0)).length() < 1e-15);
        assert_eq!(view.ray(0.5, 0.5).direction, DVec3::NEG_Z);
    }

    #[test]
    fn point_projects_to_the_film_position_of_its_ray() {
        let perspective = Projection::Perspective {
            y_fov: 0.7,
            aspect: None,
        };
        let orthographic = Projection::Orthographic {
            y_mag: 2.0,
            x_mag: None,
        };
        for projection in [perspective, orthographic] {
            let view = camera(projection).view(160, 90);
            for (x, y) in [(0.5, 0.5), (0.0, 1.0), (0.25, 0.125), (1.5, -0.5)] {
                let ray = view.ray(x, y);
                let found = view.film_point(ray.origin + 7.0 * ray.direction).unwrap();
                assert!((found - DVec2::new(x, y)).length() < 1e-13, "{found}");
                // Points behind the camera are not on the film
                assert_eq!(view.film_point(ray.origin - 7.0 * ray.direction), None);
            }
        }
    }

    #[test]
    fn orthographic_camera_starts_rays_on_its_window() {
        let view = camera(Projection::Orthographic {
            y_mag: 2.0,
            x_mag: None,
        })
        .view(100, 100);
        let ray = view.ray(1.0, 0.0);
        assert_eq!(ray.origin, DVec3::new(3.0, 4.0, 3.0));
        assert_eq!(ray.direction, DVec3::NEG_Z);
    }
}
