//! Recentring and scaling by a power of two, so that no scene is tiny, huge or far away.

use glam::DVec3;

/// The map from the file's coordinates to the scene's: `(p - center) * scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalisation {
    /// What became the origin, in the file's coordinates.
    pub center: DVec3,
    /// A power of two.
    pub scale: f64,
}

impl Default for Normalisation {
    fn default() -> Normalisation {
        Normalisation {
            center: DVec3::ZERO,
            scale: 1.0,
        }
    }
}
