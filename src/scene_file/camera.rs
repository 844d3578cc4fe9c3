//! Cameras: by look-at, or by the lecture's frame; a window in perspective or not.

use glam::{DAffine3, DMat3, DVec3};
use schemars::JsonSchema;
use serde::Deserialize;

use super::value::{At, Vector};
use crate::scene::{Aperture, Camera, Lens, Projection, Shutter};

/// A camera, by look-at (`from`, `at`, `up`, with `fov` for a perspective or `height` for a parallel projection) or by
/// the lecture's frame (`eye`, `i`, `j`, `k`, `near`, `window`).
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraForm {
    /// What `--camera` may call it.
    pub(super) name: Option<At<String>>,
    /// Where it stands.
    from: Option<Vector>,
    /// What it looks at.
    at: Option<Vector>,
    /// What is up in the picture.
    #[schemars(extend("default" = UP))]
    up: Option<Vector>,
    /// Full vertical field of view in degrees, between 0 and 180.
    #[schemars(extend("default" = FOV))]
    fov: Option<f64>,
    /// Height of the picture in metres, which makes the projection parallel.
    height: Option<f64>,
    /// The lecture's E: where rays start.
    eye: Option<Vector>,
    /// The lecture's i: to the right, a unit vector.
    i: Option<Vector>,
    /// The lecture's j: up, a unit vector.
    j: Option<Vector>,
    /// The lecture's k: backwards, a unit vector; the camera looks along -k.
    k: Option<Vector>,
    /// The lecture's 2w and 2h: full width and height of the window in the near plane. Pixels take its shape.
    window: Option<[f64; 2]>,
    /// Distance of the near plane; nothing nearer is seen. The lecture's n.
    near: Option<f64>,
    /// Distance of the far plane; nothing farther is seen.
    far: Option<f64>,
    /// A thin lens in place of the pinhole: things are sharp in one plane only.
    lens: Option<LensForm>,
    /// Where it is where motions end, if it moves: what is not given is as it is where they begin.
    end: Option<EndForm>,
    /// When the shutter opens and closes, as parts of all motions: from 0 where they begin to 1 where they end.
    #[schemars(extend("default" = [0.0, 1.0]))]
    shutter: Option<[f64; 2]>,
}

/// Where a camera is where motions end; in between it goes evenly, and turns evenly the short way round.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct EndForm {
    /// Where it stands.
    from: Option<Vector>,
    /// What it looks at.
    at: Option<Vector>,
    /// What is up in the picture.
    up: Option<Vector>,
    /// The lecture's E.
    eye: Option<Vector>,
    /// The lecture's i.
    i: Option<Vector>,
    /// The lecture's j.
    j: Option<Vector>,
    /// The lecture's k.
    k: Option<Vector>,
}

/// A thin lens. A picture with one needs many samples a pixel.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LensForm {
    /// Radius of the opening in metres, that of the circle around it if it has blades; 0 for a pinhole.
    radius: f64,
    /// Distance along the view axis at which things are sharp.
    focus: f64,
    /// Straight blades that bound the opening, at least 3; a round one if absent.
    blades: Option<u32>,
    /// Degrees by which the blades are turned, counter-clockwise as the camera looks.
    #[schemars(extend("default" = 0.0))]
    turn: Option<f64>,
}

impl LensForm {
    fn lens(&self) -> Result<Lens, String> {
        let aperture = match (self.blades, self.turn) {
            (None, None) => Aperture::Disk,
            (None, Some(_)) => {
                return Err(
                    "has a lens with `turn` and without `blades`: give `blades` or take it away".into(),
                );
            }
            (Some(blades), turn) => Aperture::Polygon {
                blades,
                rotation: turn.unwrap_or(0.0).to_radians(),
            },
        };
        Lens::new(self.radius, self.focus, aperture).map_err(|error| error.to_string())
    }
}

/// What is up where a file does not say it.
const UP: [f64; 3] = [0.0, 1.0, 0.0];
/// Vertical field of view in degrees where a file does not say it: that of the camera that frames a glTF file.
const FOV: f64 = 45.0;

impl CameraForm {
    /// The camera, called by its number where it has no name.
    pub(super) fn camera(&self, number: usize) -> Result<Camera, String> {
        let (world_from_camera, projection) = self.view()?;
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
        crate::scene::check_camera(&camera)?;
        Ok(camera)
    }

    fn view(&self) -> Result<(DAffine3, Projection), String> {
        if self.eye.is_some() {
            self.lecture()
        } else {
            self.look_at()
        }
    }

    /// The camera that stands still where this one's motion ends.
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

    fn lecture(&self) -> Result<(DAffine3, Projection), String> {
        let strangers = [
            (self.from.is_some(), "from"),
            (self.at.is_some(), "at"),
            (self.up.is_some(), "up"),
            (self.fov.is_some(), "fov"),
            (self.height.is_some(), "height"),
        ];
        if let Some((_, key)) = strangers.iter().find(|(given, _)| *given) {
            return Err(format!(
                "has both `eye` and `{key}`: give a frame or a look-at, not both"
            ));
        }
        let parts = (self.eye, self.i, self.j, self.k, self.near, self.window);
        let (Some(eye), Some(i), Some(j), Some(k), Some(distance), Some([width, height])) = parts else {
            return Err("is not whole: with `eye` give `i`, `j`, `k`, `near` and `window`".into());
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
        let strangers = [
            (self.i.is_some(), "i"),
            (self.j.is_some(), "j"),
            (self.k.is_some(), "k"),
            (self.window.is_some(), "window"),
        ];
        if let Some((_, key)) = strangers.iter().find(|(given, _)| *given) {
            return Err(format!("has `{key}` without `eye`: add `eye` or take it away"));
        }
        let (Some(from), Some(at)) = (self.from, self.at) else {
            return Err(
                "stands nowhere: give `from` and `at`, or `eye`, `i`, `j`, `k`, `near` and `window`".into(),
            );
        };
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
        let axes = axes_looking_along(at.0 - from.0, up)
            .ok_or("looks nowhere, or along `up`: move `from` or `at`, or give another `up`")?;
        Ok((DAffine3::from_mat3_translation(axes, from.0), projection))
    }
}

/// How nearly a direction may point along `up`: an angle whose sine is 2^-26 leaves half of f64's digits to the axes.
const MIN_SINE: f64 = 1.0 / (1 << 26) as f64;

fn axes_looking_along(forward: DVec3, up: DVec3) -> Option<DMat3> {
    let forward = forward.try_normalize()?;
    let right = forward.cross(up.try_normalize()?);
    if !(right.length() > MIN_SINE) {
        return None;
    }
    let right = right.normalize();
    Some(DMat3::from_cols(right, right.cross(forward), -forward))
}

#[cfg(test)]
mod tests {
    use super::super::node::from_text;
    use super::*;

    fn camera(text: &str) -> Result<Camera, String> {
        from_text::<CameraForm>(text).unwrap().camera(0)
    }

    #[test]
    fn a_look_at_camera_and_the_lectures_frame_see_the_same() {
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
    fn a_camera_that_is_half_one_thing_and_half_another_is_refused() {
        for (bad, words) in [
            ("", "stands nowhere"),
            ("from = [0, 0, 0]\nat = [0, 0, 0]", "looks nowhere"),
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
            ("eye = [0, 0, 0]", "is not whole"),
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
                "at least 3 blades",
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
