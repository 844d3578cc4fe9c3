//! Point that the rays of a group have in common.

use glam::Vec3;

/// Point that all rays have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum CommonEnd {
    /// Start of all rays, exactly.
    Origin(Vec3),
    /// Point that all rays pass through, up to rounding, at the end of their intervals or behind it: the position of a
    /// light.
    Target(Vec3),
}

impl CommonEnd {
    /// Returns the point that all rays pass through.
    #[inline(always)]
    pub(super) fn point(self) -> Vec3 {
        match self {
            CommonEnd::Origin(p) | CommonEnd::Target(p) => p,
        }
    }
}
