//! Ray march through a homogeneous medium.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use crate::volume::{
    Grid, GridSamples, March, RaySegment, Thickness, Transfer, TransferNode, Volume, VolumeDescription,
};

/// Returns white radiance and transmittance of a medium of extinction `sigma` over `length`, at most 2, marched in
/// steps of `step`; NaN if the medium cannot be created.
pub(super) fn march(sigma: f64, length: f64, step: f64) -> [f64; 2] {
    let Some(volume) = even_volume(sigma, step) else {
        return [f64::NAN; 2];
    };
    // Pass through the cube parallel to z, off its centre
    let stretch = RaySegment {
        origin: DVec3::new(0.1, 0.2, -1.0),
        direction: DVec3::Z,
        t_near: 0.0,
        t_far: length,
    };
    let volumes = [volume];
    let mut march = March::new(&volumes, None).with_cutoff(0.0);
    let marched = march.radiance(&stretch, None);
    [marched.radiance[0], march.transmittance(&stretch)]
}

/// Returns the cube [-1, 1]³ filled with a white homogeneous medium.
fn even_volume(sigma: f64, step: f64) -> Option<Volume> {
    let grid = Grid::new([1; 3], GridSamples::Floats(vec![1.0])).ok()?;
    let node = TransferNode {
        value: 1.0,
        thickness: sigma,
        color: [1.0; 3],
        emission: [0.0; 3],
    };
    let description = VolumeDescription {
        density: Arc::new(grid),
        color: None,
        transfer: Transfer::new(&[node], Thickness::Extinction).ok()?,
        world_from_cube: DAffine3::IDENTITY,
        step: Some(step),
    };
    Volume::new(description).ok()
}
