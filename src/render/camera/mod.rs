//! Camera rays with depth of field and motion blur, and motion vectors.

pub(super) mod lens;
mod motion_vectors;
mod moving_camera;

pub(super) use motion_vectors::ScreenMotion;
pub(super) use moving_camera::MovingCamera;
