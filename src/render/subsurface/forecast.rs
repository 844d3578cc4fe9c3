//! Forecast of the memory for subsurface scattering.

use super::points::count;
use crate::optics::subsurface::MAX_SAMPLES;
use crate::scene::Scene;

/// Largest number of bytes per point while the trees are built: as a point, with its irradiance, sorted, and in its
/// tree.
const BYTES_PER_POINT: u64 = 256;

/// Returns an upper bound on the bytes for subsurface scattering in a scene.
pub fn subsurface_bytes(scene: &Scene) -> u64 {
    count(scene).min(MAX_SAMPLES as f64) as u64 * BYTES_PER_POINT
}
