//! Camera that moves while the shutter is open.

use crate::numeric::AnimatedTransform;
use crate::scene::{Camera, CameraView, Effect, EffectSet, LensView};

/// Moving camera, for one size of image.
pub(in crate::render) struct MovingCamera {
    camera: Camera,
    motion: AnimatedTransform,
    size: [u32; 2],
    has_lens: bool,
}

impl MovingCamera {
    /// Returns the moving camera; `None` if the camera is static or motion blur is off.
    pub(in crate::render) fn of(camera: &Camera, size: [u32; 2], effects: EffectSet) -> Option<MovingCamera> {
        let motion = camera.motion().filter(|_| effects.has(Effect::MotionBlur))?;
        Some(MovingCamera {
            camera: camera.clone(),
            motion,
            size,
            has_lens: effects.has(Effect::DepthOfField),
        })
    }

    /// Returns the camera and its lens at `time`.
    pub(in crate::render) fn at(&self, time: f32) -> (CameraView, Option<LensView>) {
        let camera = Camera {
            world_from_camera: self.motion.at(f64::from(time)),
            name: String::new(),
            ..self.camera
        };
        let [width, height] = self.size;
        let lens = camera.lens_view().filter(|_| self.has_lens);
        (camera.view(width, height), lens)
    }
}
