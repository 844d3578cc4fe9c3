//! Camera placement of a frame: turntables, poses, and interpolation along a path.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DMat3, DQuat, DVec3};
use serde::Deserialize;

use crate::scene::{Camera, Projection, Scene};

/// Change of a camera's placement relative to its scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum OrbitView {
    /// No change: the camera of the scene.
    #[default]
    Own,
    /// Rotation of the camera about an axis, position and orientation alike; a target on the axis stays in view.
    Turn {
        /// Number of full turns, counterclockwise as seen from the tip of the axis.
        turns: f64,
        /// Direction of the axis, of length 1.
        axis: DVec3,
        /// Point on the axis, in the file's coordinates; the centre of the scene's bounds if absent.
        center: Option<DVec3>,
    },
    /// New position and orientation, given directly.
    CameraPose(CameraPose),
}

/// Position, target and field of view of a camera, in the file's coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPose {
    /// Position of the camera.
    pub from: DVec3,
    /// Point that the camera looks at.
    pub at: DVec3,
    /// Up direction of the image, of any length.
    pub up: DVec3,
    /// Vertical field of view in radians; that of the camera itself if absent.
    pub y_fov: Option<f64>,
}

impl OrbitView {
    /// Returns the camera of `scene` as the frame has it. `middle` is the centre of the scene's bounds, in the scene's
    /// coordinates.
    ///
    /// A camera that moves while its shutter is open keeps its motion relative to the new placement.
    pub fn of(&self, camera: &Camera, scene: &Scene, middle: DVec3) -> Camera {
        let mut moved = camera.clone();
        match *self {
            OrbitView::Own => {}
            OrbitView::Turn { turns, axis, center } => {
                // Rotate both ends of the shutter interval about the axis through `center`
                let center = center.map_or(middle, |center| scene.normalisation.point(center));
                let turn = DAffine3::from_rotation_translation(
                    DQuat::from_axis_angle(axis, TAU * turns),
                    DVec3::ZERO,
                );
                let about = DAffine3::from_translation(center) * turn * DAffine3::from_translation(-center);
                moved.world_from_camera = about * camera.world_from_camera;
                moved.world_from_camera_end = camera.world_from_camera_end.map(|end| about * end);
            }
            OrbitView::CameraPose(pose) => {
                // Look from the new position, and carry over the camera's own motion
                let [from, at] = [pose.from, pose.at].map(|p| scene.normalisation.point(p));
                let end = camera
                    .world_from_camera_end
                    .map(|end| end * camera.world_from_camera.inverse());
                moved.world_from_camera = look_at(from, at - from, pose.up);
                moved.world_from_camera_end = end.map(|end| end * moved.world_from_camera);
                // A field of view applies to perspective cameras only
                if let (Some(fov), Projection::Perspective { y_fov, .. }) =
                    (pose.y_fov, &mut moved.projection)
                {
                    *y_fov = fov;
                }
            }
        }
        moved
    }
}

impl CameraPose {
    /// Returns whether the pose defines an image: target apart from the position, up direction not along the view, and
    /// a field of view within 0 to π.
    pub(super) fn is_valid(&self) -> bool {
        let forward = (self.at - self.from).try_normalize();
        let side = forward.and_then(|forward| forward.cross(self.up).try_normalize());
        self.from.is_finite() && side.is_some() && self.y_fov.is_none_or(|fov| fov > 0.0 && fov < PI)
    }

    /// Returns the pose rolled to its right by an angle in radians.
    fn rolled(self, angle: f64) -> CameraPose {
        let up = match (self.at - self.from).try_normalize() {
            Some(forward) if angle != 0.0 => DQuat::from_axis_angle(forward, angle) * self.up,
            _ => self.up,
        };
        CameraPose { up, ..self }
    }
}

/// Returns the transform of a camera at `from` that looks along `forward`.
fn look_at(from: DVec3, forward: DVec3, up: DVec3) -> DAffine3 {
    let back = -forward.normalize();
    let right = up.cross(back).normalize();
    DAffine3::from_mat3_translation(DMat3::from_cols(right, back.cross(right), back), from)
}

/// Keyframe of a camera path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CameraKey {
    pub(super) frame: f64,
    pub(super) pose: CameraPose,
    /// Roll to the right, in radians.
    pub(super) roll: f64,
}

