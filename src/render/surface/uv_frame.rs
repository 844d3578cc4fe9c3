//! Texture coordinates of a hit, with their relation to positions.

use glam::DVec3;

/// Texture coordinates of a hit and the derivatives of the point by them.
#[derive(Clone, Copy)]
pub(in crate::render) struct UvFrame {
    pub(in crate::render) uv: [f32; 2],
    pub(in crate::render) derivatives: [DVec3; 2],
}

impl UvFrame {
    /// Coordinates of a hit without any: they do not span the surface.
    pub(super) const ZERO: UvFrame = UvFrame {
        uv: [0.0; 2],
        derivatives: [DVec3::ZERO; 2],
    };
}
