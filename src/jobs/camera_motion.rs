//! Camera motion of a job from frame to frame.

use glam::DVec3;

use super::camera_path::{CameraKey, CameraPose, Interpolation, OrbitView, evaluate_path};
use super::range::FrameRange;
use super::spec::{JobSpec, KeySpec, TurntableSpec};
use crate::scene_file::fault::Diagnostic;
use crate::scene_file::value::Located;

/// Camera motion over the frames of a job.
pub(super) enum CameraMotion {
    None,
    Turntable {
        turns: f64,
        axis: DVec3,
        center: Option<DVec3>,
    },
    Path(Vec<CameraKey>, Interpolation),
}

impl CameraMotion {
    /// Returns the camera placement of frame `number`.
    pub(super) fn view(&self, number: u32, range: &FrameRange) -> OrbitView {
        match self {
            CameraMotion::None => OrbitView::Own,
            CameraMotion::Turntable { turns, axis, center } => OrbitView::Turn {
                turns: turns * f64::from(number - range.first) / range.span(),
                axis: *axis,
                center: *center,
            },
            CameraMotion::Path(keys, interpolation) => evaluate_path(keys, *interpolation, f64::from(number))
                .map_or(OrbitView::Own, OrbitView::CameraPose),
        }
    }
}

/// Parses the camera motion of a job and checks that every frame has a valid view.
pub(super) fn camera_motion(form: &Located<JobSpec>, range: &FrameRange) -> Result<CameraMotion, Diagnostic> {
    if let (Some(word), []) = (&form.interpolation, &form.path[..]) {
        return Err(word.fault("requires a `path`, which the job lacks: add one, or remove it"));
    }
    // Parse the turntable or the path; a job may have only one of them
    match (&form.turntable, &form.path[..]) {
        (Some(turntable), []) => parse_turntable(turntable),
        (None, []) => Ok(CameraMotion::None),
        (None, [first, ..]) => {
            let interpolation = form.interpolation.as_ref().map(|word| **word).unwrap_or_default();
            let camera_motion = CameraMotion::Path(keys(&form.path)?, interpolation);
            let is_valid = |number: &u32| match camera_motion.view(*number, range) {
                OrbitView::CameraPose(pose) => pose.is_valid(),
                _ => true,
            };
            // Report the first frame whose interpolated pose is degenerate
            match range.numbers().find(|number| !is_valid(number)) {
                Some(number) => Err(first.fault(format!(
                    "gives no valid view at frame {number}: keep `at` apart from `from` and `up` out of the view \
                     direction, or add keys"
                ))),
                None => Ok(camera_motion),
            }
        }
        (Some(turntable), _) => {
            Err(turntable.fault("conflicts with the `path` of the job: keep one of them"))
        }
    }
}

fn parse_turntable(form: &Located<TurntableSpec>) -> Result<CameraMotion, Diagnostic> {
    let axis = DVec3::from(form.axis).try_normalize();
    let axis =
        axis.ok_or_else(|| form.fault("has an `axis` of no direction: give one, as in `axis = [0, 1, 0]`"))?;
    if !form.turns.is_finite() || form.center.is_some_and(|center| !DVec3::from(center).is_finite()) {
        return Err(form.fault("has numbers that are not finite: give finite ones"));
    }
    Ok(CameraMotion::Turntable {
        turns: form.turns,
        axis,
        center: form.center.map(DVec3::from),
    })
}

fn keys(forms: &[Located<KeySpec>]) -> Result<Vec<CameraKey>, Diagnostic> {
    let mut keys: Vec<CameraKey> = Vec::with_capacity(forms.len());
    for form in forms {
        // Convert degrees to radians
        let key = CameraKey {
            frame: form.frame,
            pose: CameraPose {
                from: form.from.into(),
                at: form.at.into(),
                up: form.up.into(),
                y_fov: form.fov.map(f64::to_radians),
            },
            roll: form.roll.to_radians(),
        };
        // Each key must be a valid view, later than the key before, and have a `fov` exactly if the first has
        if !key.pose.is_valid() || !key.roll.is_finite() {
            return Err(form.fault(
                "is not a valid view: `at` must differ from `from`, `up` from the view direction, and `fov` must be \
                 between 0 and 180",
            ));
        }
        if !form.frame.is_finite() || keys.last().is_some_and(|before| before.frame >= form.frame) {
            return Err(form.fault("does not follow the previous key: order the keys by `frame`"));
        }
        if keys
            .first()
            .is_some_and(|first| first.pose.y_fov.is_some() != form.fov.is_some())
        {
            return Err(form.fault(
                "differs from the first key in whether it has a `fov`: give one to all keys or to none",
            ));
        }
        keys.push(key);
    }
    Ok(keys)
}
