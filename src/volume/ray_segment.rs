//! Segment of a ray that is marched.

use glam::DVec3;

/// Segment of a ray that is marched, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySegment {
    /// Point of the ray at t = 0.
    pub origin: DVec3,
    /// Direction of any length but 0; `t` is measured in units of this length.
    pub direction: DVec3,
    /// Parameter where the march begins.
    pub t_near: f64,
    /// Parameter where the march ends: at the surface that is hit, or infinity.
    pub t_far: f64,
}

impl RaySegment {
    /// Empty segment, which contributes nothing.
    pub const NONE: RaySegment = RaySegment {
        origin: DVec3::ZERO,
        direction: DVec3::Z,
        t_near: 0.0,
        t_far: 0.0,
    };
}
