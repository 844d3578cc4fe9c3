//! Cameras of scene files: by look-at, or by an explicit frame and window.

use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

use super::value::{Located, Vector};
use crate::scene::{Aperture, Camera, Lens, Projection, Shutter, axes_looking_along};

/// A camera, by look-at (`from`, `at`, `up`, with `fov` for a perspective or `height` for a parallel projection) or by
/// an explicit frame (`eye`, `i`, `j`, `k`, `near`, `window`), from which rays go through P(x, y) = E + w(2x/c - 1) i +
/// h(2y/r - 1) j - n k.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraForm {
    /// Name by which `--camera` selects it.
    pub(super) name: Option<Located<String>>,
    /// Position of the camera.
    from: Option<Vector>,
    /// Point that the camera looks at.
    at: Option<Vector>,
    /// Direction that is up in the image.
    #[schemars(extend("default" = UP))]
    up: Option<Vector>,
    /// Full vertical field of view in degrees, between 0 and 180.
    #[schemars(extend("default" = FOV))]
    fov: Option<f64>,
    /// Height of the image in metres, which makes the projection parallel.
    height: Option<f64>,
    /// Origin E of the explicit frame: the position of the camera.
    eye: Option<Vector>,
    /// Axis i of the explicit frame: to the right, a unit vector.
    i: Option<Vector>,
    /// Axis j of the explicit frame: up, a unit vector.
    j: Option<Vector>,
    /// Axis k of the explicit frame: backwards, a unit vector; the camera looks along -k.
    k: Option<Vector>,
    /// Full width 2w and height 2h of the explicit frame's window in the near plane. Pixels take its shape.
    window: Option<[f64; 2]>,
    /// Distance n of the near plane; nothing nearer is visible.
    near: Option<f64>,
    /// Distance of the far plane; nothing farther is visible.
    far: Option<f64>,
    /// A thin lens instead of a pinhole: things are sharp in one plane only.
    lens: Option<LensForm>,
    /// View at the end of motions, for a moving camera; absent keys are as at the start.
    end: Option<EndForm>,
    /// Times at which the shutter opens and closes, as fractions of all motions: from 0 at their start to 1 at their
    /// end.
    #[schemars(extend("default" = [0.0, 1.0]))]
    shutter: Option<[f64; 2]>,
}

/// View of a camera at the end of motions. In between, its position and its rotation are interpolated evenly, the
/// rotation the short way round.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct EndForm {
    /// Position of the camera at the end of motions.
    from: Option<Vector>,
    /// Point that the camera looks at, at the end of motions.
    at: Option<Vector>,
    /// Direction that is up in the image, at the end of motions.
    up: Option<Vector>,
    /// Origin E of the explicit frame, at the end of motions.
    eye: Option<Vector>,
    /// Axis i of the explicit frame, at the end of motions.
    i: Option<Vector>,
    /// Axis j of the explicit frame, at the end of motions.
    j: Option<Vector>,
    /// Axis k of the explicit frame, at the end of motions.
    k: Option<Vector>,
}

/// A thin lens. An image with one needs many samples per pixel.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LensForm {
    /// Radius of the opening in metres, that of the circle around it if it has blades; 0 for a pinhole.
    radius: f64,
    /// Distance along the view axis at which things are sharp.
    focus: f64,
    /// Number of straight blades that bound the opening, at least 3; a round opening if absent.
    blades: Option<u32>,
    /// Degrees by which the blades are turned, counter-clockwise as the camera looks.
    #[schemars(extend("default" = 0.0))]
    turn: Option<f64>,
}

impl LensForm {
    fn lens(&self) -> Result<Lens, String> {
        // Blades make a polygon, and only a polygon has a rotation
        let aperture = match (self.blades, self.turn) {
            (None, None) => Aperture::Disk,
            (None, Some(_)) => {
                return Err("has a lens with `turn` and without `blades`: give `blades` or remove it".into());
            }
            (Some(blades), turn) => Aperture::Polygon {
                blades,
                rotation: turn.unwrap_or(0.0).to_radians(),
            },
        };
        Lens::new(self.radius, self.focus, aperture).map_err(|error| error.to_string())
    }
}