/// Interpolation between keyframes of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Interpolation {
    /// Straight lines from key to key.
    Linear,
    /// Curve with a continuous first derivative.
    #[default]
    Smooth,
}

/// Returns the pose of a path at a frame; before the first key it is that of the first key, after the last that of the
/// last. `None` for a path without keys.
///
/// Smooth paths: between keys each number follows the cubic through them whose slopes are those of the parabola through
/// a key and its neighbours, so that the camera neither stops nor turns sharply at a key, however unevenly the keys lie
/// (a Catmull-Rom spline for unequal steps; E. Catmull and R. Rom, "A class of local interpolating splines", 1974).
pub(super) fn evaluate_path(
    keys: &[CameraKey],
    interpolation: Interpolation,
    frame: f64,
) -> Option<CameraPose> {
    let (first, last) = (keys.first()?, keys.last()?);
    // Clamp to the first and the last key
    let next = keys.partition_point(|key| key.frame <= frame);
    if next == 0 {
        return Some(first.pose.rolled(first.roll));
    }
    if next == keys.len() {
        return Some(last.pose.rolled(last.roll));
    }
    // Select the keys that affect the segment: two, or up to four for slopes at both ends
    let near = match interpolation {
        Interpolation::Linear => next - 1..next + 1,
        Interpolation::Smooth => next.saturating_sub(2)..(next + 2).min(keys.len()),
    };
    let index = next - 1 - near.start;
    let near = &keys[near];
    let at_frame = |part: &dyn Fn(&CameraKey) -> DVec3| {
        let values: Vec<(f64, DVec3)> = near.iter().map(|key| (key.frame, part(key))).collect();
        cubic(&values, index, frame)
    };
    let number = |part: &dyn Fn(&CameraKey) -> f64| at_frame(&|key| DVec3::splat(part(key))).x;
    let has_fov = near.iter().all(|key| key.pose.y_fov.is_some());
    // Interpolate each component of the pose
    let pose = CameraPose {
        from: at_frame(&|key| key.pose.from),
        at: at_frame(&|key| key.pose.at),
        up: at_frame(&|key| key.pose.up),
        y_fov: has_fov.then(|| number(&|key| key.pose.y_fov.unwrap_or_default())),
    };
    Some(pose.rolled(number(&|key| key.roll)))
}

/// Evaluates the cubic Hermite segment between value `index` and the next at time `at`.
fn cubic(values: &[(f64, DVec3)], index: usize, at: f64) -> DVec3 {
    let ((start, a), (end, b)) = (values[index], values[index + 1]);
    let length = end - start;
    let u = (at - start) / length;
    let [m, n] = [slope(values, index) * length, slope(values, index + 1) * length];
    let (u2, u3) = (u * u, u * u * u);
    a * (2.0 * u3 - 3.0 * u2 + 1.0) + m * (u3 - 2.0 * u2 + u) + b * (3.0 * u2 - 2.0 * u3) + n * (u3 - u2)
}

