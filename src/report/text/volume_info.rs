//! Description of a scene's volumes and fog, in the file's coordinates.

use std::fmt;

use serde::Serialize;

use crate::report::memory;
use crate::scene::Scene;

/// Description of a volume in the scene.
#[derive(Clone, Debug, Serialize)]
pub struct VolumeInfo {
    /// Name from the file, or a generated one.
    pub name: String,
    /// Number of samples along x, y and z.
    pub size: [usize; 3],
    /// Memory of the volume's grids in bytes.
    pub bytes: u64,
    /// Length of a ray-marching step, in the file's unit.
    pub step: f64,
    /// Fraction of the volume that is skipped as empty space.
    pub empty_share: f64,
}

/// Description of the scene's fog.
#[derive(Clone, Debug, Serialize)]
pub struct FogInfo {
    /// Extinction coefficient per unit of length of the file.
    pub extinction: f64,
    /// Scattering albedo, linear RGB.
    pub color: [f64; 3],
    /// Emitted radiance per unit of length, linear RGB.
    pub emission: [f64; 3],
    /// Length of a ray-marching step where lights illuminate the fog, in the file's unit.
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