/// Default direction that is up in the image.
const UP: [f64; 3] = [0.0, 1.0, 0.0];
/// Default vertical field of view in degrees, that of the camera that frames a glTF file.
const FOV: f64 = 45.0;

impl CameraForm {
    /// Returns the camera, named by its number if it has no name.
    pub(super) fn camera(&self, number: usize) -> Result<Camera, String> {
        let (world_from_camera, projection) = self.view()?;
        // The view at the end is that of a camera with the keys of `end`
        let world_from_camera_end = match self.end {
            None => None,
            Some(end) => {
                let (map, _) = (self.ending(end).view()).map_err(|fault| format!("at its `end`, {fault}"))?;
                (map != world_from_camera).then_some(map)
            }
        };
        let name = self
            .name
            .as_ref()
            .map_or_else(|| format!("camera {number}"), |n| n.to_string());
        let camera = Camera {
            name,
            world_from_camera,
            projection,
            z_near: self.near.unwrap_or(0.0),
            z_far: self.far.unwrap_or(f64::INFINITY),
            lens: self.lens.as_ref().map(LensForm::lens).transpose()?,
            world_from_camera_end,
            shutter: self
                .shutter
                .map_or_else(Shutter::default, |[open, close]| Shutter { open, close }),
        };
        // Check the values, which this type does not restrict
        crate::scene::check_camera(&camera)?;
        Ok(camera)
    }

    fn view(&self) -> Result<(DAffine3, Projection), String> {
        if self.eye.is_some() {
            self.explicit_frame()
        } else {
            self.look_at()
        }
    }

    /// Returns the camera at rest at the end of this one's motion.
    fn ending(&self, end: EndForm) -> CameraForm {
        CameraForm {
            name: None,
            from: end.from.or(self.from),
            at: end.at.or(self.at),
            up: end.up.or(self.up),
            eye: end.eye.or(self.eye),
            i: end.i.or(self.i),
            j: end.j.or(self.j),
            k: end.k.or(self.k),
            lens: None,
            end: None,
            ..*self
        }
    }

    fn explicit_frame(&self) -> Result<(DAffine3, Projection), String> {
        // Reject keys of the look-at form
        let foreign_keys = [
            (self.from.is_some(), "from"),
            (self.at.is_some(), "at"),
            (self.up.is_some(), "up"),
            (self.fov.is_some(), "fov"),
            (self.height.is_some(), "height"),
        ];
        if let Some((_, key)) = foreign_keys.iter().find(|(given, _)| *given) {
            return Err(format!(
                "has both `eye` and `{key}`: give a frame or a look-at, not both"
            ));
        }
        // Require all keys of the frame
        let parts = (self.eye, self.i, self.j, self.k, self.near, self.window);
        let (Some(eye), Some(i), Some(j), Some(k), Some(distance), Some([width, height])) = parts else {
            return Err("is incomplete: with `eye` give `i`, `j`, `k`, `near` and `window`".into());
        };
        let axes = DMat3::from_cols(i.0, j.0, k.0);
        let projection = Projection::Window {
            half_width: 0.5 * width,
            half_height: 0.5 * height,
            distance,
        };
        Ok((DAffine3::from_mat3_translation(axes, eye.0), projection))
    }

