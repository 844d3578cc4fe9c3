//! What was understood of a scene's volumes and fog, in the file's coordinates.

use std::fmt;

use serde::Serialize;

use super::memory;
use crate::scene::Scene;

/// A volume.
#[derive(Clone, Debug, Serialize)]
pub struct VolumeInfo {
    /// As in the file, or made up.
    pub name: String,
    /// Samples along x, y, z.
    pub size: [usize; 3],
    /// Of its grids.
    pub bytes: u64,
    /// Length of a step of the march, in the file's unit.
    pub step: f64,
    /// Share of it that is leapt over.
    pub empty_share: f64,
}

/// Fog.
#[derive(Clone, Debug, Serialize)]
pub struct FogInfo {
    /// Per unit of length of the file.
    pub extinction: f64,
    /// Share of what is taken away that is scattered, linear RGB.
    pub color: [f64; 3],
    /// Radiance sent out per unit of length, linear RGB.
    pub emission: [f64; 3],
    /// Length of a step of the march where lamps light it, in the file's unit.
    pub step: f64,
}

pub(super) fn volumes(scene: &Scene) -> Vec<VolumeInfo> {
    let volumes = scene.volumes.iter();
    volumes
        .map(|volume| VolumeInfo {
            name: volume.name().to_owned(),
            size: volume.size(),
            bytes: volume.memory() as u64,
            step: volume.step() / scene.normalisation.scale,
            empty_share: volume.empty_space().share(),
        })
        .collect()
}

pub(super) fn fog(scene: &Scene) -> Option<FogInfo> {
    let fog = scene.fog?.rescaled(scene.normalisation.scale.recip());
    Some(FogInfo {
        extinction: fog.extinction(),
        color: fog.color(),
        emission: fog.emission(),
        step: fog.step(),
    })
}

impl fmt::Display for VolumeInfo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [x, y, z] = self.size;
        let (bytes, empty) = (memory::in_words(self.bytes), 100.0 * self.empty_share);
        let (name, step) = (&self.name, self.step);
        write!(
            f,
            "`{name}`, {x} x {y} x {z}, {bytes}, {empty:.0} % empty, steps of {step}"
        )
    }
}

impl fmt::Display for FogInfo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "extinction {}, steps of {}", self.extinction, self.step)
    }
}