/// Returns the slope at a value: that of the parabola through the value and its neighbours, or at an end of the line to
/// the only neighbour.
fn slope(values: &[(f64, DVec3)], index: usize) -> DVec3 {
    let line = |i: usize| (values[i + 1].1 - values[i].1) / (values[i + 1].0 - values[i].0);
    if index == 0 {
        return line(0);
    }
    if index + 1 == values.len() {
        return line(index - 1);
    }
    let [before, behind] = [
        values[index].0 - values[index - 1].0,
        values[index + 1].0 - values[index].0,
    ];
    (line(index - 1) * behind + line(index) * before) / (before + behind)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(turns: f64) -> Camera {
        let camera = Camera {
            world_from_camera: look_at(DVec3::new(1.0, 2.0, 5.0), DVec3::NEG_Z, DVec3::Y),
            ..Camera::default()
        };
        let view = OrbitView::Turn {
            turns,
            axis: DVec3::Y,
            center: None,
        };
        view.of(&camera, &Scene::default(), DVec3::new(1.0, 0.0, 1.0))
    }

    /// Tolerance far above the rounding errors of f64 in these tests.
    const NEAR: f64 = 1e-14;

    #[test]
    fn quarter_turns_place_the_camera_on_four_sides() {
        let sides = [[1.0, 5.0], [5.0, 1.0], [1.0, -3.0], [-3.0, 1.0]];
        for (quarter, [x, z]) in sides.into_iter().enumerate() {
            let camera = turned(0.25 * quarter as f64);
            let at = camera.world_from_camera.translation;
            assert!(at.abs_diff_eq(DVec3::new(x, 2.0, z), NEAR), "{at}");
            // The camera still looks at the axis, horizontally.
            let looks = camera.world_from_camera.transform_vector3(DVec3::NEG_Z);
            let inward = DVec3::new(1.0 - x, 0.0, 1.0 - z).normalize();
            assert!(looks.abs_diff_eq(inward, NEAR), "{looks}");
        }
    }

    fn key(frame: f64, x: f64) -> CameraKey {
        CameraKey {
            frame,
            pose: CameraPose {
                from: DVec3::new(x, 0.0, 5.0),
                at: DVec3::ZERO,
                up: DVec3::Y,
                y_fov: Some(x),
            },
            roll: 0.0,
        }
    }

    #[test]
    fn smooth_path_passes_its_keys_with_the_slope_of_their_parabola() {
        // x = t^2 at 0, 1 and 3: the parabola through all three has slope 2 t at the middle key.
        let keys = [key(0.0, 0.0), key(1.0, 1.0), key(3.0, 9.0)];
        let smooth = |frame| evaluate_path(&keys, Interpolation::Smooth, frame).unwrap();
        let x = |frame| smooth(frame).from.x;
        assert_eq!(
            [x(-5.0), x(0.0), x(1.0), x(3.0), x(9.0)],
            [0.0, 0.0, 1.0, 9.0, 9.0]
        );
        // From (1, 1) with slope 2 to (3, 9) with slope 4, that of the last line: in the middle (1 + 9) / 2 + 2 (2 - 4)
        // / 8.
        assert!((x(2.0) - 4.5).abs() < NEAR);
        assert!((smooth(2.0).y_fov.unwrap() - 4.5).abs() < NEAR);
        assert_eq!(evaluate_path(&[], Interpolation::Smooth, 1.0), None);
    }

    #[test]
    fn linear_path_follows_straight_lines() {
        let keys = [key(0.0, 0.0), key(1.0, 1.0), key(3.0, 9.0)];
        let x = |frame| evaluate_path(&keys, Interpolation::Linear, frame).unwrap().from.x;
        // Half way from 0 to 1, and a quarter and a half of the way from 1 to 9.
        for (frame, expected) in [(0.5, 0.5), (1.0, 1.0), (1.5, 3.0), (2.0, 5.0), (3.0, 9.0)] {
            assert!((x(frame) - expected).abs() < NEAR, "{frame}: {}", x(frame));
        }
    }

    #[test]
    fn positive_roll_tilts_the_camera_to_its_right() {
        let quarter = CameraKey {
            roll: 0.25 * TAU,
            ..key(2.0, 0.0)
        };
        let up = |frame| {
            evaluate_path(&[key(0.0, 0.0), quarter], Interpolation::Linear, frame)
                .unwrap()
                .up
        };
        // The camera looks along -z, so its right is +x.
        assert!(up(2.0).abs_diff_eq(DVec3::X, NEAR), "{}", up(2.0));
        let half_way = DVec3::new(1.0, 1.0, 0.0).normalize();
        assert!(up(1.0).abs_diff_eq(half_way, NEAR), "{}", up(1.0));
    }

    #[test]
    fn pose_looks_at_its_target_and_degenerate_poses_are_invalid() {
        let pose = CameraPose {
            y_fov: Some(1.0),
            ..key(0.0, 0.0).pose
        };
        let camera = OrbitView::CameraPose(pose).of(&Camera::default(), &Scene::default(), DVec3::ZERO);
        assert_eq!(camera.world_from_camera.translation, DVec3::new(0.0, 0.0, 5.0));
        assert_eq!(
            camera.world_from_camera.transform_vector3(DVec3::NEG_Z),
            DVec3::NEG_Z
        );
        let degenerate = CameraPose { up: DVec3::Z, ..pose };
        assert!(pose.is_valid() && !degenerate.is_valid());
        let flat = CameraPose {
            y_fov: Some(PI),
            ..pose
        };
        let far = CameraPose {
            from: DVec3::splat(f64::MAX),
            at: -DVec3::splat(f64::MAX),
            ..pose
        };
        assert!(!flat.is_valid() && !far.is_valid());
    }
}