    fn look_at(&self) -> Result<(DAffine3, Projection), String> {
        // Reject keys of the explicit frame
        let foreign_keys = [
            (self.i.is_some(), "i"),
            (self.j.is_some(), "j"),
            (self.k.is_some(), "k"),
            (self.window.is_some(), "window"),
        ];
        if let Some((_, key)) = foreign_keys.iter().find(|(given, _)| *given) {
            return Err(format!("has `{key}` without `eye`: add `eye` or remove it"));
        }
        // Require both points of the look-at
        let (Some(from), Some(at)) = (self.from, self.at) else {
            return Err(
                "has no position: give `from` and `at`, or `eye`, `i`, `j`, `k`, `near` and `window`".into(),
            );
        };
        // Choose the projection
        let up = self.up.map_or(DVec3::from_array(UP), |up| up.0);
        let projection = match (self.fov, self.height) {
            (Some(_), Some(_)) => {
                return Err(
                    "has both `fov` and `height`: give one, as a parallel projection has no angle".into(),
                );
            }
            (_, Some(height)) => Projection::Orthographic {
                y_mag: 0.5 * height,
                x_mag: None,
            },
            (fov, None) => Projection::Perspective {
                y_fov: fov.unwrap_or(FOV).to_radians(),
                aspect: None,
            },
        };
        // Orient the camera
        let axes = axes_looking_along(at.0 - from.0, up).ok_or(
            "has no viewing direction, or looks along `up`: move `from` or `at`, or give another `up`",
        )?;
        Ok((DAffine3::from_mat3_translation(axes, from.0), projection))
    }
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;

    fn camera(text: &str) -> Result<Camera, String> {
        from_text::<CameraForm>(text).unwrap().camera(0)
    }

    #[test]
    fn look_at_camera_matches_the_explicit_frame() {
        // 90 degrees high at distance 2 is a window of 4 by 4.
        let look = camera("from = [1, 2, 3]\nat = [1, 2, 0]\nfov = 90\nnear = 2").unwrap();
        let frame =
            camera("eye = [1, 2, 3]\ni = [1, 0, 0]\nj = [0, 1, 0]\nk = [0, 0, 1]\nnear = 2\nwindow = [4, 4]")
                .unwrap();
        let [a, b] = [look, frame].map(|c| c.view(10, 10).ray(0.25, 0.75));
        assert_eq!(a.origin, b.origin);
        assert!((a.direction * 2.0 - b.direction).length() < 8.0 * f64::EPSILON);
        assert_eq!((a.t_near, b.t_near), (2.0, 1.0));
    }

    #[test]
    fn mixed_camera_forms_are_rejected() {
        for (bad, words) in [
            ("", "has no position"),
            ("from = [0, 0, 0]\nat = [0, 0, 0]", "has no viewing direction"),
            ("from = [0, 0, 0]\nat = [0, 5, 0]", "along `up`"),
            ("from = [0, 0, 0]\nat = [0, 0, 1]\nfov = 180", "between 0 and 180"),
            (
                "from = [0, 0, 0]\nat = [0, 0, 1]\nfov = 20\nheight = 1",
                "both `fov` and `height`",
            ),
            (
                "from = [0, 0, 0]\nat = [0, 0, 1]\nwindow = [1, 1]",
                "without `eye`",
            ),
            ("eye = [0, 0, 0]\nfov = 20", "both `eye` and `fov`"),
            ("eye = [0, 0, 0]", "is incomplete"),
            (
                "eye = [0, 0, 0]\ni = [2, 0, 0]\nj = [0, 1, 0]\nk = [0, 0, 1]\nnear = 1\nwindow = [1, 1]",
                "not orthonormal",
            ),
            (
                "from = [0, 0, 0]\nat = [0, 0, 1]\nlens = { radius = -1, focus = 2 }",
                "radius of the lens is -1",
            ),
            (
                "from = [0, 0, 0]\nat = [0, 0, 1]\nlens = { radius = 1, focus = 2, blades = 2 }",
                "give 3 or more blades",
            ),
            (
                "from = [0, 0, 0]\nat = [0, 0, 1]\nlens = { radius = 1, focus = 2, turn = 9 }",
                "without `blades`",
            ),
        ] {
            let error = camera(bad).unwrap_err();
            assert!(error.contains(words), "{bad}: {error}");
        }
    }
}
