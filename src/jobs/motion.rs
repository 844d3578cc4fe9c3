//! Camera motion of a job from frame to frame.

use glam::DVec3;

use super::form::{JobForm, KeyForm, TurntableForm};
use super::range::FrameRange;
use super::view::{Interpolation, Key, Pose, View, along};
use crate::scene_file::fault::Fault;
use crate::scene_file::value::At;

/// Camera motion over the frames of a job.
pub(super) enum Motion {
    None,
    Turntable {
        turns: f64,
        axis: DVec3,
        center: Option<DVec3>,
    },
    Path(Vec<Key>, Interpolation),
}

impl Motion {
    /// Returns the camera placement of frame `number`.
    pub(super) fn view(&self, number: u32, range: &FrameRange) -> View {
        match self {
            Motion::None => View::Own,
            Motion::Turntable { turns, axis, center } => View::Turn {
                turns: turns * f64::from(number - range.first) / range.span(),
                axis: *axis,
                center: *center,
            },
            Motion::Path(keys, interpolation) => {
                along(keys, *interpolation, f64::from(number)).map_or(View::Own, View::Pose)
            }
        }
    }
}

/// Parses the camera motion of a job and checks that every frame has a valid view.
pub(super) fn motion(form: &At<JobForm>, range: &FrameRange) -> Result<Motion, Fault> {
    if let (Some(word), []) = (&form.interpolation, &form.path[..]) {
        return Err(word.fault("is of a `path`, which is not there: add one, or take it away"));
    }
    // Parse the turntable or the path; a job may have only one of them
    match (&form.turntable, &form.path[..]) {
        (Some(turntable), []) => turning(turntable),
        (None, []) => Ok(Motion::None),
        (None, [first, ..]) => {
            let interpolation = form.interpolation.as_ref().map(|word| **word).unwrap_or_default();
            let motion = Motion::Path(keys(&form.path)?, interpolation);
            let is_possible = |number: &u32| match motion.view(*number, range) {
                View::Pose(pose) => pose.is_possible(),
                _ => true,
            };
            // Report the first frame whose interpolated pose is degenerate
            match range.numbers().find(|number| !is_possible(number)) {
                Some(number) => Err(first.fault(format!(
                    "leads at frame {number} to no view: let `at` stay apart from `from` and `up` off the way there, \
                     or give more keys"
                ))),
                None => Ok(motion),
            }
        }
        (Some(turntable), _) => Err(turntable.fault("stands beside a `path`: keep one of them")),
    }
}

fn turning(form: &At<TurntableForm>) -> Result<Motion, Fault> {
    let axis = DVec3::from(form.axis).try_normalize();
    let axis = axis.ok_or_else(|| form.fault("has no axis: give a direction, as in `axis = [0, 1, 0]`"))?;
    if !form.turns.is_finite() || form.center.is_some_and(|center| !DVec3::from(center).is_finite()) {
        return Err(form.fault("has numbers that are not finite: correct them"));
    }
    Ok(Motion::Turntable {
        turns: form.turns,
        axis,
        center: form.center.map(DVec3::from),
    })
}

fn keys(forms: &[At<KeyForm>]) -> Result<Vec<Key>, Fault> {
    let mut keys: Vec<Key> = Vec::with_capacity(forms.len());
    for form in forms {
        // Convert degrees to radians
        let key = Key {
            frame: form.frame,
            pose: Pose {
                from: form.from.into(),
                at: form.at.into(),
                up: form.up.into(),
                y_fov: form.fov.map(f64::to_radians),
            },
            roll: form.roll.to_radians(),
        };
        // Each key must be a valid view, later than the key before, and have a `fov` exactly if the first has
        if !key.pose.is_possible() || !key.roll.is_finite() {
            return Err(form.fault(
                "is no view: `at` must lie apart from `from`, `up` not along the way there, and `fov` between 0 and 180",
            ));
        }
        if !form.frame.is_finite() || keys.last().is_some_and(|before| before.frame >= form.frame) {
            return Err(form.fault("does not come after the one before: order them by their frames"));
        }
        if keys
            .first()
            .is_some_and(|first| first.pose.y_fov.is_some() != form.fov.is_some())
        {
            return Err(
                form.fault("differs from the first in having a `fov`: give one to all keys or to none")
            );
        }
        keys.push(key);
    }
    Ok(keys)
}
